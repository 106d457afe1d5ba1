"""What the settled fit is worth: values, errors, what is open, and whether to believe it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from godfit.inference import diagnostics, sandwich
from godfit.inference.estimates import Estimate, Solution, estimates
from godfit.inference.evaluate import model_at
from godfit.inference.fitted import Found
from godfit.inference.information import Misfit, misfit
from godfit.inference.noise import WITHIN_ROUNDING
from godfit.inference.observation import Picture
from godfit.inference.settle import Settled
from godfit.inference.solver import tangent_at
from godfit.io.image import LEVELS
from godfit.report.result import FitResult

# Error of the light's place, as a share of the picture, that is no place.
ANYWHERE = 0.1
FROM_ANYWHERE = (
    "no rays were found: what may be light comes from {:.2f} +- {:.2f}, {:.2f} +- {:.2f} of the "
    "picture, which is from anywhere"
)
# Times over that a picture says the same, least, that is a line of pixels, repeated.
A_LINE = 16
STRUCTURED = (
    "what is left is not noise ({:.2f} levels, neighbours correlated by {:.2f}): background or "
    "occluders are more than the model has"
)


class Spread(NamedTuple):
    """``covariance`` (p, p) of the coordinates, zero for those that are not free; how many pixels
    each independent one stands for, ``growth``, and each of the light pass, ``upsampled``; what may
    be wrong, and how unlike noise what is left is."""

    covariance: np.ndarray
    growth: float
    upsampled: float
    suspects: list[diagnostics.Suspect]
    left: Misfit


def spread(found: Found) -> Spread:
    """How well the coordinates are known, all that is known to be correlated or doubtful counted
    in."""
    left = misfit(found.evidence.prediction, found.observation)
    if found.scatter is not None:
        known = found.evidence.covariance(found.problem.free)
        grown = _growth(found.scatter, known, found.problem.free)
        block = diagnostics.jpeg(found.problem.picture)
        return Spread(found.scatter, grown, 1.0, [] if block is None else [block], left)
    # The pixels of an upsampled pass share its texels and say no more than these.
    upsampled = float(
        np.prod(found.problem.picture.size) / np.prod(found.problem.picture.mask.shape[:2])
    )
    covariance, growth, suspects = _correlated(
        found, found.evidence.covariance(found.problem.free), left
    )
    covariance = covariance * max(1.0, upsampled / growth)
    for shift in found.shifts:
        covariance += np.outer(shift, shift)
    growth = max(growth, upsampled, found.problem.picture.repeats)
    return Spread(covariance, growth, upsampled, suspects, left)


def verdict(
    found: Found,
    notes: tuple[str, ...],
    files: dict[str, dict[str, str]],
    timing: dict[str, float],
) -> FitResult:
    """The result of a fit; ``notes`` and ``files`` are those of its inputs, ``timing`` seconds."""
    problem, settled, at = found.problem, found.settled, found.evidence
    picture, pixels = problem.picture, np.asarray(found.observation.pixels)
    errs = spread(found)
    left = errs.left
    solution = Solution(
        settled.coordinates, errs.covariance, problem.free, problem.held, found.opened
    )
    told = estimates(problem.model, solution, problem.model.used)
    objection = found.objection
    if picture.foreign and not objection:
        objection = _from_anywhere(found.starts_agreed, told.params)
    target = picture.levels.reshape(-1, picture.channels)[pixels].reshape(-1)
    error = np.clip(at.prediction, 0, LEVELS) - target
    rmse = float(np.sqrt(np.mean(error.astype(np.float64) ** 2)))
    # A pass that is upsampled was rounded once before.
    allowed = WITHIN_ROUNDING * (2 if errs.upsampled > 1 else 1)
    trusted = settled.sigma <= allowed or left.like_noise or found.scatter is not None
    remarks = found.remarks
    if picture.foreign and not objection:
        # A person is told, and errors are widened: a model so rough is never all of a picture.
        remarks += () if trusted else (STRUCTURED.format(settled.sigma, left.correlation),)
        trusted = True
    trusted = trusted and not objection
    # One line of pixels, repeated, has so many explanations that its errors say nothing.
    a_line = is_a_line(picture) and int(problem.free.sum()) > 2
    converged = trusted and settled.quiet and not a_line
    return FitResult(
        converged=converged,
        message=objection or _message(settled, trusted, left, a_line),
        model=told.model,
        params=told.params,
        combined=told.combined,
        covariance=told.covariance,
        correlations=_correlations(problem.names, told.covariance),
        undetermined=told.undetermined,
        warnings=(*(s.words for s in errs.suspects), *remarks),
        notes=notes,
        noise_levels=settled.sigma,
        rmse_levels=rmse,
        psnr_db=float(20 * np.log10(LEVELS / max(rmse, 1e-6))),
        pixels=len(pixels),
        pixels_effective=len(pixels) / errs.growth,
        pixels_clipped=int((picture.clipped & picture.valid).sum()),
        residual_correlation=left.correlation,
        residual_tails=left.tails,
        log_likelihood=settled.log_likelihood,
        timing_s=timing | {"solve": timing["solve"] - timing["compile"]},
        picture=picture,
        free=problem.free,
        held=told.held,
        seed=problem.seed,
        starts_agreed=found.starts_agreed,
        simulated=found.scatter is not None,
        inputs=files,
    )


def _from_anywhere(agreed: tuple[int, int] | None, params: dict[str, Estimate]) -> str:
    """Why light of no known place, which no other of the starts that were tried found either, is no
    rays; empty where its place is known."""
    at = [params[name] for name in ("light_x", "light_y") if name in params]
    if agreed is None or agreed[0] > 1 or all((e.stderr or 0) <= ANYWHERE for e in at):
        return ""
    return FROM_ANYWHERE.format(*(v for e in at for v in (e.value, e.stderr or 0)))


def _growth(covariance: np.ndarray, before: np.ndarray, free: np.ndarray) -> float:
    """By how much variances grew, the geometric mean over coordinates."""
    ratio = np.diag(covariance)[free] / np.maximum(np.diag(before)[free], 1e-30)
    return float(np.exp(np.mean(np.log(np.maximum(ratio, 1.0))))) if free.any() else 1.0


def _correlated(
    found: Found, covariance: np.ndarray, left: Misfit
) -> tuple[np.ndarray, float, list[diagnostics.Suspect]]:
    """The covariance (p, p) with correlation allowed for, how many pixels each independent one
    stands for, and what may be wrong. Untouched where neighbours err independently."""
    problem, settled, observation = found.problem, found.settled, found.observation
    if settled.sigma <= WITHIN_ROUNDING:
        return covariance, 1.0, []
    block = diagnostics.jpeg(found.problem.picture)
    suspects = [] if block is None else [block]
    if sandwich.white(found.evidence.score, observation):
        return covariance, 1.0, suspects
    tangent = tangent_at(settled.coordinates, problem, observation)
    slope = sandwich.slope_covariance(tangent, found.evidence.score, settled.sigma, observation)
    covariance, growth = sandwich.widened(covariance, slope, found.problem.free)
    model = model_at(settled.coordinates, problem.held, problem.model)
    if found.inquire and (not left.like_noise or settled.sigma > 1):
        pixels = np.asarray(observation.pixels)
        if found.remedy is not None:
            return covariance, growth, [*suspects, found.remedy]
        likely = diagnostics.diagnose(found.problem.picture, model, pixels, tangent)
        suspects += diagnostics.named(likely)
    return covariance, growth, suspects


def is_a_line(picture: Picture) -> bool:
    """Whether the picture is one line of pixels, or a few, repeated; one that is empty but for a
    part of it is not."""
    return bool(picture.repeats >= A_LINE)


def _message(settled: Settled, trusted: bool, left: Misfit, a_line: bool) -> str:
    if not trusted:
        return (
            f"the residual is not noise (of {settled.sigma:.2f} levels, neighbours correlated by "
            f"{left.correlation:.2f}, tails of {left.tails:.1f} where noise has 3): the shader, "
            "mask or transfer may be another, or the best point was missed; try --start"
        )
    if a_line:
        return (
            "target and mask are one line of pixels, repeated: too many parameters explain it "
            "alike; hold some with --fix"
        )
    if not settled.quiet:
        return "the steps had not died down when the fit stopped; try --start near this answer"
    return "converged"


def _correlations(names: list[str], covariance: np.ndarray) -> dict[str, float]:
    """Correlations above 0.1 in size, largest first."""
    size = np.sqrt(np.diag(covariance))
    pairs = {
        f"{names[i]},{names[j]}": float(covariance[i, j] / (size[i] * size[j]))
        for i in range(len(names))
        for j in range(i + 1, len(names))
        if np.isfinite(covariance[i, j]) and size[i] > 0 and size[j] > 0
    }
    ordered = sorted(pairs.items(), key=lambda item: -abs(item[1]))
    return {pair: value for pair, value in ordered if abs(value) > 0.1}

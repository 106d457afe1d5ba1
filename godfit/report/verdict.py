"""The result of a settled fit: values, errors, open parameters, and whether it converged."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from godfit.errors import Remark
from godfit.inference import diagnostics, sandwich
from godfit.inference.estimates import Estimate, Estimates, Solution, estimates
from godfit.inference.evaluate import model_at
from godfit.inference.fitted import Found
from godfit.inference.information import Misfit, misfit, shares
from godfit.inference.noise import WITHIN_ROUNDING
from godfit.inference.observation import Picture
from godfit.inference.settle import Settled
from godfit.inference.solver import tangent_at
from godfit.io.image import LEVELS
from godfit.report.result import FitResult
from godfit.scattering.parameters import is_light

UNDETERMINED_PLACE = 0.1
"""Standard error of the light's position, as a share of the picture, from which it is
undetermined."""
NO_POSITION = (
    "no rays were found: the position of the light is undetermined ({:.2f} +- {:.2f}, "
    "{:.2f} +- {:.2f} of the picture)"
)
"""Message with the position (u, v) of the light and its standard errors."""
LINE_REPEATS = 16
"""Times that a line of pixels is repeated, at least, for the picture to be one line."""
COARSE_NOISE = 1.0
"""Noise in levels from which a fit is diagnosed even where its residual resembles noise."""
STRUCTURED = (
    "the residual is not noise ({:.2f} levels, neighbours correlated by {:.2f}): background or "
    "occluders differ from the model"
)
"""Remark with the noise in levels and the correlation."""
SAME_PLACE = 5.0
"""Standard errors within which two lights are at one place: farther they are two."""
SAME_PLACE_SHARE = 0.005
"""The same as a share of the picture: a pixel or two of a large one."""
LEAST_VARIANCE = 1e-30
"""Stands for a variance of zero in a ratio."""
LEAST_CORRELATION = 0.1
"""Correlation of two parameters, in size, from which it is reported."""


class Spread(NamedTuple):
    """``covariance`` (p, p) of the coordinates, zero for those that are not free; how many pixels
    each independent one stands for, ``growth``; how many pixels each of the light pass stands for,
    ``upsampled``; possible defects, ``suspects``; and the ``residual_misfit``."""

    covariance: np.ndarray
    growth: float
    upsampled: float
    suspects: list[diagnostics.Suspect]
    residual_misfit: Misfit


def spread(found: Found) -> Spread:
    """The covariance of the coordinates, with known correlation and known doubts included."""
    residual_misfit = misfit(found.evidence.prediction, found.observation)
    if found.scatter is not None:
        known = found.evidence.covariance(found.problem.free)
        grown = _growth(found.scatter, known, found.problem.free)
        block = diagnostics.jpeg(found.problem.picture)
        scatter = found.scatter + _of_shifts(found)
        return Spread(scatter, grown, 1.0, [] if block is None else [block], residual_misfit)
    # The pixels of an upsampled pass share its texels: they are no more independent than these.
    upsampled = 1 / found.problem.picture.independent(found.problem.model)
    covariance, growth, suspects = _correlated(
        found, found.evidence.covariance(found.problem.free), residual_misfit
    )
    covariance = covariance * max(1.0, upsampled / growth)
    covariance = covariance + _of_shifts(found)
    growth = max(growth, upsampled, found.problem.picture.repeats)
    return Spread(covariance, growth, upsampled, suspects, residual_misfit)


def _of_shifts(found: Found) -> np.ndarray:
    """(p, p) covariance of the coordinates by the shifts of the fit."""
    shifts = np.reshape(found.shifts, (-1, len(found.problem.free)))
    return shifts.T @ shifts


def verdict(
    found: Found,
    notes: tuple[str, ...],
    files: dict[str, dict[str, str]],
    timing: dict[str, float],
) -> FitResult:
    """The result of a fit; ``notes`` and ``files`` are those of its inputs, ``timing`` seconds."""
    problem, settled, at = found.problem, found.settled, found.evidence
    picture, pixels = problem.picture, np.asarray(found.observation.pixels)
    uncertainty = spread(found)
    residual_misfit = uncertainty.residual_misfit
    solution = Solution(
        settled.coordinates, uncertainty.covariance, problem.free, problem.held, found.opened
    )
    estimated = estimates(problem.model, solution, problem.model.used)
    fitted = [name for name, moves in zip(problem.names, problem.free, strict=True) if moves]
    objection = found.objection
    if picture.foreign and not objection:
        objection = _undetermined_place(found.starts_agreed, estimated.params)
    target = picture.levels.reshape(-1, picture.channels)[pixels].reshape(-1)
    error = np.clip(at.prediction, *picture.ends) - target
    rmse = float(np.sqrt(np.mean(error.astype(np.float64) ** 2)))
    # An upsampled pass was rounded once more, before.
    allowed = WITHIN_ROUNDING * (2 if uncertainty.upsampled > 1 else 1)
    trusted = settled.sigma <= allowed or residual_misfit.like_noise or found.scatter is not None
    remarks = found.remarks
    if picture.foreign and not objection:
        # A model so rough never explains all of a picture: the user is warned, errors are widened.
        remarks += (
            ()
            if trusted
            else (
                Remark(STRUCTURED.format(settled.sigma, residual_misfit.correlation), "structured"),
            )
        )
        trusted = True
    trusted = trusted and not objection
    # One line of pixels, repeated, has so many explanations that its errors are meaningless.
    a_line = is_a_line(picture) and int(problem.free.sum()) > 2
    if (problem.free.any() or found.opened) and not objection:
        objection = nothing_there(picture, estimated)
    converged = trusted and settled.quiet and not a_line and not objection
    return FitResult(
        converged=converged,
        message=objection or _message(settled, trusted, residual_misfit, a_line),
        model=estimated.model,
        params=estimated.params,
        combined=estimated.combined,
        covariance=estimated.covariance,
        correlations=_correlations(problem.names, estimated.covariance),
        undetermined=estimated.undetermined,
        warnings=(*(Remark(s.words, s.name) for s in uncertainty.suspects), *remarks),
        notes=(*notes, *_clipped_ends(picture), *estimated.model.notes(fitted)),
        noise_levels=settled.sigma,
        rmse_levels=rmse,
        psnr_db=float(20 * np.log10(LEVELS / max(rmse, 1e-6))),
        pixels=len(pixels),
        pixels_effective=len(pixels) / uncertainty.growth,
        pixels_clipped=int((picture.clipped & picture.valid).sum()),
        residual_correlation=residual_misfit.correlation,
        residual_tails=residual_misfit.tails,
        log_likelihood=settled.log_likelihood,
        timing_s=timing,
        picture=picture,
        free=problem.free,
        held=estimated.held,
        seed=problem.seed,
        starts_agreed=found.starts_agreed,
        simulated=found.scatter is not None,
        pass_scale=found.pass_scale,
        prior=problem.prior,
        mask_estimated=found.mask_estimated,
        inputs=files,
        where=_where(found, estimated),
    )


def _where(found: Found, estimated: Estimates) -> dict[str, np.ndarray]:
    """The share (rows, columns) of the information on each determined parameter by cell."""
    problem = found.problem
    maps = shares(found.evidence.cells, problem.free, estimated.slopes)
    known = {name for name, e in estimated.params.items() if e.stderr is not None}
    by_name = zip(problem.names, maps, strict=True)
    return {name: share for name, share in by_name if name in known and share is not None}


def nothing_there(picture: Picture, estimated: Estimates) -> str:
    """Why the picture says nothing about the parameters; empty where it does."""
    shown = picture.levels[picture.valid]
    if len(shown) and np.ptp(shown, axis=0).max() == 0:
        level = shown[0].max()
        clipped = ", the brightest there is" if picture.clipped.any() else ""
        return (
            f"every pixel of the target has the same value ({level:g} of {LEVELS:g}{clipped}): it "
            "determines no light; give a frame with rays"
        )
    if np.ptp(picture.mask.reshape(-1, picture.mask.shape[-1]), axis=0).max(initial=0) == 0:
        return (
            f"every pixel of the mask has the same value ({picture.mask.max():g} of 1): it casts "
            "no rays; give the mask that the light pass reads, white where light comes through"
        )
    pair = same_place(estimated)
    if pair:
        return (
            f"{pair[0]} and {pair[1]} are at the same place: one light explains the picture; give "
            "fewer --lights"
        )
    known = (*estimated.params.values(), *estimated.combined.values())
    if all(estimate.stderr is None for estimate in known):
        return "the picture determines no parameter; compare target and mask by eye"
    return ""


def same_place(estimated: Estimates) -> tuple[str, str] | None:
    """Two lights whose positions differ by less than SAME_PLACE of their errors; None without such.
    As one light in two halves their errors are large against that of a single one, so that the
    positions must also agree within SAME_PLACE_SHARE of the picture."""
    params = estimated.params
    stems = [name.removesuffix("_x") for name in params if is_light(name) and name.endswith("_x")]
    for one, other in itertools.combinations(stems, 2):
        pairs = [(params[f"{one}_{c}"], params[f"{other}_{c}"]) for c in "xy"]
        apart = [abs(a.value - b.value) for a, b in pairs]
        errors = [math.hypot(a.stderr or 0, b.stderr or 0) for a, b in pairs]
        if all(
            d < min(SAME_PLACE * e, SAME_PLACE_SHARE) for d, e in zip(apart, errors, strict=True)
        ):
            return one, other
    return None


def _clipped_ends(picture: Picture) -> tuple[str, ...]:
    """A note for each end of the scale that was found in the picture."""
    shown, notes = picture.levels[picture.valid], []
    for level, name in ((picture.ceiling, "largest"), (picture.floor, "smallest")):
        if level is not None:
            count = int((shown == np.float32(level)).any(-1).sum())
            value = f"{level:g}" if picture.half > 0 else f"{level / LEVELS:g}"
            words = f"{count:,} pixels share the {name} value, {value}: taken as clipped"
            notes.append(Remark(words, "clipped"))
    return tuple(notes)


def _undetermined_place(agreed: tuple[int, int] | None, params: dict[str, Estimate]) -> str:
    """Why there are no rays: the position of the light is undetermined and no other start found it.
    Empty where the position is known."""
    at = [params[name] for name in ("light_x", "light_y") if name in params]
    if agreed is None or agreed[0] > 1 or all((e.stderr or 0) <= UNDETERMINED_PLACE for e in at):
        return ""
    return NO_POSITION.format(*(v for e in at for v in (e.value, e.stderr or 0)))


def _growth(covariance: np.ndarray, before: np.ndarray, free: np.ndarray) -> float:
    """The growth of variances, the geometric mean over coordinates."""
    ratio = np.diag(covariance)[free] / np.maximum(np.diag(before)[free], LEAST_VARIANCE)
    return float(np.exp(np.mean(np.log(np.maximum(ratio, 1.0))))) if free.any() else 1.0


def _correlated(
    found: Found, covariance: np.ndarray, residual_misfit: Misfit
) -> tuple[np.ndarray, float, list[diagnostics.Suspect]]:
    """The covariance (p, p) with correlation included, how many pixels each independent one stands
    for, and possible defects. Unchanged where neighbours err independently."""
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
    if found.inquire and (not residual_misfit.like_noise or settled.sigma > COARSE_NOISE):
        pixels = np.asarray(observation.pixels)
        if found.remedy is not None:
            return covariance, growth, [*suspects, found.remedy]
        likely = diagnostics.diagnose(found.problem.picture, model, pixels, tangent)
        suspects += diagnostics.named(likely)
    return covariance, growth, suspects


def is_a_line(picture: Picture) -> bool:
    """Whether the picture is one line of pixels, or a few, repeated. A picture that is empty but
    for a part of it is not."""

    return bool(picture.repeats >= LINE_REPEATS)


def _message(settled: Settled, trusted: bool, residual_misfit: Misfit, a_line: bool) -> str:
    if not trusted:
        return (
            f"the residual is not noise (of {settled.sigma:.2f} levels, neighbours correlated by "
            f"{residual_misfit.correlation:.2f}, tails of {residual_misfit.tails:.1f} where noise "
            "has 3): the shader, mask or transfer may be another, or the search ended in a wrong "
            "minimum; try --start"
        )
    if a_line:
        return (
            "target and mask are one line of pixels, repeated: too many parameters explain it "
            "alike; hold some with --fix"
        )
    if not settled.quiet:
        return "the steps had not become small when the fit stopped; try --start near this answer"
    return "converged"


def _correlations(names: list[str], covariance: np.ndarray) -> dict[str, float]:
    """Correlations above LEAST_CORRELATION in size, largest first."""
    size = np.sqrt(np.diag(covariance))
    pairs = {
        f"{names[i]},{names[j]}": float(covariance[i, j] / (size[i] * size[j]))
        for i in range(len(names))
        for j in range(i + 1, len(names))
        if np.isfinite(covariance[i, j]) and size[i] > 0 and size[j] > 0
    }
    ordered = sorted(pairs.items(), key=lambda item: -abs(item[1]))
    return {pair: value for pair, value in ordered if abs(value) > LEAST_CORRELATION}

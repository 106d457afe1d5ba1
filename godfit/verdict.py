"""What the settled fit is worth: values, errors, what is open, and whether to believe it."""

from __future__ import annotations

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from godfit import correlated, diagnostics, search
from godfit.inference import Evidence, Misfit, misfit
from godfit.models import AbstractModel, Vector
from godfit.observation import LEVELS, Observation, Picture
from godfit.result import Estimate, FitResult
from godfit.solver import linearise

STRUCTURED = (
    "what is left is not noise ({:.2f} levels, neighbours correlated by {:.2f}): background or "
    "occluders are more than the model has"
)


@dataclass
class Found:
    """Where a fit ended. ``free`` and ``held`` (p,) say what moved and where the rest was held;
    ``opened`` are the coordinates that the picture leaves open, each with those it trades with."""

    model: AbstractModel
    picture: Picture
    seen: Observation
    settled: search.Settled
    at: Evidence
    free: np.ndarray
    held: np.ndarray
    opened: list[tuple[int, list[int]]]
    inquire: bool = True
    # What may be wrong, and why the answer is not to be believed at all, in words.
    remarks: tuple[str, ...] = ()
    objection: str = ""
    # Of the coordinates (p,), where what was taken as known is a little different.
    shifts: tuple[np.ndarray, ...] = ()
    starts_agreed: tuple[int, int] | None = None
    other_transfer: bool = False


def verdict(
    found: Found,
    used: np.ndarray,
    notes: tuple[str, ...],
    files: dict[str, dict[str, str]],
    timing: dict[str, float],
    seed: int = 0,
) -> FitResult:
    """The result; ``used`` (p,) says which parameters the shader has, ``seed`` how pixels were
    chosen."""
    model, picture, seen = found.model, found.picture, found.seen
    settled, at, free, held = found.settled, found.at, found.free, found.held
    open_, pixels = found.opened, np.asarray(found.seen.pixels)
    names = list(model.parameters)
    opened = [i for i, _ in open_]
    z = np.where(np.isnan(held), settled.coordinates, held)
    z = np.where(np.isin(np.arange(len(names)), opened), z, settled.coordinates)
    # An open parameter is held only for want of better: what it would move is not known either.
    loose = np.where(np.isin(np.arange(len(names)), opened), np.nan, held).astype(np.float32)
    fitted, values, by_coordinate = _parameters(model, z.astype(np.float32), loose)
    values, by_coordinate = np.asarray(values), np.asarray(by_coordinate, np.float64)
    # The pixels of an upsampled pass share its texels and say no more than these.
    low, full = np.prod(picture.mask.shape[:2]), np.prod(picture.size)
    left = misfit(at.prediction, seen)
    by_pixel, growth, suspects = _correlated(found, at.covariance(free), left)
    by_pixel *= max(1.0, full / low / growth)
    growth = max(growth, full / low, picture.repeats)
    for shift in found.shifts:
        by_pixel += np.outer(shift, shift)
    covariance = by_coordinate @ by_pixel @ by_coordinate.T
    # A parameter that an open coordinate would change is not known, however well the rest is.
    unknown = (
        (np.abs(by_coordinate[:, opened]) > 0).any(1) if opened else np.zeros(len(names), bool)
    )
    unknown |= np.isin(np.arange(len(names)), opened) | (np.diag(covariance) <= 0)
    stderr = np.sqrt(np.where(unknown, np.nan, np.diag(covariance)))
    covariance[unknown] = covariance[:, unknown] = np.nan
    lower, upper = (np.asarray(b, np.float32) for b in model.bounds())
    # Within its error of a bound, a value is as good as on it.
    error = np.sqrt(np.diag(by_pixel))
    at_bound = (settled.coordinates - lower <= error) | (upper - settled.coordinates <= error)
    params = {
        name: Estimate(
            float(values[i]),
            None if unknown[i] else float(stderr[i]),
            fixed=bool(not np.isnan(held[i]) and i not in opened),
            at_bound=bool(free[i] and at_bound[i]),
        )
        for i, name in enumerate(names)
        if used[i]
    }
    target = picture.levels.reshape(-1, picture.channels)[pixels].reshape(-1)
    error = np.clip(at.prediction, 0, LEVELS) - target
    rmse = float(np.sqrt(np.mean(error.astype(np.float64) ** 2)))
    # A pass that is upsampled was rounded once before.
    allowed = search.WITHIN_ROUNDING * (2 if low < full else 1)
    trusted = settled.sigma <= allowed or left.like_noise
    remarks = found.remarks
    if picture.foreign and not found.objection:
        # A person is told, and errors are widened: a model so rough is never all of a picture.
        remarks += () if trusted else (STRUCTURED.format(settled.sigma, left.correlation),)
        trusted = True
    trusted = trusted and not found.objection
    # One line of pixels, repeated, has so many explanations that its errors say nothing.
    a_line = picture.repeats > 1 and int(free.sum()) > 2
    converged = trusted and settled.quiet and not a_line
    return FitResult(
        converged=converged,
        message=found.objection or _message(settled, trusted, left, a_line),
        model=fitted,
        params=params,
        covariance=covariance,
        correlations=_correlations(names, covariance),
        undetermined=_sentences(open_, names, values, model.product),
        warnings=(*(s.words for s in suspects), *remarks),
        notes=notes,
        noise_levels=settled.sigma,
        rmse_levels=rmse,
        psnr_db=float(20 * np.log10(LEVELS / max(rmse, 1e-6))),
        pixels=len(pixels),
        pixels_effective=len(pixels) / growth,
        pixels_clipped=int((picture.clipped & picture.valid).sum()),
        residual_correlation=left.correlation,
        residual_tails=left.tails,
        log_likelihood=settled.log_likelihood,
        timing_s=timing | {"solve": timing["solve"] - timing["compile"]},
        picture=picture,
        free=free,
        held=held_at(held, opened, values),
        seed=seed,
        starts_agreed=found.starts_agreed,
        inputs=files,
    )


def _correlated(
    found: Found, covariance: np.ndarray, left: Misfit
) -> tuple[np.ndarray, float, list[diagnostics.Suspect]]:
    """The covariance (p, p) with correlation allowed for, how many pixels each independent one
    stands for, and what may be wrong. Untouched where neighbours err independently."""
    settled, seen = found.settled, found.seen
    if settled.sigma <= search.WITHIN_ROUNDING:
        return covariance, 1.0, []
    block = diagnostics.jpeg(found.picture)
    suspects = [] if block is None else [block]
    if correlated.white(found.at.score, seen):
        return covariance, 1.0, suspects
    scale = found.model.scales(settled.coordinates)
    prediction, jacobian = linearise(settled.coordinates, found.held, scale, found.model, seen)
    tangent = search.Tangent(np.asarray(prediction), np.asarray(jacobian), scale)
    slope = correlated.slope_covariance(tangent, found.at.score, settled.sigma, seen)
    covariance, growth = correlated.widened(covariance, slope, found.free)
    model = found.model.moved(jnp.asarray(settled.coordinates), jnp.asarray(found.held))
    if found.inquire and (not left.like_noise or settled.sigma > 1):
        pixels = np.asarray(seen.pixels)
        likely = diagnostics.diagnose(found.picture, model, pixels, tangent)
        if found.other_transfer:
            words = diagnostics.WORDS["transfer"]
            likely = [diagnostics.Suspect(1.0, "transfer", words)]
        suspects += diagnostics.named(likely)
    return covariance, growth, suspects


def held_at(held: np.ndarray, opened: list[int], values: np.ndarray) -> np.ndarray:
    """(p,) where parameters are held, those that are open where they were left; NaN if free."""
    return np.where(np.isin(np.arange(len(held)), opened), values, held).astype(np.float32)


@eqx.filter_jit
def _parameters(model: AbstractModel, coordinates: Vector, held: Vector):
    """The model at ``coordinates``, its parameters (p,), their derivatives (p, p) by coordinate."""

    def values(z):
        return jnp.stack(list(model.moved(z, held).values().values()))

    return model.moved(coordinates, held), values(coordinates), jax.jacfwd(values)(coordinates)


def _message(settled: search.Settled, trusted: bool, left: Misfit, a_line: bool) -> str:
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


def _sentences(
    open_: list[tuple[int, list[int]]],
    names: list[str],
    values: np.ndarray,
    product: tuple[str, str],
) -> tuple[str, ...]:
    """What is left open, in words."""
    opened = [index for index, _ in open_]
    said, alone = [], []
    for index, partners in open_:
        rest = [names[i] for i in partners if i not in opened]
        other = names.index(product[1])
        if names[index] == product[0] and other not in opened:
            both = values[index] * values[other]
            said.append(f"only {product[0]}*{product[1]} is determined ({both:.6g})")
        elif rest:
            together = " and ".join([names[index], *rest])
            said.append(f"only a combination of {together} is determined")
        else:
            alone.append(index)
            continue
        said[-1] += f"; {names[index]} was held at {values[index]:.6g}"
    if alone:
        held = ", ".join(f"{names[i]} (held at {values[i]:.6g})" for i in alone)
        said.append(f"not determined by this picture: {held}")
    return tuple(said)

"""What a picture went through after its light was summed, done to the fitted picture as well.

JPEG smooths edges and rounds the cosines of whole blocks (ITU-T T.81); a light pass at lower
resolution is rounded to bytes before it is enlarged. What they leave is no noise: an estimate made
as if it were is off in one direction, by many of its errors. But they are known: the fitted
picture, treated as the target was, and fitted in the same way, is off by as much. That is taken
away (indirect inference: Gourieroux, Monfort & Renault, J. Appl. Econometrics 8 (1993), S85), and
pictures of points around scatter as the answer does (parametric bootstrap).
"""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from scipy import ndimage
from scipy.special import ndtri, stdtrit

from godfit.inference.fitted import Found
from godfit.inference.information import evidence
from godfit.inference.noise import EXPLAINED, WITHIN_ROUNDING, log_likelihood_at
from godfit.inference.observation import Picture, render
from godfit.inference.settle import Settled
from godfit.inference.solver import Intervals, solve_tangent, tangent_at
from godfit.io.image import LEVELS, encode
from godfit.io.jpeg import compressed, settings_of, was_jpeg
from godfit.models.base import AbstractModel
from godfit.models.mitchell import Mitchell

# Pictures made for each correction, the first of them of points so far away, in the coordinates'
# scales and as a share of the picture: beyond a pixel or so a tangent says nothing.
DRAWS, FIRST, AWAY, PART = 18, 5, 0.02, 5.0
# Values, most, that estimates are made from.
VALUES = 1 << 18
# Of what is 8-bit, half the distance between two levels.
HALF = 0.5
CORRECTIONS = 8
# Of what those pictures differ among themselves, the most by which the answer's may differ from the
# target.
ALIKE = 0.85
# Of the noise that was found without it, the most by which a corrected answer may differ.
WORSE = 2.0
# What lies in the middle of two levels to within this much was rounded up or down, nobody knows.
TIE = 1e-3
# (h, w, c) levels of a model's picture after all that the target went through; what of it is not
# known is drawn.
Process = Callable[[AbstractModel, np.random.Generator], np.ndarray]


def process_of(picture: Picture, model: AbstractModel, sigma: float) -> Process | None:
    """What the target went through, where that is known and more than rounding is left."""
    if not np.isclose(picture.half, HALF) or sigma <= EXPLAINED:
        return None
    if was_jpeg(picture.levels[..., 0]):
        settings = settings_of(picture.levels) if sigma > WITHIN_ROUNDING else None
        if settings is None:
            return None
        return lambda at, rng: compressed(picture.rendered(at), *settings)
    if picture.mask.shape[:2] != picture.size and isinstance(model, Mitchell):
        return lambda at, rng: enlarged_bytes(picture, at, rng)
    return None


def enlarged_bytes(picture: Picture, model: AbstractModel, rng: np.random.Generator) -> np.ndarray:
    """(h, w, c) levels, rounded, of a picture whose light pass was stored in bytes and enlarged.

    Between bytes that were enlarged twofold, one value in sixteen lies in the middle of two levels,
    and the last bit of the arithmetic decides. All such values rounded alike would shift the
    picture by more than the fit resolves, so how many go up is drawn for each picture."""
    assert isinstance(model, Mitchell)
    low = np.atleast_3d(render(model, picture.mask, None, picture.mask.shape[:2]))
    stored = np.floor(low * LEVELS + 0.5) / LEVELS
    ratio = (*(n / m for n, m in zip(picture.size, low.shape[:2], strict=True)), 1)
    light = ndimage.zoom(stored, ratio, order=1, mode="nearest", grid_mode=True)
    background = None if picture.background is None else jnp.asarray(picture.background)
    image = np.asarray(model.composite(jnp.asarray(light, jnp.float32), background, None))
    levels = LEVELS * np.asarray(encode(np.clip(image, 0, 1), picture.transfer))
    levels = np.broadcast_to(levels, picture.levels.shape)
    up = rng.uniform(size=levels.shape) < rng.uniform()
    return np.floor(levels + 0.5 + np.where(up, TIE, -TIE)).astype(np.float32)


def corrected(found: Found) -> Found:
    """The fit with what the target went through taken away, and with the scatter that this causes;
    as it was where that is not known, or where the fitted picture, treated so, is another than the
    target."""
    problem, settled = found.problem, found.settled
    picture, free = problem.picture, problem.free
    process = process_of(picture, problem.model, settled.sigma)
    if process is None or not free.any():
        return found
    bounds = [np.asarray(b, np.float64) for b in problem.model.bounds()]
    first = settled.coordinates.astype(np.float64)
    z, errors, apart = first, np.zeros((0, len(first))), 0.0
    for _ in range(CORRECTIONS):
        estimate, errors, apart = _simulated(found, z, process)
        before, z = z, np.where(free, np.clip(estimate - errors.mean(0), *bounds), first)
        if np.all(np.abs(z - before) <= errors.std(0)):
            break
    else:
        return found
    off = _processed_at(found, z, process, np.random.default_rng(1)) - picture.levels
    left = np.sqrt(np.mean(off[picture.valid] ** 2))
    alike = left <= ALIKE * max(apart, 2 * WITHIN_ROUNDING)
    # Under a wrong model corrections may lead to where pictures are so odd that any are alike.
    if not alike or left > WORSE * max(settled.sigma, HALF):
        return found
    tangent = tangent_at(z.astype(np.float32), problem, found.observation)
    likelihood = log_likelihood_at(tangent.prediction, found.observation, settled.sigma)
    settled = Settled(z.astype(np.float32), settled.sigma, likelihood, quiet=True)
    at = evidence(settled, tangent, found.observation)
    # So few draws leave their own covariance in doubt, and the mean that was taken away.
    count = len(errors)
    wider = (stdtrit(count - 1, 0.975) / ndtri(0.975)) ** 2 * (1 + 1 / count)
    scatter = wider * np.atleast_2d(np.cov(errors.T))
    return found.replaced(settled=settled, evidence=at, scatter=scatter)


def _processed_at(
    found: Found, z: np.ndarray, process: Process, rng: np.random.Generator
) -> np.ndarray:
    """(h, w, c) the picture of coordinates ``z`` after the process; the target's where that is
    ignored."""
    picture = found.problem.picture
    model = found.problem.at(np.asarray(z, np.float32))
    return np.where(picture.valid[..., None], process(model, rng), picture.levels)


def _simulated(
    found: Found, z: np.ndarray, process: Process
) -> tuple[np.ndarray, np.ndarray, float]:
    """(p,) the estimate from the target on the tangent at ``z``, (draws, p) by how much such
    estimates from processed pictures of points around ``z`` are off, and the root mean square
    (levels) by which two such pictures differ but for what their points make them."""
    problem, observation = found.problem, found.observation
    tangent = tangent_at(z.astype(np.float32), problem, observation)
    free = np.flatnonzero(problem.free)
    rng = np.random.default_rng(0)
    errors: list[np.ndarray] = []
    left: list[np.ndarray] = []
    pixels, channels = np.asarray(observation.pixels), problem.picture.channels
    rows = np.arange(len(tangent.prediction))
    if len(rows) > VALUES:
        rows = np.sort(rng.choice(len(rows), VALUES, replace=False))
    tangent = tangent.only(rows)
    centre = z.astype(np.float32)
    away = min(AWAY, PART / max(problem.picture.size))

    def estimate(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
        intervals = Intervals(lo, hi, observation.foreign)
        return solve_tangent(centre, problem, tangent, intervals, found.settled.sigma).coordinates

    for draw in range(DRAWS):
        step = np.zeros(len(z))
        if draw < FIRST:
            step[free] = away * rng.standard_normal(len(free))
        else:
            block = np.atleast_2d(np.cov(np.array(errors)[:, free].T))
            step[free] = rng.multivariate_normal(np.zeros(len(free)), block, check_valid="ignore")
        there = np.clip(z + step * tangent.scale, *problem.model.bounds())
        levels = _processed_at(found, there, process, rng).reshape(-1, channels)[pixels]
        levels = levels.ravel()[rows]
        lo, hi = levels - HALF, levels + HALF
        lo, hi = np.where(lo < 0, -np.inf, lo), np.where(hi > LEVELS, np.inf, hi)
        end = estimate(lo.astype(np.float32), hi.astype(np.float32))
        errors.append((end - there) / tangent.scale)
        left.append(levels - tangent.moved(there - z))
    spread = float(np.sqrt(np.mean((np.array(left) - np.mean(left, 0)) ** 2) * DRAWS / (DRAWS - 1)))
    own = estimate(np.asarray(observation.lo)[rows], np.asarray(observation.hi)[rows])
    return own.astype(np.float64), np.array(errors) * tangent.scale, np.sqrt(2) * spread

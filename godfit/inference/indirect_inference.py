"""Bias of processing after the light was summed, corrected by processing the fitted picture too.

JPEG smooths edges and rounds the cosines of whole blocks (ITU-T T.81). A light pass at lower
resolution is rounded to bytes before it is enlarged. The errors of both are not noise: an estimate
that takes them for noise is off in one direction, by many standard errors. But the processing is
known: the fitted picture, processed as the target was and fitted in the same way, is off by as
much. That bias is subtracted (indirect inference: Gourieroux, Monfort & Renault, J. Appl.
Econometrics 8 (1993), S85). Pictures of points around the answer give its scatter (parametric
bootstrap).
"""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

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

SIMULATED_PICTURES = 18
"""Pictures simulated for each correction: their covariance is then known to a third."""
SPREAD_PICTURES = 5
"""The first of them, whose points are drawn at SIMULATED_STEP; the rest follow their covariance."""
SIMULATED_STEP = 0.02
"""Distance of the first points, in the coordinates' scales, at most."""
SIMULATED_STEP_PIXELS = 5.0
"""Distance of the first points in pixels over the picture's size, at most: a tangent is no good
beyond a pixel or so."""
SIMULATED_VALUES = 1 << 18
"""Values that estimates are made from, at most, so that memory does not grow with the picture."""
HALF_LEVEL = 0.5
"""Half the distance between two levels of an 8-bit target, in levels."""
MAX_CORRECTIONS = 8
"""Corrections, at most: the fit is returned as it was if they do not converge."""
SAME_PICTURE = 0.85
"""Difference of the answer's picture from the target, at most, relative to the difference between
two simulated pictures: the target is then one of these."""
MAX_NOISE_RATIO = 2.0
"""Difference of a corrected picture from the target over the noise found without correction, at
most: a wrong model may lead to odd pictures, of which any two are similar."""
JITTER_PLACES = 16
"""Parts of the range of a jitter between whose ends sums are read linearly."""
SAME_SCATTER = 1.1
"""The same as SAME_PICTURE where the process is random: two pictures of one point then differ."""
TIE_LEVELS = 1e-3
"""Levels within which a value in the middle of two levels may be rounded up or down."""
Process = Callable[[AbstractModel, np.random.Generator], np.ndarray]
"""From a model to the (h, w, c) levels of its picture after all processing; details that are not
known are drawn."""


def process_of(picture: Picture, model: AbstractModel, sigma: float) -> Process | None:
    """The target's processing, where it is known and causes more error than rounding."""
    if not np.isclose(picture.half, HALF_LEVEL):
        return None
    if isinstance(model, Mitchell) and model.jitter is not None:
        return lambda at, rng: jittered_bytes(picture, at, rng)
    if sigma <= EXPLAINED:
        return None
    if was_jpeg(picture.levels[..., 0]):
        settings = settings_of(picture.levels) if sigma > WITHIN_ROUNDING else None
        if settings is None:
            return None
        return lambda at, rng: compressed(picture.rendered(at), *settings)
    if picture.pass_size(model) != picture.size and isinstance(model, Mitchell):
        return lambda at, rng: enlarged_bytes(picture, at, rng)
    return None


def enlarged_bytes(picture: Picture, model: AbstractModel, rng: np.random.Generator) -> np.ndarray:
    """(h, w, c) levels, rounded, of a picture whose light pass was stored in bytes and enlarged.

    Between bytes that were enlarged twofold, one value in sixteen lies in the middle of two levels,
    and the last bit of the arithmetic decides. If all such values were rounded to the same side,
    the picture would shift by more than the fit resolves. So the share that goes up is drawn for
    each picture."""
    from scipy import ndimage

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
    return np.floor(levels + 0.5 + np.where(up, TIE_LEVELS, -TIE_LEVELS)).astype(np.float32)


def jittered_bytes(picture: Picture, model: AbstractModel, rng: np.random.Generator) -> np.ndarray:
    """(h, w, c) levels, rounded, of a picture whose taps are moved by a random share of a step,
    another for each pixel. Sums in between are read from those at JITTER_PLACES + 1."""
    assert isinstance(model, Mitchell)
    assert model.jitter is not None
    h, w = picture.size
    half = 3**0.5 * float(model.jitter)
    lags = list(np.linspace(-half, half, JITTER_PLACES + 1))
    sums = model.moved_sums(picture.mask, lags, np.arange(h * w))
    place = rng.uniform(0, JITTER_PLACES, h * w)
    first = place.astype(int)
    low, high = (np.take_along_axis(sums, i[None], 0)[0] for i in (first, first + 1))
    levels = LEVELS * np.clip(low + (place - first) * (high - low), 0, 1)
    return np.floor(levels + 0.5).reshape(h, w, 1).astype(np.float32)


def corrected(found: Found) -> Found:
    """The fit with the bias of the target's processing subtracted, and with the scatter that the
    processing causes. The fit is returned as it was where the processing is not known, or where the
    fitted picture, processed, differs from the target."""
    problem, settled = found.problem, found.settled
    picture, free = problem.picture, problem.free
    process = process_of(picture, problem.model, settled.sigma)
    # Estimates that priors pull have no bias of the processing alone.
    if process is None or not free.any() or problem.prior:
        return found
    bounds = [np.asarray(b, np.float64) for b in problem.model.bounds()]
    first = settled.coordinates.astype(np.float64)
    z, errors, apart = first, np.zeros((0, len(first))), 0.0
    for _ in range(MAX_CORRECTIONS):
        estimate, errors, apart = _simulated(found, z, process)
        before, z = z, np.where(free, np.clip(estimate - errors.mean(0), *bounds), first)
        if np.all(np.abs(z - before) <= errors.std(0)):
            break
    else:
        return found
    off = _processed_at(found, z, process, np.random.default_rng(1)) - picture.levels
    rms = np.sqrt(np.mean(off[picture.valid] ** 2))
    if isinstance(problem.model, Mitchell) and problem.model.jitter is not None:
        same = rms <= SAME_SCATTER * apart
    else:
        same = rms <= SAME_PICTURE * max(apart, 2 * WITHIN_ROUNDING)
        # Under a wrong model corrections may lead to pictures so odd that any two are similar.
        same &= rms <= MAX_NOISE_RATIO * max(settled.sigma, HALF_LEVEL)
    if not same:
        return found
    tangent = tangent_at(z.astype(np.float32), problem, found.observation)
    likelihood = log_likelihood_at(tangent.prediction, found.observation, settled.sigma)
    settled = Settled(z.astype(np.float32), settled.sigma, likelihood, quiet=True)
    at = evidence(settled, tangent, found.observation)
    from scipy.special import ndtri, stdtrit

    # Few pictures leave their covariance uncertain, and the mean that was subtracted.
    count = len(errors)
    wider = (stdtrit(count - 1, 0.975) / ndtri(0.975)) ** 2 * (1 + 1 / count)
    scatter = wider * np.atleast_2d(np.cov(errors.T))
    return found.replaced(settled=settled, evidence=at, scatter=scatter)


def _processed_at(
    found: Found, z: np.ndarray, process: Process, rng: np.random.Generator
) -> np.ndarray:
    """(h, w, c) the picture of coordinates ``z`` after the process; the target where that is
    ignored."""
    picture = found.problem.picture
    model = found.problem.at(np.asarray(z, np.float32))
    return np.where(picture.valid[..., None], process(model, rng), picture.levels)


def _simulated(
    found: Found, z: np.ndarray, process: Process
) -> tuple[np.ndarray, np.ndarray, float]:
    """(p,) the estimate from the target on the tangent at ``z``; (pictures, p) the errors of such
    estimates from processed pictures of points around ``z``; and the root mean square difference
    (levels) of two such pictures, apart from the difference that their points make."""
    problem, observation = found.problem, found.observation
    tangent = tangent_at(z.astype(np.float32), problem, observation)
    free = np.flatnonzero(problem.free)
    rng = np.random.default_rng(0)
    errors: list[np.ndarray] = []
    differences: list[np.ndarray] = []
    pixels, channels = np.asarray(observation.pixels), problem.picture.channels
    rows = np.arange(len(tangent.prediction))
    if len(rows) > SIMULATED_VALUES:
        rows = np.sort(rng.choice(len(rows), SIMULATED_VALUES, replace=False))
    tangent = tangent.only(rows)
    own = None if observation.own_noise is None else np.asarray(observation.own_noise)[rows]
    centre = z.astype(np.float32)
    away = min(SIMULATED_STEP, SIMULATED_STEP_PIXELS / max(problem.picture.size))

    def estimate(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
        intervals = Intervals(lo, hi, observation.foreign, own)
        return solve_tangent(centre, problem, tangent, intervals, found.settled.sigma).coordinates

    for draw in range(SIMULATED_PICTURES):
        step = np.zeros(len(z))
        if draw < SPREAD_PICTURES:
            step[free] = away * rng.standard_normal(len(free))
        else:
            block = np.atleast_2d(np.cov(np.array(errors)[:, free].T))
            step[free] = rng.multivariate_normal(np.zeros(len(free)), block, check_valid="ignore")
        there = np.clip(z + step * tangent.scale, *problem.model.bounds())
        levels = _processed_at(found, there, process, rng).reshape(-1, channels)[pixels]
        levels = levels.ravel()[rows]
        lo, hi = levels - HALF_LEVEL, levels + HALF_LEVEL
        lo, hi = np.where(lo < 0, -np.inf, lo), np.where(hi > LEVELS, np.inf, hi)
        end = estimate(lo.astype(np.float32), hi.astype(np.float32))
        errors.append((end - there) / tangent.scale)
        differences.append(levels - tangent.moved(there - z))
    spread = float(
        np.sqrt(
            np.mean((np.array(differences) - np.mean(differences, 0)) ** 2)
            * SIMULATED_PICTURES
            / (SIMULATED_PICTURES - 1)
        )
    )
    estimated = estimate(np.asarray(observation.lo)[rows], np.asarray(observation.hi)[rows])
    return estimated.astype(np.float64), np.array(errors) * tangent.scale, np.sqrt(2) * spread

"""Dips of the cost in density: found, and told apart.

Density is seen where the rays end, and each of the shader's n taps leaves a band there, so that the
cost has a dip for every band, some 1/n of density apart. ``on_subset`` tries those found by
``valley.py`` on a few thousand pixels, the others hold neighbours against each other on more.
"""

from __future__ import annotations

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from godfit.inference.information import Evidence, evidence, misfit
from godfit.inference.noise import EXPLAINED, SIGMAS, WITHIN_ROUNDING
from godfit.inference.observation import Observation, Picture
from godfit.inference.problem import PIXELS
from godfit.inference.repeated_values import counted_once
from godfit.inference.scan import DOUBT, predictions
from godfit.inference.settle import Settled, settle, veil
from godfit.inference.solver import solve
from godfit.io.filters import blurred_at
from godfit.models.base import AbstractModel
from godfit.search.density_scan import BEYOND_DOUBT, RIVALS, reseed, rivals
from godfit.search.multigrid import LADDER

# Most corrections for one blur, and the share of a coordinate by which none is worth another.
CORRECTIONS, STILL = 3, 1e-3
# What is blurred needs fewer pixels than what is sharp.
CORRECTED_PIXELS = 1 << 9
# Pixels, most, that rivals are told apart on.
RIVAL_PIXELS = 1 << 14
CANDIDATES = 3
# More levels than a wrong dip leaves: the model is another, and no density will do.
HOPELESS = 6.0
# And more than a wrong dip of the right model leaves.
FOREIGN = 20.0
MAX_DIPS = 5
# A right answer to a picture that is only rounded leaves less noise than this.
CONTENT = 1.3 * SIGMAS[0]
MAX_RESEEDS = 3
MAX_RIVALRIES = 4


def on_subset(
    picture: Picture,
    model: AbstractModel,
    coordinates: np.ndarray,
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
    say: Callable[[str], None],
) -> list[np.ndarray]:
    """Sharp images, a few thousand pixels: the best point, and where density is in doubt, those
    that all pixels must decide between."""

    def settled_on(count: int, start: np.ndarray):
        seen = picture.observe(picture.informative(count, seed))
        settled, tangent = settle(start, model, seen, free, held)
        return settled, seen, _dips(settled, evidence(settled, tangent, seen), model, free)

    settled, seen, (along, dip, doubtful) = settled_on(PIXELS, coordinates)
    quiet = settled.sigma < 2 * SIGMAS[0]
    if not free[along] or (quiet and not doubtful):
        return [settled.coordinates]
    if settled.sigma > FOREIGN or not _rays(settled, seen):
        return [settled.coordinates]
    if quiet:
        # More pixels may leave no doubt, and are asked faster than other densities.
        closer, _, (*_, doubtful) = settled_on(RIVAL_PIXELS, settled.coordinates)
        if closer.sigma < 2 * SIGMAS[0] and not doubtful:
            return [closer.coordinates]
    say("other densities")
    found = reseed(settled, along, model, picture, free, held, seed)
    for _ in range(MAX_RESEEDS):
        best = found[0]
        if best.sigma < EXPLAINED or best.sigma > HOPELESS:
            break
        if _like_noise(best, model, seen, held):
            break
        again = correct(best.coordinates, model, picture, free, held, seed)
        again, _ = settle(again, model, seen, free, held)
        if again.log_likelihood < best.log_likelihood:
            again = best
        found = reseed(again, along, model, picture, free, held, seed)
        if found[0].log_likelihood < best.log_likelihood + 1:
            break
    if found[0].sigma > HOPELESS and not _like_noise(found[0], model, seen, held):
        return [found[0].coordinates]
    close: list[Settled] = []
    for other in found:
        apart = all(abs(other.coordinates[along] - c.coordinates[along]) > dip / 20 for c in close)
        if apart and other.log_likelihood > found[0].log_likelihood - DOUBT:
            close.append(other)
    return [c.coordinates for c in close[:CANDIDATES]]


def _rays(settled: Settled, seen: Observation) -> bool:
    """Whether the model says more of the pixels than one value everywhere: where it does not, no
    density can."""
    return settled.log_likelihood > veil(seen).log_likelihood + DOUBT


def _hopeless(settled: Settled, at: Evidence, seen: Observation) -> bool:
    return settled.sigma > HOPELESS and not misfit(at.prediction, seen).like_noise


def _like_noise(at: Settled, model: AbstractModel, seen: Observation, held: np.ndarray) -> bool:
    fitted = model.moved(jnp.asarray(at.coordinates), jnp.asarray(held))
    return misfit(np.asarray(seen.predict(fitted)), seen).like_noise


def _dips(
    settled: Settled, at: Evidence, model: AbstractModel, free: np.ndarray
) -> tuple[int, float, bool]:
    """Index of density, the distance between two dips of the cost in it (one band, a shift of the
    rays' end by one tap), and whether its error is wide enough for another dip to be the right one.
    """
    along = list(model.parameters).index("density")
    dip = float(settled.coordinates[along]) / model.samples
    variance = at.covariance(free)[along, along]
    return along, dip, bool(free[along] and variance > (dip / 20) ** 2)


def in_doubt(settled: Settled, at: Evidence, model: AbstractModel, free: np.ndarray) -> bool:
    """Whether another dip may be the right one."""
    return bool(settled.sigma > CONTENT) or _dips(settled, at, model, free)[-1]


def next_dips(
    settled: Settled,
    at: Evidence,
    model: AbstractModel,
    seen: Observation,
    free: np.ndarray,
    held: np.ndarray,
) -> tuple[Settled, Evidence]:
    """From dip to dip, both ways, as long as the likelihood of all pixels gains."""
    along, dip, doubtful = _dips(settled, at, model, free)
    if not doubtful or _hopeless(settled, at, seen):
        return settled, at
    covariance = at.covariance(free)
    follow = covariance[:, along] / covariance[along, along]
    for way in (-dip, dip):
        for _ in range(MAX_DIPS):
            start = (settled.coordinates + way * follow).astype(np.float32)
            other, tangent = settle(start, model, seen, free, held)
            if other.log_likelihood <= settled.log_likelihood + 0.5:
                break
            settled, at = other, evidence(other, tangent, seen)
    return settled, at


def beat_rivals(
    settled: Settled,
    at: Evidence,
    model: AbstractModel,
    picture: Picture,
    seen: Observation,
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
) -> tuple[Settled, Evidence]:
    """The likeliest of the dips around, on all pixels of ``seen``. With noise a wrong dip looks as
    good as the right one until they are held against each other."""
    if settled.sigma < WITHIN_ROUNDING or not _rays(settled, seen):
        return settled, at
    for _ in range(MAX_RIVALRIES):
        along, dip, _ = _dips(settled, at, model, free)
        if not free[along] or settled.sigma < WITHIN_ROUNDING:
            break
        if _hopeless(settled, at, seen):
            break
        before = settled.log_likelihood
        count = min(RIVAL_PIXELS, len(seen.pixels) // 4)
        for z in rivals(settled, along, dip, model, picture, free, held, seed, count):
            other, tangent = settle(z, model, seen, free, held)
            if other.log_likelihood > settled.log_likelihood:
                settled, at = other, evidence(other, tangent, seen)
        if settled.log_likelihood < before + 0.5:
            break
    return settled, at


def beat_distant(
    settled: Settled,
    at: Evidence,
    model: AbstractModel,
    picture: Picture,
    seen: Observation,
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
) -> tuple[Settled, Evidence]:
    """The likeliest of dips anywhere, on all pixels of ``seen``, where what is left is less than
    rounding would hide and yet more than a right answer leaves: short rays say so little of density
    that a few thousand pixels are content with a wrong one."""
    for _ in range(MAX_RESEEDS):
        along, dip, _ = _dips(settled, at, model, free)
        if not free[along] or not CONTENT < settled.sigma < WITHIN_ROUNDING:
            break
        before = settled
        found = reseed(settled, along, model, picture, free, held, seed, count=RIVAL_PIXELS)
        tried = [before.coordinates[along]]
        for other in found:
            if other.log_likelihood < found[0].log_likelihood - BEYOND_DOUBT:
                # All pixels would take long to say what these say already.
                break
            if min(abs(other.coordinates[along] - t) for t in tried) < dip / 2:
                continue
            tried.append(other.coordinates[along])
            here, tangent = settle(other.coordinates, model, seen, free, held)
            if here.log_likelihood > settled.log_likelihood:
                settled, at = here, evidence(here, tangent, seen)
            if len(tried) > RIVALS:
                break
        if settled.log_likelihood < before.log_likelihood + 1:
            break
    return settled, at


def correct(
    start: np.ndarray,
    model: AbstractModel,
    picture: Picture,
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
) -> np.ndarray:
    """Down the ladder again with its bias taken out.

    A picture from a blurred mask is not the blurred picture: far along the ray the mask should be
    blurred less, which draws density away from 1. The difference between the two at the present
    point is added to the blurred target, as coarse levels are corrected in multigrid (the full
    approximation scheme: Brandt, Math. Comp. 31 (1977), 333).
    """
    pixels = picture.informative(CORRECTED_PIXELS, seed)
    lower, upper = (np.asarray(b, np.float32) for b in model.bounds())
    z = start
    for share, _, sigma in LADDER:
        blur = share * max(picture.size)
        seen = picture.observe(pixels, blur)
        for _ in range(CORRECTIONS):
            at = model.moved(jnp.asarray(z), jnp.asarray(held))
            sharp = picture.rendered(at)
            (coarse,) = np.asarray(predictions(jnp.asarray(z[None]), held, model, seen))
            bias = coarse - blurred_at(sharp, blur, pixels).reshape(-1)
            shifted = eqx.tree_at(lambda s: (s.lo, s.hi), seen, (seen.lo + bias, seen.hi + bias))
            before, z = z, solve(z, free, held, model, shifted, sigma, bounded=False).coordinates
            z = np.clip(z, lower, upper)
            if np.allclose(z, before, rtol=STILL, atol=STILL / 10):
                break
    return z


def likeliest(
    picture: Picture,
    model: AbstractModel,
    candidates: list[np.ndarray],
    seen: Observation,
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
) -> tuple[Settled, Evidence, Observation]:
    """The likeliest of the candidates and, where density is in doubt, of the dips around them, on
    all pixels of ``seen``; flat areas are counted once in the end."""
    if len(candidates) == 1:
        settled, tangent, counted = counted_once(candidates[0], model, seen, free, held, [])
        at = evidence(settled, tangent, counted)
        if not (model.banded and in_doubt(settled, at, model, free)):
            return settled, at, counted
        candidates = [settled.coordinates]
        # The derivatives of every pixel would only fill the memory.
        del tangent
    settled, tangent = max(
        (settle(z, model, seen, free, held) for z in candidates),
        key=lambda found: found[0].log_likelihood,
    )
    at = evidence(settled, tangent, seen)
    first, known = settled, [tangent]
    del tangent
    settled, at = next_dips(settled, at, model, seen, free, held)
    settled, at = beat_rivals(settled, at, model, picture, seen, free, held, seed)
    settled, at = beat_distant(settled, at, model, picture, seen, free, held, seed)
    if settled.sigma > EXPLAINED:
        return settled, at, seen
    if settled is not first:
        known.clear()
    settled, tangent, counted = counted_once(settled.coordinates, model, seen, free, held, known)
    return settled, evidence(settled, tangent, counted), counted

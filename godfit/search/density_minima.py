"""Minima of the cost in density: a search for them, and a comparison.

Density is visible where the rays end, and each of the shader's n taps leaves a band there, so that
the cost has a minimum for every band, some 1/n of density apart. ``on_subset`` tries those that
``density_scan.py`` finds on a few thousand pixels. ``likeliest`` compares the remaining ones, and
minima near to and far from them, on all pixels.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from godfit.inference.allowances.arithmetic import with_arithmetic
from godfit.inference.distinct import DOUBT, distinct
from godfit.inference.evaluate import predictions
from godfit.inference.information import Evidence, evidence, misfit
from godfit.inference.noise import EXPLAINED, SIGMAS, WITHIN_ROUNDING
from godfit.inference.observation import Observation
from godfit.inference.problem import SEARCH_PIXELS, Problem
from godfit.inference.repeated_values import counted_once
from godfit.inference.settle import Settled, settle, veil
from godfit.inference.solver import solve, tangent_at
from godfit.inference.strategy import COARSE_TO_FINE, Report
from godfit.io.filters import blurred_at
from godfit.search.density_scan import BEYOND_DOUBT, NEARBY_TRIES, nearby_minima, scan_density

BIAS_CORRECTIONS = 3
"""Corrections of the blur's bias at one blur, at most."""
STILL = 1e-3
"""Relative change of a coordinate that is not worth another correction."""
CORRECTED_PIXELS = 1 << 9
"""Pixels of a blurred picture: fewer than of a sharp one suffice."""
COMPARED_PIXELS = 1 << 14
"""Pixels on which minima are compared, at most."""
CANDIDATES = 3
"""Minima that all pixels must decide between, at most."""
WRONG_MODEL_NOISE = 6.0
"""Noise in levels above that of any wrong minimum: the model is wrong, and no density will do."""
ANOTHER_MODEL = 20.0
"""Levels of noise that no minimum of the right model leaves, however poor the start."""
NEIGHBOURS = 5
"""Steps from one minimum to the next, each way, at most."""
ROUNDING_ONLY = 1.3 * SIGMAS[0]
"""Noise in levels that the right answer to a picture that is only rounded does not exceed: the
least that is tried, and the rounding of float32 on top."""
IMPROVABLE_NOISE = 2 * SIGMAS[0]
"""Noise in levels down to which a few thousand pixels can be improved upon."""
MAX_DENSITY_SCANS = 3
"""Scans over all densities, at most."""
COMPARISONS = 4
"""Rounds of comparing the minima nearby, at most."""
DISTINGUISHED = 1 / 20
"""Share of a band by which two densities in one minimum may differ; and the error of density, as a
share of a band, from which on another minimum may be the right one."""


class Bands(NamedTuple):
    """Minima in density: ``along`` is its index, ``width`` the distance between two of them (one
    band, a shift of the rays' end by one tap), ``doubtful`` whether its error is so wide that
    another minimum may be the right one."""

    along: int
    width: float
    doubtful: bool


def bands_at(settled: Settled, at: Evidence, problem: Problem) -> Bands:
    """The minima about a settled point."""
    along = problem.index("density")
    width = float(settled.coordinates[along]) / problem.model.samples
    variance = at.covariance(problem.free)[along, along]
    wide = variance > (DISTINGUISHED * width) ** 2
    return Bands(along, width, bool(problem.free[along] and wide))


def on_subset(problem: Problem, start: np.ndarray, report: Report) -> list[np.ndarray]:
    """The best point on sharp images and a few thousand pixels; where density is in doubt, the
    points that all pixels must decide between."""

    def settled_on(count: int, start: np.ndarray):
        observation = problem.observe(count)
        settled, tangent = settle(start, problem, observation)
        if IMPROVABLE_NOISE <= settled.sigma < WITHIN_ROUNDING:
            # The target's arithmetic may be all that is left.
            noisy = with_arithmetic(observation, problem, settled.coordinates, tangent)
            if noisy is not observation:
                observation = noisy
                settled, tangent = settle(
                    settled.coordinates, problem, observation, known=[tangent]
                )
        return (
            settled,
            observation,
            bands_at(settled, evidence(settled, tangent, observation), problem),
        )

    settled, observation, (along, width, doubtful) = settled_on(SEARCH_PIXELS, start)
    quiet = settled.sigma < IMPROVABLE_NOISE
    if not problem.free[along] or (quiet and not doubtful):
        return [settled.coordinates]
    if settled.sigma > ANOTHER_MODEL or not _explains(settled, observation):
        return [settled.coordinates]
    if quiet:
        # More pixels may leave no doubt, and cost less than a scan.
        closer, _, bands = settled_on(COMPARED_PIXELS, settled.coordinates)
        if closer.sigma < IMPROVABLE_NOISE and not bands.doubtful:
            return [closer.coordinates]
    report("other densities")
    found = scan_density(settled, problem, along)
    for _ in range(MAX_DENSITY_SCANS):
        best = found[0]
        if best.sigma < EXPLAINED or best.sigma > WRONG_MODEL_NOISE:
            break
        if _like_noise(best, problem, observation):
            break
        unbiased, _ = settle(without_bias(best.coordinates, problem), problem, observation)
        better = max(best, unbiased, key=lambda s: s.log_likelihood)
        found = scan_density(better, problem, along)
        if found[0].log_likelihood < best.log_likelihood + 1:
            break
    if found[0].sigma > WRONG_MODEL_NOISE and not _like_noise(found[0], problem, observation):
        return [found[0].coordinates]
    close = [
        f for f in found if f.log_likelihood > found[0].log_likelihood - DOUBT or f is found[0]
    ]

    def same(a: Settled, b: Settled) -> bool:
        apart = abs(a.coordinates[along] - b.coordinates[along])
        return bool(apart <= DISTINGUISHED * width)

    return [c.coordinates for c in distinct(close, same, CANDIDATES)]


def _explains(settled: Settled, observation: Observation) -> bool:
    """Whether the model explains more than one value everywhere does; otherwise no density can."""
    return settled.log_likelihood > veil(observation).log_likelihood + DOUBT


def _hopeless(settled: Settled, at: Evidence, observation: Observation) -> bool:
    return settled.sigma > WRONG_MODEL_NOISE and not misfit(at.prediction, observation).like_noise


def _like_noise(at: Settled, problem: Problem, observation: Observation) -> bool:
    tangent = tangent_at(at.coordinates, problem, observation)
    return misfit(tangent.prediction, observation).like_noise


def likeliest(
    problem: Problem, candidates: list[np.ndarray], observation: Observation
) -> tuple[Settled, Evidence, Observation]:
    """The likeliest of the candidates on all pixels of ``observation`` and, where density is in
    doubt, of the minima around them; flat areas are counted once in the end."""
    if len(candidates) == 1:
        settled, tangent, counted = counted_once(candidates[0], problem, observation, [])
        at = evidence(settled, tangent, counted)
        if not (problem.model.banded and _in_doubt(settled, at, problem)):
            return settled, at, counted
        candidates = [settled.coordinates]
        # The derivatives of every pixel would only fill the memory.
        del tangent
    # Candidates are compared with the noise that the first one has.
    observation = with_arithmetic(observation, problem, candidates[0])
    settled, tangent = max(
        (settle(z, problem, observation) for z in candidates),
        key=lambda found: found[0].log_likelihood,
    )
    best = settled, evidence(settled, tangent, observation)
    first, known = settled, [tangent]
    del tangent
    for compare in (_with_neighbours, _with_nearby, _with_distant):
        best = compare(*best, problem, observation)
    settled, at = best
    if settled.sigma > EXPLAINED:
        return settled, at, observation
    if settled is not first:
        known.clear()
    settled, tangent, counted = counted_once(settled.coordinates, problem, observation, known)
    return settled, evidence(settled, tangent, counted), counted


def _in_doubt(settled: Settled, at: Evidence, problem: Problem) -> bool:
    """Whether another minimum may be the right one."""
    return bool(settled.sigma > ROUNDING_ONLY) or bands_at(settled, at, problem).doubtful


def _with_neighbours(
    settled: Settled, at: Evidence, problem: Problem, observation: Observation
) -> tuple[Settled, Evidence]:
    """From minimum to minimum, both ways, as long as the likelihood of all pixels gains."""
    along, width, doubtful = bands_at(settled, at, problem)
    if not doubtful or _hopeless(settled, at, observation):
        return settled, at
    covariance = at.covariance(problem.free)
    follow = covariance[:, along] / covariance[along, along]
    for step in (-width, width):
        for _ in range(NEIGHBOURS):
            start = (settled.coordinates + step * follow).astype(np.float32)
            other, tangent = settle(start, problem, observation)
            if other.log_likelihood <= settled.log_likelihood + 0.5:
                break
            settled, at = other, evidence(other, tangent, observation)
    return settled, at


def _with_nearby(
    settled: Settled, at: Evidence, problem: Problem, observation: Observation
) -> tuple[Settled, Evidence]:
    """The minimum of largest likelihood among those nearby. With noise a wrong minimum is as good
    as the right one until both are evaluated on all pixels."""
    if settled.sigma < WITHIN_ROUNDING or not _explains(settled, observation):
        return settled, at
    for _ in range(COMPARISONS):
        along, width, _ = bands_at(settled, at, problem)
        if not problem.free[along] or settled.sigma < WITHIN_ROUNDING:
            break
        if _hopeless(settled, at, observation):
            break
        before = settled.log_likelihood
        count = min(COMPARED_PIXELS, len(observation.pixels) // 4)
        for z in nearby_minima(settled, problem, along, width, count):
            other, tangent = settle(z, problem, observation)
            if other.log_likelihood > settled.log_likelihood:
                settled, at = other, evidence(other, tangent, observation)
        if settled.log_likelihood < before + 0.5:
            break
    return settled, at


def _with_distant(
    settled: Settled, at: Evidence, problem: Problem, observation: Observation
) -> tuple[Settled, Evidence]:
    """The likeliest of the minima anywhere, where the residual is less than rounding would hide and
    yet more than the right answer leaves, or density is in doubt: short rays determine it so poorly
    that a few thousand pixels are content with a wrong one."""
    for _ in range(MAX_DENSITY_SCANS):
        along, width, _ = bands_at(settled, at, problem)
        in_doubt = problem.free[along] and _in_doubt(settled, at, problem)
        if not in_doubt or settled.sigma >= WITHIN_ROUNDING:
            break
        before = settled
        found = scan_density(settled, problem, along, count=COMPARED_PIXELS)
        tried = [before.coordinates[along]]
        for other in found:
            if other.log_likelihood < found[0].log_likelihood - BEYOND_DOUBT:
                # All pixels would take long to confirm it.
                break
            if min(abs(other.coordinates[along] - t) for t in tried) < width / 2:
                continue
            tried.append(other.coordinates[along])
            here, tangent = settle(other.coordinates, problem, observation)
            if here.log_likelihood > settled.log_likelihood:
                settled, at = here, evidence(here, tangent, observation)
            if len(tried) > NEARBY_TRIES:
                break
        if settled.log_likelihood < before.log_likelihood + 1:
            break
    return settled, at


def without_bias(start: np.ndarray, problem: Problem) -> np.ndarray:
    """The coarse-to-fine search once more, with the blur's bias taken out.

    A picture from a blurred mask is not the blurred picture: far along the ray the mask should be
    blurred less, which draws density away from 1. The difference between the two at the present
    point is added to the blurred target, as coarse levels are corrected in multigrid (the full
    approximation scheme: Brandt, Math. Comp. 31 (1977), 333).
    """
    picture = problem.picture
    pixels = picture.informative(CORRECTED_PIXELS, problem.seed)
    z = start
    for stage in COARSE_TO_FINE:
        blur = stage.blur * max(picture.size)
        view = picture.observe(pixels, blur)
        for _ in range(BIAS_CORRECTIONS):
            sharp = picture.rendered(problem.at(z))
            levels = predictions(jnp.asarray(z[None]), problem.held, problem.model, view)
            bias = np.asarray(levels)[0] - blurred_at(sharp, blur, pixels).reshape(-1)
            unbiased = eqx.tree_at(lambda s: (s.lo, s.hi), view, (view.lo + bias, view.hi + bias))
            before = z
            z = solve(z, problem, unbiased, stage.sigma, bounded=False).coordinates
            z = np.clip(z, *problem.bounds)
            if np.allclose(z, before, rtol=STILL, atol=STILL / 10):
                break
    return z

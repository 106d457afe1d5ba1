"""Coordinates and noise that maximise the likelihood together.

The model is rendered a few times only; between renderings, steps are taken on its tangent.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from godfit.inference.noise import EXPLAINED, FINAL_SIGMA_VALUES, SIGMAS, best_sigma, noise_of
from godfit.inference.observation import Observation
from godfit.inference.problem import SEARCH_PIXELS, Problem
from godfit.inference.solver import Intervals, Tangent, solve_tangent, tangent_at
from godfit.runtime.blas import one_thread

TIGHTEST_VALUES = 1 << 14
"""Values nearest to the ends of their intervals that are solved for, at least, where rounding is
the only noise: the others are far inside and have no slope."""
TIGHTEST_FRACTION = 16
"""One value in so many is solved for, where that is more than TIGHTEST_VALUES."""
SLACK_STRIDE = 17
"""One value in so many is sorted to bound the slack of the tightest: a tenth of the time. A prime,
so that it does not fall into step with the rows."""
BANDED_GAIN = 4.0
"""Gain in log-likelihood below which pixels are not rendered again: kinks of the mask make it jump
by as much between one float32 and the next."""
SMOOTH_GAIN = 0.05
"""The same gain for a picture without bands, which has no kinks that matter."""
CHEAP_PIXELS = 1 << 13
"""Pixels that are cheap to render again: up to here SMOOTH_GAIN holds in any case."""
SPOT_CHECK_STRIDE = 128
"""One pixel in so many is rendered to check whether a tangent still holds."""
TANGENT_ERROR = 0.1
"""Root mean square error of a tangent, as a share of sigma, that is still accepted."""
NO_MOVE = 0.05
"""Share of sigma by which a step must move some value to count as a step."""
LARGE_TANGENT = 1 << 20
"""Values beyond which two sets of derivatives are never in memory at once."""
AIM_ROUNDS = 5
"""Rounds of coordinates and sigma in turn on one tangent, at most: they end once sigma stays."""
SAME_SIGMA = 0.05
"""Relative change of sigma below which coordinates and sigma agree."""


class Settled(NamedTuple):
    """Coordinates and noise (levels) that maximise the likelihood together; ``quiet`` when neither
    moved."""

    coordinates: np.ndarray
    sigma: float
    log_likelihood: float
    quiet: bool


def veil(observation: Observation) -> Settled:
    """One value everywhere, the mean of the values, as the only coordinate, and the noise about
    it."""
    lo, hi = np.asarray(observation.lo), np.asarray(observation.hi)
    known = np.isfinite(lo) & np.isfinite(hi)
    level = np.float32(((lo + hi) / 2)[known].mean() if known.any() else 0.0)
    sigma, likelihood = best_sigma(np.full(len(lo), level), observation, FINAL_SIGMA_VALUES)
    return Settled(np.array([level], np.float32), sigma, likelihood, True)


def settle(
    start: np.ndarray,
    problem: Problem,
    observation: Observation,
    *,
    rounds: int = 10,
    known: list[Tangent] | None = None,
    spot_check: bool = False,
) -> tuple[Settled, Tangent]:
    """Coordinates and noise that maximise the likelihood together, until it no longer grows.

    The pixels are rendered once for each round. In between, the likelihood, which is far from
    quadratic when sigma is small, is solved on the tangent, with sigma and coordinates in turn.
    ``known`` holds the tangent at ``start``, if there is one already. It is taken out of the list,
    so that its memory is free as soon as it is of no more use. With ``spot_check`` the pixels are
    not rendered again where a sample of them confirms the tangent.
    """
    start = np.clip(start, *problem.bounds)
    spot_checks = _spot_checks(observation) if spot_check else []
    settled, tangent = _in_rounds(start, problem, observation, rounds, known or [], spot_checks)
    if settled.sigma > EXPLAINED:
        # The rounds need sigma to a few percent only; errors are quoted in units of it.
        sigma, likelihood = best_sigma(
            tangent.prediction, observation, FINAL_SIGMA_VALUES, settled.sigma
        )
        likelihood += tangent.log_prior
        settled = settled._replace(sigma=sigma, log_likelihood=likelihood)
    return settled, tangent


def _in_rounds(start, problem, observation, rounds, known, spot_checks) -> tuple[Settled, Tangent]:
    def render(z, observation=observation):
        return tangent_at(z, problem, observation)

    tangent = known.pop() if known else render(start)
    sigma, likelihood = best_sigma(tangent.prediction, observation)
    best = Settled(start, sigma, likelihood + tangent.log_prior, False)
    part = 1.0
    many = len(observation.pixels) > CHEAP_PIXELS
    kinked = (problem.model.banded or observation.foreign) and many
    short = BANDED_GAIN if kinked else SMOOTH_GAIN
    for _ in range(rounds):
        goal, there = aim(best, tangent, problem, observation)
        if goal.log_likelihood < best.log_likelihood + short:
            # The step is so short that the tangent is as good as another rendering.
            return goal, there
        exact = None
        if spot_checks:
            exact = _corrected_on_spots(goal, there, spot_checks, render, problem)
        if exact is not None:
            return exact, there
        z = best.coordinates + np.float32(part) * (goal.coordinates - best.coordinates)
        del there
        if len(tangent.prediction) > LARGE_TANGENT:
            # Two sets of derivatives would be the largest memory of a fit: this one is made again.
            tangent = None
        there = render(z)
        sigma, likelihood = best_sigma(there.prediction, observation, near=goal.sigma)
        likelihood += there.log_prior
        gained = likelihood - best.log_likelihood
        done = abs(gained) < short / 8
        if gained > 0:
            best, tangent = Settled(z, sigma, likelihood, False), there
            part = 1.0
        else:
            # On a kink neither the whole step nor a part of it gains: the rounds end.
            done |= part < 1
            # Over a kink of the bilinear mask the tangent promises too much.
            part = 0.25
        del there
        tangent = tangent or render(best.coordinates)
        if done:
            return best._replace(quiet=True), tangent
    return best, tangent


def _spot_checks(observation: Observation) -> list[tuple[np.ndarray, Observation]]:
    """Pixels drawn at random, as observations of PIXELS each, with the indices of their values;
    none where the picture has not enough pixels."""
    total = len(observation.pixels)
    count = total // (SPOT_CHECK_STRIDE * SEARCH_PIXELS)
    drawn = np.random.default_rng(0).choice(
        total, (count, SEARCH_PIXELS), replace=False, shuffle=False
    )
    channels = np.arange(observation.channels)
    return [
        ((rows[:, None] * observation.channels + channels).reshape(-1), observation.only(rows))
        for rows in np.sort(drawn)
    ]


def _corrected_on_spots(
    goal: Settled,
    tangent: Tangent,
    spot_checks: list[tuple[np.ndarray, Observation]],
    render: Callable[[np.ndarray, Observation], Tangent],
    problem: Problem,
) -> Settled | None:
    """The point whose rendering has the levels of the ``tangent`` at the ``goal``, where rendering
    and tangent differ. It is found by least squares on the pixels ``spot_checks``. None if there is
    no such point nearby."""
    z, values = goal.coordinates, np.concatenate([v for v, _ in spot_checks])
    sampled = tangent.only(values)

    def errors_at(z):
        rendered = [render(z, part).prediction for _, part in spot_checks]
        return np.concatenate(rendered) - sampled.prediction

    lower, upper = problem.bounds
    # A coordinate on its bound stays there.
    moving = problem.free & (z > lower) & (z < upper)
    errors, slopes = errors_at(z), sampled.jacobian[moving].T
    if not (np.isfinite(errors).all() and np.isfinite(slopes).all()):
        return None
    with one_thread():
        step, *_ = np.linalg.lstsq(slopes, errors, rcond=None)
    z = z.copy()
    z[moving] -= step * tangent.scale[moving]
    z = np.clip(z, lower, upper)
    rms = float(np.sqrt(np.square(errors_at(z)).mean()))
    accepted = rms < TANGENT_ERROR * min(goal.sigma, EXPLAINED)
    return goal._replace(coordinates=z) if accepted else None


def aim(
    at: Settled, tangent: Tangent, problem: Problem, observation: Observation
) -> tuple[Settled, Tangent]:
    """Where the tangent's likelihood is largest, with the tangent taken there."""
    z, sigma, likelihood = at.coordinates, at.sigma, at.log_likelihood
    lo, hi = np.asarray(observation.lo), np.asarray(observation.hi)
    own = None if observation.own_noise is None else np.asarray(observation.own_noise)
    # Distances count in each value's own noise, which they push against.
    wide = np.float32(1) if own is None else noise_of(SIGMAS[0], own) / SIGMAS[0]
    levels, slack = tangent.prediction, _slack(tangent.prediction, lo, hi) / wide
    violated = None
    for _ in range(AIM_ROUNDS):
        rows, part = None, tangent
        intervals = Intervals(observation.lo, observation.hi, observation.foreign, own)
        if sigma < EXPLAINED:
            rows = _tightest(slack)
        if rows is not None:
            if violated is not None and np.array_equal(rows, violated):
                # Many values are equal, and the same ones are chosen again and again.
                break
            part = tangent.only(rows)
            some = None if own is None else own[rows]
            intervals = Intervals(lo[rows], hi[rows], observation.foreign, some)
        moved = part.shifted(z - at.coordinates)
        there = solve_tangent(z, problem, moved, intervals, sigma).coordinates
        shifted = tangent.shifted(there - at.coordinates)
        moved, log_prior = shifted.prediction, shifted.log_prior
        likeliest_sigma, new_likelihood = best_sigma(moved, observation, near=sigma)
        new_likelihood += log_prior
        if rows is not None and new_likelihood < likelihood:
            if np.abs(moved - levels).max() < NO_MOVE * sigma:
                break
            # Values that were left out are violated now: they are solved for from here on.
            slack, violated = np.minimum(slack, _slack(moved, lo, hi) / wide), rows
            continue
        z, levels, before, sigma, likelihood = there, moved, sigma, likeliest_sigma, new_likelihood
        if abs(sigma - before) < SAME_SIGMA * before:
            break
    if likelihood <= at.log_likelihood:
        return at._replace(quiet=True), tangent
    return Settled(z, sigma, likelihood, True), tangent.at(z - at.coordinates, levels)


def _slack(prediction: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    """(m,) levels from the nearer end of each interval, less than 0 outside."""
    return np.minimum(prediction - lo, hi - prediction)


def _tightest(slack: np.ndarray) -> np.ndarray | None:
    """Sorted indices of the values nearest to the ends of their intervals, None if that is all of
    them. Where rounding is the only noise, the others are far inside and have no slope."""
    count = max(TIGHTEST_VALUES, len(slack) // TIGHTEST_FRACTION)
    if len(slack) <= count:
        return None
    # A sample bounds the slack of those among them: sorting all would take ten times as long.
    sample = slack[::SLACK_STRIDE]
    rank = min(len(sample) - 1, int(1.2 * count / SLACK_STRIDE) + 16)
    near = np.flatnonzero(slack <= np.partition(sample, rank)[rank])
    if len(near) < count:
        near = np.arange(len(slack))
    return np.sort(near[np.argpartition(slack[near], count - 1)[:count]])

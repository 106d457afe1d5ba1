"""Coordinates and noise that suit each other, by few renderings and many steps on a tangent."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from godfit.inference.noise import EXPLAINED, FINAL_SIGMA_VALUES, best_sigma
from godfit.inference.observation import Observation
from godfit.inference.problem import PIXELS, Problem
from godfit.inference.solver import Intervals, Tangent, solve_tangent, tangent_at
from godfit.runtime.blas import one_thread

# Of a picture that is only rounded, values nearest to the walls of their intervals that have a say,
# least.
WALLS = 1 << 14
# Of so many values one says where the nearest to their walls are.
SAMPLED = 17
# Gain in log-likelihood for which pixels are not rendered again: kinks of the mask make it jump by
# as much between one float32 and the next.
SHORT = 4.0
# Where there are no bands there are no kinks that matter.
SHORT_WITHOUT = 0.05
# So few pixels are cheap to render again.
FEW = 1 << 13
# One pixel of so many says whether a tangent still holds.
SPOT_CHECKED = 128
# Of sigma, the most that they may be off it.
BENT = 0.1
# A step that moves no value by more than this share of sigma leads nowhere.
NOWHERE = 0.05
# Values whose derivatives are not held twice.
LARGE = 1 << 20


class Settled(NamedTuple):
    """Coordinates and noise (levels) that suit each other; ``quiet`` when neither moved."""

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
    """Coordinates and noise that suit each other, until the log-likelihood stands still.

    The pixels are rendered once for each round. In between, the likelihood, which is far from
    quadratic when sigma is small, is solved on the tangent, with sigma and coordinates in turn.
    ``known`` holds the tangent at ``start``, if there is one already; it is taken out, so that
    nobody keeps it for longer than it is of use. With ``spot_check`` the pixels are not rendered
    again where a few of them say that the tangent is as good.
    """
    start = np.clip(start, *problem.bounds)
    few = _drawn(observation) if spot_check else []
    settled, tangent = _in_rounds(start, problem, observation, rounds, known or [], few)
    if settled.sigma > EXPLAINED:
        # On the way a few percent were enough; errors are quoted in units of it.
        sigma, likelihood = best_sigma(
            tangent.prediction, observation, FINAL_SIGMA_VALUES, settled.sigma
        )
        settled = settled._replace(sigma=sigma, log_likelihood=likelihood)
    return settled, tangent


def _in_rounds(start, problem, observation, rounds, known, few) -> tuple[Settled, Tangent]:
    def render(z, observation=observation):
        return tangent_at(z, problem, observation)

    tangent = known.pop() if known else render(start)
    sigma, likelihood = best_sigma(tangent.prediction, observation)
    best = Settled(start, sigma, likelihood, False)
    part = 1.0
    kinked = (problem.model.banded or observation.foreign) and len(observation.pixels) > FEW
    short = SHORT if kinked else SHORT_WITHOUT
    for _ in range(rounds):
        goal, there = aim(best, tangent, problem, observation)
        if goal.log_likelihood < best.log_likelihood + short:
            # So short a step that the tangent is as good as another rendering.
            return goal, there
        exact = _exact(goal, there, few, render, problem) if few else None
        if exact is not None:
            return exact, there
        z = best.coordinates + np.float32(part) * (goal.coordinates - best.coordinates)
        del there
        if len(tangent.prediction) > LARGE:
            # Two sets of derivatives would be the most that a fit ever holds: rather made again.
            tangent = None
        there = render(z)
        sigma, likelihood = best_sigma(there.prediction, observation, near=goal.sigma)
        gained = likelihood - best.log_likelihood
        done = abs(gained) < short / 8
        if gained > 0:
            best, tangent = Settled(z, sigma, likelihood, False), there
            part = 1.0
        else:
            # On a kink, where neither the whole step nor a part of it gains, there is no further.
            done |= part < 1
            # Over a kink of the bilinear mask the tangent promises too much.
            part = 0.25
        del there
        tangent = tangent or render(best.coordinates)
        if done:
            return best._replace(quiet=True), tangent
    return best, tangent


def _drawn(observation: Observation) -> list[tuple[np.ndarray, Observation]]:
    """Some pixels, drawn at random, as observations of PIXELS each, with the values that are
    theirs; none of a picture that has few."""
    total = len(observation.pixels)
    count = total // (SPOT_CHECKED * PIXELS)
    drawn = np.random.default_rng(0).choice(total, (count, PIXELS), replace=False, shuffle=False)
    channels = np.arange(observation.channels)
    return [
        ((rows[:, None] * observation.channels + channels).reshape(-1), observation.only(rows))
        for rows in np.sort(drawn)
    ]


def _exact(
    goal: Settled,
    tangent: Tangent,
    few: list[tuple[np.ndarray, Observation]],
    render: Callable[[np.ndarray, Observation], Tangent],
    problem: Problem,
) -> Settled | None:
    """The point whose rendering has the levels of the ``tangent``, which is bent away from them at
    the ``goal``: by least squares on a ``few`` pixels. None if there is no such point nearby."""
    z, values = goal.coordinates, np.concatenate([v for v, _ in few])
    of = tangent.only(values)

    def off(z):
        return np.concatenate([render(z, part).prediction for _, part in few]) - of.prediction

    lower, upper = problem.bounds
    # What is on its bound stays there.
    moving = problem.free & (z > lower) & (z < upper)
    bent, slopes = off(z), of.jacobian[moving].T
    if not (np.isfinite(bent).all() and np.isfinite(slopes).all()):
        return None
    with one_thread():
        step, *_ = np.linalg.lstsq(slopes, bent, rcond=None)
    z = z.copy()
    z[moving] -= step * tangent.scale[moving]
    z = np.clip(z, lower, upper)
    left = float(np.sqrt(np.square(off(z)).mean()))
    return goal._replace(coordinates=z) if left < BENT * min(goal.sigma, EXPLAINED) else None


def aim(
    at: Settled, tangent: Tangent, problem: Problem, observation: Observation
) -> tuple[Settled, Tangent]:
    """Where the tangent's likelihood is largest, with the tangent taken there."""
    z, sigma, likelihood = at.coordinates, at.sigma, at.log_likelihood
    lo, hi = np.asarray(observation.lo), np.asarray(observation.hi)
    levels, slack = tangent.prediction, _slack(tangent.prediction, lo, hi)
    objected = None
    for _ in range(5):
        rows, of, walls = None, tangent, (observation.lo, observation.hi)
        if sigma < EXPLAINED:
            rows = _least(slack)
        if rows is not None:
            if objected is not None and np.array_equal(rows, objected):
                # Of many that are alike it is always the same ones that have a say.
                break
            of, walls = tangent.only(rows), (lo[rows], hi[rows])
        moved = of.moved(z - at.coordinates)
        intervals = Intervals(*walls, observation.foreign)
        there = solve_tangent(
            z, problem, of._replace(prediction=moved), intervals, sigma
        ).coordinates
        moved = tangent.moved(there - at.coordinates)
        suits, found = best_sigma(moved, observation, near=sigma)
        if rows is not None and found < likelihood:
            if np.abs(moved - levels).max() < NOWHERE * sigma:
                break
            # Values that were left out object: from now on they have a say.
            slack, objected = np.minimum(slack, _slack(moved, lo, hi)), rows
            continue
        z, levels, before, sigma, likelihood = there, moved, sigma, suits, found
        if abs(sigma - before) < 0.05 * before:
            break
    if likelihood <= at.log_likelihood:
        return at._replace(quiet=True), tangent
    return Settled(z, sigma, likelihood, True), tangent._replace(prediction=levels)


def _slack(prediction: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    """(m,) levels from the nearer end of each interval, less than 0 outside."""
    return np.minimum(prediction - lo, hi - prediction)


def _least(slack: np.ndarray) -> np.ndarray | None:
    """The values nearest to the ends of their intervals, None if that is all. Where rounding is all
    the noise there is, the others are far inside and have no say."""
    count = max(WALLS, len(slack) // 16)
    if len(slack) <= count:
        return None
    # A sample says which may be among them: to sort all of them out takes ten times as long.
    few = slack[::SAMPLED]
    most = min(len(few) - 1, int(1.2 * count / SAMPLED) + 16)
    near = np.flatnonzero(slack <= np.partition(few, most)[most])
    if len(near) < count:
        near = np.arange(len(slack))
    return np.sort(near[np.argpartition(slack[near], count - 1)[:count]])

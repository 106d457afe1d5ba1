"""Coordinates and noise that suit each other, by few renderings and many steps on a tangent."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from godfit.inference.noise import EXPLAINED, FINAL_SIGMA_VALUES, best_sigma
from godfit.inference.observation import Observation
from godfit.inference.problem import PIXELS
from godfit.inference.solver import linearise, solve_tangent
from godfit.models.base import AbstractModel
from godfit.runtime.blas import one_thread
from godfit.runtime.program_cache import cached_jit

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


class Tangent(NamedTuple):
    """The model about a point: levels (m,), derivatives (p, m) by coordinates over ``scale``."""

    prediction: np.ndarray
    jacobian: np.ndarray
    scale: np.ndarray

    def only(self, rows: np.ndarray) -> Tangent:
        """Of some of the levels."""
        return Tangent(self.prediction[rows], self.jacobian[:, rows], self.scale)

    def moved(self, by: np.ndarray) -> np.ndarray:
        """Levels where the coordinates are others ``by`` so much."""
        step = np.asarray(by / self.scale, np.float32)
        return np.asarray(_along(self.prediction, self.jacobian, step))


def tangent_at(z: np.ndarray, held: np.ndarray, model: AbstractModel, seen: Observation) -> Tangent:
    """The tangent at a point: every pixel is rendered, with its derivatives."""
    scale = model.scales(z)
    prediction, jacobian = linearise(z, held, scale, model, seen)
    return Tangent(np.asarray(prediction), np.asarray(jacobian), scale)


@cached_jit
def _along(prediction, jacobian, step):
    # By XLA: BLAS in numpy keeps a core busy, waiting, long after the product is done.
    return prediction + step @ jacobian


def veil(seen: Observation) -> Settled:
    """One value everywhere, the mean of the values, as the only coordinate, and the noise about
    it."""
    lo, hi = np.asarray(seen.lo), np.asarray(seen.hi)
    known = np.isfinite(lo) & np.isfinite(hi)
    level = np.float32(((lo + hi) / 2)[known].mean() if known.any() else 0.0)
    sigma, likelihood = best_sigma(np.full(len(lo), level), seen, FINAL_SIGMA_VALUES)
    return Settled(np.array([level], np.float32), sigma, likelihood, True)


def settle(
    start: np.ndarray,
    model: AbstractModel,
    seen: Observation,
    free: np.ndarray,
    held: np.ndarray,
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
    start = np.clip(start, *(np.asarray(bound, np.float32) for bound in model.bounds()))
    few = _drawn(seen) if spot_check else []
    settled, tangent = _in_rounds(start, model, seen, free, held, rounds, known or [], few)
    if settled.sigma > EXPLAINED:
        # On the way a few percent were enough; errors are quoted in units of it.
        sigma, likelihood = best_sigma(tangent.prediction, seen, FINAL_SIGMA_VALUES, settled.sigma)
        settled = settled._replace(sigma=sigma, log_likelihood=likelihood)
    return settled, tangent


def _in_rounds(start, model, seen, free, held, rounds, known, few) -> tuple[Settled, Tangent]:
    def render(z, seen=seen):
        return tangent_at(z, held, model, seen)

    tangent = known.pop() if known else render(start)
    sigma, likelihood = best_sigma(tangent.prediction, seen)
    best = Settled(start, sigma, likelihood, False)
    part = 1.0
    kinked = (model.banded or seen.foreign) and len(seen.pixels) > FEW
    short = SHORT if kinked else SHORT_WITHOUT
    for _ in range(rounds):
        goal, there = aim(best, tangent, model, seen, free)
        if goal.log_likelihood < best.log_likelihood + short:
            # So short a step that the tangent is as good as another rendering.
            return goal, there
        exact = _exact(goal, there, few, render, free, model) if few else None
        if exact is not None:
            return exact, there
        z = best.coordinates + np.float32(part) * (goal.coordinates - best.coordinates)
        del there
        if len(tangent.prediction) > LARGE:
            # Two sets of derivatives would be the most that a fit ever holds: rather made again.
            tangent = None
        there = render(z)
        sigma, likelihood = best_sigma(there.prediction, seen, near=goal.sigma)
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


def _drawn(seen: Observation) -> list[tuple[np.ndarray, Observation]]:
    """Some pixels, drawn at random, as observations of PIXELS each, with the values that are
    theirs; none of a picture that has few."""
    total = len(seen.pixels)
    count = total // (SPOT_CHECKED * PIXELS)
    drawn = np.random.default_rng(0).choice(total, (count, PIXELS), replace=False, shuffle=False)
    channels = np.arange(seen.channels)
    return [
        ((rows[:, None] * seen.channels + channels).reshape(-1), seen.only(rows))
        for rows in np.sort(drawn)
    ]


def _exact(
    goal: Settled,
    tangent: Tangent,
    few: list[tuple[np.ndarray, Observation]],
    render: Callable[[np.ndarray, Observation], Tangent],
    free: np.ndarray,
    model: AbstractModel,
) -> Settled | None:
    """The point whose rendering has the levels of the ``tangent``, which is bent away from them at
    the ``goal``: by least squares on a ``few`` pixels. None if there is no such point nearby."""
    z, values = goal.coordinates, np.concatenate([v for v, _ in few])
    of = tangent.only(values)

    def off(z):
        return np.concatenate([render(z, seen).prediction for _, seen in few]) - of.prediction

    lower, upper = (np.asarray(bound, np.float32) for bound in model.bounds())
    # What is on its bound stays there.
    moving = free & (z > lower) & (z < upper)
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
    at: Settled, tangent: Tangent, model: AbstractModel, seen: Observation, free: np.ndarray
) -> tuple[Settled, Tangent]:
    """Where the tangent's likelihood is largest, with the tangent taken there."""
    z, sigma, likelihood = at.coordinates, at.sigma, at.log_likelihood
    lo, hi = np.asarray(seen.lo), np.asarray(seen.hi)
    levels, slack = tangent.prediction, _slack(tangent.prediction, lo, hi)
    objected = None
    for _ in range(5):
        rows, of, walls = None, tangent, (seen.lo, seen.hi)
        if sigma < EXPLAINED:
            rows = _least(slack)
        if rows is not None:
            if objected is not None and np.array_equal(rows, objected):
                # Of many that are alike it is always the same ones that have a say.
                break
            of, walls = tangent.only(rows), (lo[rows], hi[rows])
        moved = of.moved(z - at.coordinates)
        there = solve_tangent(
            z, free, model, tangent.scale, moved, of.jacobian, *walls, sigma, seen.foreign
        ).coordinates
        moved = tangent.moved(there - at.coordinates)
        suits, found = best_sigma(moved, seen, near=sigma)
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

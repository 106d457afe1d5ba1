"""Flat areas: equal pixels are one piece of information, however many they are.

Where rounding is the only noise, the likelihood still allows for a trace of noise, so that it has
slopes. Pixels of a flat area all err together, not each on its own. Where their value lies near the
end of its interval, thousands of them would push it away as no single one does, and the fit with
it. Their interval is therefore widened: all of them together are then as likely at its end as one.
"""

from __future__ import annotations

import math
from statistics import NormalDist

import equinox as eqx
import numpy as np

from godfit.inference.allowances.arithmetic import with_arithmetic
from godfit.inference.noise import EXPLAINED, SINGLE_PRECISION, best_sigma, noise_of
from godfit.inference.observation import Observation
from godfit.inference.problem import Problem
from godfit.inference.settle import Settled, settle
from godfit.inference.solver import Tangent, tangent_at
from godfit.runtime.device import on_device

REPEATED_VALUES = 4
"""Equal values that are no coincidence."""
PUSH_SPREADS = 8.0
"""Standard deviations from the end of an interval beyond which its slope is negligible."""
RELIEF_ROUNDS = 2
"""Rounds of widening and fitting: the second widens by the values of the first fit."""


def relieved(observation: Observation, prediction: np.ndarray, sigma: float) -> Observation:
    """``observation`` with wider intervals for values that are repeated near the end of theirs.
    ``prediction`` (m,) is in levels. It is returned as it is where there are no such values, or
    where ``sigma`` is more than rounding."""
    if sigma > EXPLAINED:
        return observation
    lo, hi = np.array(observation.lo), np.array(observation.hi)
    slack = np.minimum(prediction - lo, hi - prediction)
    # Values that were never rounded have no interval.
    own = observation.own_noise
    noise = np.broadcast_to(noise_of(sigma, None if own is None else np.asarray(own)), lo.shape)
    near = np.flatnonzero((slack < PUSH_SPREADS * noise) & (hi > lo))
    if not len(near):
        return observation
    level = np.rint(prediction[near].astype(np.float64) / SINGLE_PRECISION).astype(np.int64)
    level -= level.min()
    # All lie near an end of some level's interval, so that the table has a few million entries.
    count = np.bincount(level)[level]
    near, count = near[count >= REPEATED_VALUES], count[count >= REPEATED_VALUES]
    if not len(near):
        return observation
    # Python's own: to import scipy's takes a fiftieth of a short command.
    numbers, place = np.unique(count, return_inverse=True)
    ends = [NormalDist().inv_cdf(-math.expm1(-math.log(2) / number)) for number in numbers]
    wider = -noise[near] * np.array(ends, np.float32)[place]
    lo[near] -= wider
    hi[near] += wider
    return eqx.tree_at(lambda s: (s.lo, s.hi), observation, (on_device(lo), on_device(hi)))


def counted_once(
    start: np.ndarray,
    problem: Problem,
    whole: Observation,
    known: list[Tangent],
) -> tuple[Settled, Tangent, Observation]:
    """The fit settled from ``start`` with flat areas counted once, its tangent, and the observation
    that it fits. ``known`` holds the tangent at ``start``, if there is one, and is emptied as in
    ``settle``."""
    tangent = known.pop() if known else tangent_at(start, problem, whole)
    whole = with_arithmetic(whole, problem, start, tangent)
    sigma, _ = best_sigma(tangent.prediction, whole)
    settled, observation = Settled(start, sigma, -np.inf, False), None
    for _ in range(RELIEF_ROUNDS):
        before, observation = observation, relieved(whole, tangent.prediction, settled.sigma)
        if before is whole and observation is whole:
            break
        known = [tangent]
        del tangent
        settled, tangent = settle(
            settled.coordinates, problem, observation, known=known, spot_check=True
        )
    assert observation is not None
    return settled, tangent, observation

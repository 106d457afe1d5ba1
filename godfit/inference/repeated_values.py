"""Flat areas: pixels that are alike say one thing, however many they are.

Where rounding is all the noise there is, the likelihood still allows for a trace of more, so that
it has slopes. Pixels of a flat area all err together, not each on its own: where their value lies
near the end of its interval, thousands of them would push it away as no single one does, and the
whole answer with it. Their interval is therefore widened by as much as makes all of them together,
at its very end, as likely as one.
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.special import ndtri

from godfit.inference.noise import EXPLAINED, best_sigma
from godfit.inference.observation import Observation
from godfit.inference.problem import Problem
from godfit.inference.settle import Settled, settle
from godfit.inference.solver import Tangent, tangent_at

# Levels within which values are alike, and so many of them that it is no chance.
ALIKE, MANY = 1e-4, 4
# Standard deviations from the end of an interval beyond which it pushes nobody.
REACH = 8.0
ROUNDS = 2


def relieved(observation: Observation, prediction: np.ndarray, sigma: float) -> Observation:
    """``observation`` with wider intervals for values that are repeated near the end of theirs, as
    ``prediction`` (m,) has them in levels; itself where there are none, or where more noise than
    rounding is left."""
    if sigma > EXPLAINED:
        return observation
    lo, hi = np.array(observation.lo), np.array(observation.hi)
    slack = np.minimum(prediction - lo, hi - prediction)
    # Values that were never rounded have no interval.
    near = np.flatnonzero((slack < REACH * sigma) & (hi > lo))
    if not len(near):
        return observation
    alike = np.rint(prediction[near].astype(np.float64) / ALIKE).astype(np.int64)
    alike -= alike.min()
    # All lie near an end of some level, so that there are few millions to be counted.
    count = np.bincount(alike)[alike]
    near, count = near[count >= MANY], count[count >= MANY]
    if not len(near):
        return observation
    wider = -sigma * ndtri(-np.expm1(-np.log(2) / count)).astype(np.float32)
    lo[near] -= wider
    hi[near] += wider
    return eqx.tree_at(lambda s: (s.lo, s.hi), observation, (jnp.asarray(lo), jnp.asarray(hi)))


def counted_once(
    start: np.ndarray,
    problem: Problem,
    whole: Observation,
    known: list[Tangent],
) -> tuple[Settled, Tangent, Observation]:
    """Settled from ``start`` on with flat areas counted once; and the observation that it is then a
    fit to. ``known`` holds the tangent at ``start``, if there is one, and is emptied as in
    ``settle``."""
    tangent = known.pop() if known else tangent_at(start, problem, whole)
    sigma, _ = best_sigma(tangent.prediction, whole)
    settled, observation = Settled(start, sigma, -np.inf, False), None
    for _ in range(ROUNDS):
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

"""The mean of several frames' estimates of the same few parameters.

A frame's likelihood is represented by its estimate and covariance (Laplace). The product of the
likelihoods is the mean weighted by information, as in any meta-analysis. Frames can be wrong as a
whole: a frame weighs less the farther off it is (multivariate Student's t: Lange, Little & Taylor,
JASA 84 (1989), 881), and beyond a limit is left out. Where frames scatter by more than their
errors, the error of the mean is widened by as much (Birge, Phys. Rev. 40 (1932), 207). Where
leaving out one frame after the other moves the mean by more than its error, the error is widened
by that too (the jackknife: Tukey, Ann. Math. Stat. 29 (1958), 614). A frame's covariance can claim
far too small an error for some combination, which its single errors do not show.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, ndtri, stdtrit

T_FREEDOM = 4.0
"""Degrees of freedom of Student's t: robust, and nearly as efficient as the normal distribution."""
LEFT_OUT_CHANCE = 1e-3
"""Probability that a sound frame is left out."""
POOLING_ROUNDS = 100
"""Rounds of reweighting, at most: they end once the mean stays."""


class Pool(NamedTuple):
    """``mean`` (k,) and its ``covariance`` (k, k), whose diagonal is infinite where no frame
    determines the parameter; ``agrees`` (f,) is False for frames left out; ``growth`` is the factor
    by which the variance was widened."""

    mean: np.ndarray
    covariance: np.ndarray
    agrees: np.ndarray
    growth: float


def pooled(answers: np.ndarray, informations: np.ndarray) -> Pool:
    """The mean of ``answers`` (f, k) whose inverse covariances are ``informations`` (f, k, k), 0 in
    rows that a frame does not determine."""
    answers, informations = np.asarray(answers, float), np.asarray(informations, float)
    count = np.count_nonzero(np.diagonal(informations, axis1=1, axis2=2) > 0, axis=1)
    limit = chdtri(np.maximum(count, 1), LEFT_OUT_CHANCE)
    # The first mean is the frame with the smallest distances to the others, each one limited.
    apart = np.stack([_distances(a, answers, informations) for a in answers])
    mean = answers[np.minimum(apart, limit[None]).sum(1).argmin()]
    for _ in range(POOLING_ROUNDS):
        weights = (T_FREEDOM + count) / (T_FREEDOM + _distances(mean, answers, informations))
        before, mean = mean, _mean(answers, informations, weights, mean)
        if np.allclose(mean, before, rtol=1e-9, atol=1e-12):
            break
    agrees = _distances(mean, answers, informations) <= limit
    if not agrees.any():
        agrees[:] = True
    weights = agrees.astype(float)
    mean = _mean(answers, informations, weights, mean)
    misfit = float(_distances(mean, answers, informations)[agrees].sum())
    freedom = int(count[agrees].sum()) - int(count.max(initial=0))
    growth = max(1.0, misfit / freedom) if freedom > 0 else 1.0
    whole = np.tensordot(weights, informations, 1)
    determined = np.diag(whole) > 0
    covariance = np.diag(np.where(determined, 0.0, np.inf))
    covariance[np.ix_(determined, determined)] = growth * np.linalg.inv(
        whole[np.ix_(determined, determined)]
    )
    size = np.sqrt(np.diag(covariance)[determined])
    moved = _jackknife_errors(mean, answers[agrees], informations[agrees])[determined]
    wider = np.maximum(1.0, moved / size)
    covariance[np.ix_(determined, determined)] *= np.outer(wider, wider)
    return Pool(mean, covariance, agrees, growth)


def _jackknife_errors(
    mean: np.ndarray, answers: np.ndarray, informations: np.ndarray
) -> np.ndarray:
    """(k,) standard errors of the mean by the jackknife, widened for the small number of frames; 0
    where there is one frame only."""
    count = len(answers)
    if count < 2:
        return np.zeros(len(mean))
    others = ~np.eye(count, dtype=bool)
    means = np.stack([_mean(answers, informations, k.astype(float), mean) for k in others])
    error = np.sqrt((count - 1) / count * ((means - means.mean(0)) ** 2).sum(0))
    return error * stdtrit(count - 1, 0.975) / ndtri(0.975)


def _distances(mean: np.ndarray, answers: np.ndarray, informations: np.ndarray) -> np.ndarray:
    """(f,) squared distances in units of each frame's own errors."""
    off = answers - mean
    return np.einsum("fi,fij,fj->f", off, informations, off)


def _mean(answers, informations, weights, otherwise) -> np.ndarray:
    """(k,) the weighted mean; ``otherwise`` (k,) where no frame determines a parameter."""
    whole = np.tensordot(weights, informations, 1)
    pull = np.einsum("f,fij,fj->i", weights, informations, answers)
    determined = np.diag(whole) > 0
    mean = np.array(otherwise)
    mean[determined] = np.linalg.solve(whole[np.ix_(determined, determined)], pull[determined])
    return mean

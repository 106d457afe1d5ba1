"""What several frames say of the same few numbers, together.

Each frame's answer and its covariance are what is left of its likelihood (Laplace); their product
is the mean weighted by information, as in any meta-analysis. Frames can be wrong as a whole: a
frame weighs less the farther off it is (multivariate Student's t: Lange, Little & Taylor, JASA 84
(1989), 881), and beyond doubt is left out. Where frames scatter by more than they quote, the error
of the mean is widened by as much (Birge, Phys. Rev. 40 (1932), 207); and where the mean moves by
more than that from leaving one frame out after the other, by as much as this says (the jackknife:
Tukey, Ann. Math. Stat. 29 (1958), 614). A frame's covariance can claim far too much of some
combination, which its own single numbers do not show.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, ndtri, stdtrit

# Degrees of freedom of the t, and the chance of a sound frame to be left out.
TAILS, CHANCE = 4.0, 1e-3
ROUNDS = 100


class Pool(NamedTuple):
    """``mean`` (k,) and its ``covariance`` (k, k), whose diagonal is infinite where no frame says
    anything; ``agrees`` (f,) is False for frames left out; ``growth`` is by how much the variance
    was widened."""

    mean: np.ndarray
    covariance: np.ndarray
    agrees: np.ndarray
    growth: float


def pooled(answers: np.ndarray, informations: np.ndarray) -> Pool:
    """The mean of ``answers`` (f, k) whose inverse covariances are ``informations`` (f, k, k), 0 in
    the rows of what a frame does not tell."""
    answers, informations = np.asarray(answers, float), np.asarray(informations, float)
    count = np.count_nonzero(np.diagonal(informations, axis1=1, axis2=2) > 0, axis=1)
    limit = chdtri(np.maximum(count, 1), CHANCE)
    # From the frame that the others are least far from, no one frame too far.
    apart = np.stack([_distances(a, answers, informations) for a in answers])
    mean = answers[np.minimum(apart, limit[None]).sum(1).argmin()]
    for _ in range(ROUNDS):
        weights = (TAILS + count) / (TAILS + _distances(mean, answers, informations))
        before, mean = mean, _mean(answers, informations, weights, mean)
        if np.allclose(mean, before, rtol=1e-9, atol=1e-12):
            break
    agrees = _distances(mean, answers, informations) <= limit
    if not agrees.any():
        agrees[:] = True
    weights = agrees.astype(float)
    mean = _mean(answers, informations, weights, mean)
    left = float(_distances(mean, answers, informations)[agrees].sum())
    freedom = int(count[agrees].sum()) - int(count.max(initial=0))
    growth = max(1.0, left / freedom) if freedom > 0 else 1.0
    whole = np.tensordot(weights, informations, 1)
    told = np.diag(whole) > 0
    covariance = np.diag(np.where(told, 0.0, np.inf))
    covariance[np.ix_(told, told)] = growth * np.linalg.inv(whole[np.ix_(told, told)])
    size = np.sqrt(np.diag(covariance)[told])
    moved = _left_out(mean, answers[agrees], informations[agrees])[told]
    wider = np.maximum(1.0, moved / size)
    covariance[np.ix_(told, told)] *= np.outer(wider, wider)
    return Pool(mean, covariance, agrees, growth)


def _left_out(mean: np.ndarray, answers: np.ndarray, informations: np.ndarray) -> np.ndarray:
    """(k,) standard errors of the mean by the jackknife, as wide as so few frames ask for; 0 where
    one frame alone tells."""
    count = len(answers)
    if count < 2:
        return np.zeros(len(mean))
    kept = ~np.eye(count, dtype=bool)
    means = np.stack([_mean(answers, informations, k.astype(float), mean) for k in kept])
    error = np.sqrt((count - 1) / count * ((means - means.mean(0)) ** 2).sum(0))
    return error * stdtrit(count - 1, 0.975) / ndtri(0.975)


def _distances(mean: np.ndarray, answers: np.ndarray, informations: np.ndarray) -> np.ndarray:
    """(f,) squared distances in units of each frame's own errors."""
    off = answers - mean
    return np.einsum("fi,fij,fj->f", off, informations, off)


def _mean(answers, informations, weights, otherwise) -> np.ndarray:
    """The weighted mean, ``otherwise`` (k,) in what no frame tells."""
    whole = np.tensordot(weights, informations, 1)
    pull = np.einsum("f,fij,fj->i", weights, informations, answers)
    told = np.diag(whole) > 0
    mean = np.array(otherwise)
    mean[told] = np.linalg.solve(whole[np.ix_(told, told)], pull[told])
    return mean

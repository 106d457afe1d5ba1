"""What the fitted point is worth: covariance, undetermined combinations, structure that is left."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from godfit.likelihood import interval
from godfit.observation import Observation
from godfit.search import Settled, Tangent


class Evidence(NamedTuple):
    """The likelihood about the fitted point.

    ``curvature`` (p, p) is the sum of -d2 log-likelihood, ``scores`` (p, p) the sum of the outer
    products of its slopes, ``gradient`` (p,) the sum of its slopes, all by coordinate;
    ``prediction`` (m,) is in levels, ``score`` (m,) the slope of each value's log-likelihood in
    units of sigma.
    """

    curvature: np.ndarray
    scores: np.ndarray
    gradient: np.ndarray
    prediction: np.ndarray
    score: np.ndarray

    def covariance(self, free: np.ndarray) -> np.ndarray:
        """(p, p) covariance of the coordinates, zero for those that are not free."""
        information = self.curvature[np.ix_(free, free)]
        # Scaled to a unit diagonal first: the coordinates' units differ by orders of magnitude.
        size = np.sqrt(np.maximum(np.diag(information), 1e-300))
        inverse = np.linalg.pinv(information / np.outer(size, size), hermitian=True)
        covariance = np.zeros_like(self.curvature)
        covariance[np.ix_(free, free)] = inverse / np.outer(size, size)
        return covariance


@jax.jit
def _evidence(prediction, jacobian, lo, hi, sigma):
    jacobian = jacobian / sigma
    pixel = interval((lo - prediction) / sigma, (hi - prediction) / sigma)
    weighted = jacobian * pixel.curvature[:, None]
    scores = jacobian * pixel.slope[:, None]
    return weighted.T @ jacobian, scores.T @ scores, scores.sum(0), pixel.slope


def evidence(settled: Settled, tangent: Tangent, seen: Observation) -> Evidence:
    """The evidence at a settled point."""
    curvature, scores, gradient, score = _evidence(
        tangent.prediction, tangent.jacobian, seen.lo, seen.hi, jnp.float32(settled.sigma)
    )
    # Summed in scaled coordinates, where float32 holds all entries alike.
    size = np.outer(tangent.scale, tangent.scale).astype(np.float64)
    return Evidence(
        np.asarray(curvature, np.float64) / size,
        np.asarray(scores, np.float64) / size,
        np.asarray(gradient, np.float64) / tangent.scale,
        np.asarray(tangent.prediction),
        np.asarray(score),
    )


def undetermined(
    information: np.ndarray, ranges: np.ndarray, free: np.ndarray
) -> list[tuple[int, list[int]]]:
    """Coordinates to hold because the picture leaves them open, each with those it trades with.

    A direction is open if moving along it over the coordinates' plausible ``ranges`` changes the
    log-likelihood by less than 1/2. The coordinate that has most of it is held, and the rest looked
    at again.
    """
    open_: list[tuple[int, list[int]]] = []
    left = list(np.flatnonzero(free))
    while left:
        block = information[np.ix_(left, left)] * np.outer(ranges[left], ranges[left])
        values, vectors = np.linalg.eigh(block)
        if values[0] >= 1:
            break
        direction = np.abs(vectors[:, 0])
        most = int(np.argmax(direction))
        partners = [left[i] for i in np.flatnonzero(direction > 0.3) if i != most]
        open_.append((left[most], partners))
        del left[most]
    return open_


def neighbour_correlation(score: np.ndarray, pixels: np.ndarray, width: int) -> float:
    """Correlation of the scores of horizontal neighbours, (n,) or (n, channels), pixels sorted."""
    score = score.reshape(len(pixels), -1).mean(-1)
    beside = (np.diff(pixels) == 1) & (pixels[1:] % width != 0)
    a, b = score[:-1][beside], score[1:][beside]
    power = float(np.mean(score**2))
    return float(np.mean(a * b)) / power if len(a) and power > 0 else 0.0

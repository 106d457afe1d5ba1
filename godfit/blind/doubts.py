"""How far off an answer may be: under masks as likely as the one that was found with it, and where
the right dip of the cost is the next one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import ndimage

from godfit.inference.evaluate import predicted
from godfit.inference.observation import Observation
from godfit.inference.problem import Problem
from godfit.inference.settle import Settled
from godfit.inference.solver import Intervals, Tangent, solve_tangent
from godfit.io.sources import shrink_mask
from godfit.models.coordinates import DENSITY


def rivals(
    mask: np.ndarray, searched: np.ndarray, first: np.ndarray, pass_scale: float
) -> Iterator[np.ndarray]:
    """Masks of the light pass's size as likely as ``mask``, which was found: as far from it as
    objects a pixel larger or smaller, and as ``first`` (h, w) seen, are from what the search had
    ended with, ``searched`` (h, w)."""
    away = mask - shrink_mask(searched, pass_scale)
    larger = np.asarray(ndimage.minimum_filter(searched, 3))
    smaller = np.asarray(ndimage.maximum_filter(searched, 3))
    for other in (smaller, larger, first):
        yield (away + shrink_mask(other, pass_scale)).clip(0, 1).astype(np.float32)


def shift(
    settled: Settled, tangent: Tangent, problem: Problem, seen: Observation, mask: np.ndarray
) -> np.ndarray:
    """(p,) how far the answer moves where ``mask`` (h, w) is the right one, on the tangent."""
    model, free, held = problem.model, problem.free, problem.held
    other = seen.with_mask(mask)
    prediction = np.asarray(predicted(settled.coordinates, held, model, other))
    lo, hi = np.asarray(seen.lo), np.asarray(seen.hi)
    # Where the other mask would make a pixel foreign it is not that mask that is right.
    sigma = max(settled.sigma, 0.5)
    point = solve_tangent(
        settled.coordinates, problem, tangent._replace(prediction=prediction),
        Intervals(lo, hi, seen.foreign), sigma,
    )  # fmt: skip
    return np.where(free, point.coordinates - settled.coordinates, 0.0)


def next_dip(settled: Settled, covariance: np.ndarray, samples: int) -> np.ndarray:
    """(p,) how far the next of the dips lies that the taps make in the cost by density, see
    ``dips.py``: with a mask of one's own making the deepest need not be the right one."""
    dip = float(settled.coordinates[DENSITY]) / samples
    return covariance[:, DENSITY] / covariance[DENSITY, DENSITY] * dip

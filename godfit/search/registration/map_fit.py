"""The map of a mask onto a target that explains the target best.

The four numbers of the map are improved by Gauss-Newton steps on a few thousand pixels, with the
parameters' own steps projected out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from godfit.inference.observation import Observation
from godfit.inference.problem import SEARCH_PIXELS, Problem
from godfit.inference.settle import Settled, settle
from godfit.inference.solver import Tangent
from godfit.inference.strategy import stages, starting_points
from godfit.search import multigrid
from godfit.search.registration.maps import Map

STEP = 0.25
"""Pixels by which the mask is moved for a derivative: over less, few of its edges cross a pixel
centre, whose interpolation has kinks."""
ROUNDS = 8
"""Gauss-Newton steps, at most."""
LEAST_STEP = 1e-3
"""Pixels below which another step is not worth it."""


class Solved(NamedTuple):
    """The best ``map``, where the parameters ``settled`` under it, and ``shifts``, the changes of
    the coordinates (p,) by an error of each direction of the map."""

    map: Map
    settled: Settled
    shifts: tuple[np.ndarray, ...]


class MapFit:
    """Maps of ``mask`` (H, W, ...) onto the target of a ``problem``."""

    def __init__(self, problem: Problem, mask: np.ndarray) -> None:
        self.problem, self.mask = problem, np.asarray(mask, np.float32)
        if problem.picture.mask.ndim == 2 and self.mask.ndim == 3:
            self.mask = self.mask[..., 0]
        self.size = problem.picture.size
        self.observation = problem.observe(SEARCH_PIXELS)

    def begin(self, guess: Map, given: dict[str, float]) -> Settled:
        """Where a search from no start settles under the mask mapped by ``guess``."""
        problem = self.posed(guess)
        starts = starting_points(problem, given)
        if problem.free.any():
            climbed = multigrid.climb(
                problem.small, starts, lambda text: None, stages=stages(problem.model)
            )
            starts = [climbed.coordinates]
        return settle(starts[0], problem, self._view(problem))[0]

    def under(self, moved: np.ndarray, start: np.ndarray) -> tuple[Settled, Tangent, Problem]:
        """Where the parameters settle under a mask of the target's size, with the tangent there."""
        problem = self.problem.replaced(picture=self.problem.picture.with_mask(moved))
        settled, tangent = settle(start, problem, self._view(problem))
        return settled, tangent, problem

    def solve(self, guess: Map, begun: Settled) -> Solved:
        """The map that explains the picture best, from a ``guess`` under which the parameters have
        ``begun``."""
        corners = guess.corners(self.size)
        best, tangent, problem = self._at(corners, begun.coordinates)
        step, slopes, errors = self._step(corners, best, tangent, problem)
        part = 1.0
        for _ in range(ROUNDS):
            if np.abs(step * part).max() < LEAST_STEP:
                break
            other = corners + part * step
            settled, moved, there = self._at(other, best.coordinates + slopes @ (part * step))
            if settled.log_likelihood <= best.log_likelihood:
                part /= 2
                continue
            corners, best = other, settled
            step, slopes, errors = self._step(corners, best, moved, there)
            part = 1.0
        shifts = tuple(slopes @ error for error in errors)
        return Solved(Map.of(corners, self.size), best, shifts)

    def posed(self, guess: Map) -> Problem:
        """The problem under the mask mapped so."""
        moved = guess.applied(self.mask, self.size)
        return self.problem.replaced(picture=self.problem.picture.with_mask(moved))

    def _view(self, problem: Problem) -> Observation:
        return self.observation.with_mask(problem.picture.mask)

    def _at(self, corners: np.ndarray, start: np.ndarray) -> tuple[Settled, Tangent, Problem]:
        return self.under(Map.of(corners, self.size).applied(self.mask, self.size), start)

    def _step(
        self, corners: np.ndarray, settled: Settled, tangent: Tangent, problem: Problem
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The Gauss-Newton step of the corners, the slopes (p, 4) of the parameters by them, and
        their errors (4, 4), one a row."""
        lo, hi = np.asarray(self.observation.lo), np.asarray(self.observation.hi)
        known = np.isfinite(lo) & np.isfinite(hi)
        residual = ((lo + hi) / 2 - tangent.prediction)[known].astype(np.float64)
        columns = []
        for k in range(4):
            ends = [self._levels(corners + sign * STEP * np.eye(4)[k], settled) for sign in (1, -1)]
            columns.append((ends[0] - ends[1])[known] / (2 * STEP))
        free = problem.free
        inner = tangent.jacobian[free][:, known].T.astype(np.float64)
        jacobian = np.concatenate([inner, np.stack(columns, -1)], 1)
        size = np.maximum(np.sqrt((jacobian**2).sum(0)), 1e-12)
        solution, *_ = np.linalg.lstsq(jacobian / size, residual, rcond=None)
        count = int(free.sum())
        by_corner, *_ = np.linalg.lstsq(inner, -np.stack(columns, -1), rcond=None)
        slopes = np.zeros((len(free), 4))
        slopes[free] = by_corner * np.asarray(tangent.scale, float)[free, None]
        spread = np.linalg.pinv((jacobian / size).T @ (jacobian / size))
        spread = spread * max(float((residual**2).mean()), 1e-12)
        covariance = (spread / np.outer(size, size))[count:, count:]
        values, vectors = np.linalg.eigh(covariance)
        errors = np.sqrt(np.maximum(values, 0))[:, None] * vectors.T
        return (solution / size)[count:], slopes, errors

    def _levels(self, corners: np.ndarray, settled: Settled) -> np.ndarray:
        problem = self.posed(Map.of(corners, self.size))
        model = problem.at(settled.coordinates)
        return np.asarray(self._view(problem).predict(model), np.float64)

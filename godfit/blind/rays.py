"""The misfit of a light pass of which the mask is unknown, and its slopes.

Only the right light and the right numbers give a mask that is possible: white, or at most the dim
background ``dim``, nowhere brighter and nowhere below black. A candidate is eight numbers; the mask
along each ray is solved for, see ``ray_kernel.py``.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from godfit.blind.ray_kernel import cell_means, curvature, kernel_weights, solve_rays

RAYS = 56
"""Rays from a candidate light: fewer miss objects, more take time alone."""
STEP = 0.065
"""Distance of two bins, in the logarithm of the radius: a tenth of the shortest usual ray."""
INNERMOST = 0.008
"""Radius of the innermost bin, in widths: a few pixels, below which rays are not resolved."""
OPEN = 0.005
"""Cost of a level by which the mask outside the light's disc is below the dim background: it is
open where nothing speaks against that."""
FAINT_LIGHT, SMALL_LIGHT = 0.01, 0.04
"""Cost of the logarithms of the light's brightness and of its radius: the tightest disc that
explains the picture is kept."""
SMALLEST = 0.025
"""Radius in widths below which a disc is no better for being smaller: a bin or two."""


class Candidate(NamedTuple):
    """Light (u, v); attenuation ``kappa`` along a ray; density ``rho``; the own pixel's weight
    ``own`` against all taps; levels of the light pass over a mask of the dim background, ``dim``,
    and over a white one, ``bright``; ``radius`` of the light's disc, in widths."""

    u: float
    v: float
    kappa: float
    rho: float
    own: float
    dim: float
    bright: float
    radius: float


class View(NamedTuple):
    """A light pass in levels, ``image`` (h, w), and ``known`` (h, w), 1 where that is the light
    pass, 0 where it is at least that."""

    image: np.ndarray
    known: np.ndarray


class Misfit(NamedTuple):
    """The cost of a candidate, its slopes (8,) and its curvature (8, 8), by the numbers of a
    candidate, the last two in their logarithms."""

    cost: float
    slope: np.ndarray | None = None
    curvature: np.ndarray | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class RayMisfit:
    """The misfit on a copy (h, w) of a light pass in levels, known where ``known`` is 1.

    There are so many ``rays``, and bins a ``step`` apart.
    """

    image: np.ndarray
    known: np.ndarray
    rays: int = RAYS
    step: float = STEP

    @property
    def radii(self) -> np.ndarray:
        """Radii of the bins, in pixels of the copy: up to its diagonal."""
        h, w = self.image.shape
        count = int(np.log(np.hypot(h, w) / (INNERMOST * w)) / self.step) + 1
        return INNERMOST * w * np.exp(self.step * np.arange(count))

    def __call__(self, at: Candidate, x: np.ndarray, rounds: int, slopes: bool = True) -> Misfit:
        """The misfit of a candidate. ``x`` (rays, bins), levels of the light pass over the mask's
        values, is where the solution begins and where it is written."""
        h, w = self.image.shape
        radii = self.radii
        place = np.array([at.u * w - 0.5, (1 - at.v) * h - 0.5])
        first, turn = _angles(place, w, h)
        grid = np.array([self.rays, self.step])
        light, by_x, by_y, sure = cell_means(
            self.image, self.known, place, first, turn, radii, grid
        )
        weight = sure * radii**2
        weight /= max(weight.sum(), 1e-12)
        design = self.design(at)
        place_in = (np.log(at.radius * w) - np.log(radii)) / self.step + 0.5
        inside = np.clip(place_in, 0, 1)
        inside[0] = 1.0
        upper = at.dim + (at.bright - at.dim) * inside
        pull = OPEN / x.size * (1 - inside)
        np.minimum(x, upper, out=x)
        residual = solve_rays(light, weight, design, np.stack([upper, pull]), x, rounds)
        force = weight * residual
        cost = 0.5 * float((force * residual).sum()) + float((pull * (upper - x)).sum())
        cost += float(FAINT_LIGHT * np.log(at.bright))
        cost += float(SMALL_LIGHT * np.log(max(at.radius, SMALLEST)))
        if not slopes:
            return Misfit(cost)
        # How residuals change with each number, while what is between its bounds stays.
        at_bound = x >= upper
        moved = np.zeros((8, *x.shape))
        moved[0], moved[1] = by_x * w, -by_y * h
        for i, by in ((2, 1e-3), (3, 1e-3), (4, 1e-4)):
            change = self.design(_with(at, i, by)) - self.design(_with(at, i, -by))
            moved[i] = -(x @ change.T) / (2 * by)
        partly = (inside > 0) & (inside < 1)
        wider = (at.bright - at.dim) * partly / self.step
        for i, grown in ((5, 1 - inside), (6, inside * at.bright), (7, wider)):
            moved[i] = -(at_bound * grown) @ design.T
        slope = (force * moved).sum((1, 2))
        interior = pull * (~at_bound).sum(0)
        slope[5] += (interior * (1 - inside)).sum()
        slope[6] += (interior * inside).sum() * at.bright + FAINT_LIGHT
        slope[7] += (interior * wider).sum() + SMALL_LIGHT * (at.radius > SMALLEST)
        slope[7] -= (OPEN / x.size * (upper - x) * partly / self.step).sum()
        return Misfit(cost, slope, curvature(x, weight, design, upper, moved))

    def design(self, at: Candidate) -> np.ndarray:
        """(bins, bins) light pass at each bin by x at each bin."""
        n = len(self.radii)
        kernel, inner = kernel_weights(at.kappa, at.rho, at.own, self.step, n)
        full = np.concatenate([kernel, np.zeros(n)])
        lag = np.subtract.outer(np.arange(n), np.arange(n))
        design = np.where(lag >= 0, full[np.maximum(lag, 0)], 0.0)
        design[:, 0] = inner
        return design


def _angles(place: np.ndarray, w: int, h: int) -> tuple[float, float]:
    """The first angle and the range of angles under which a picture lies from a ``place`` (column,
    row): all of them inside it."""
    x, y = place
    if -0.5 < x < w - 0.5 and -0.5 < y < h - 0.5:
        return 0.0, 2 * np.pi
    corners = np.array([(a, b) for a in (-0.5, w - 0.5) for b in (-0.5, h - 0.5)]) - place
    middle = np.arctan2((h - 1) / 2 - y, (w - 1) / 2 - x)
    off = (np.arctan2(corners[:, 1], corners[:, 0]) - middle + np.pi) % (2 * np.pi) - np.pi
    return float(middle + off.min()), float(np.ptp(off))


def _with(at: Candidate, index: int, by: float) -> Candidate:
    """The candidate with one number larger by ``by``."""
    numbers = list(at)
    numbers[index] += by
    return Candidate(*numbers)

"""The misfit of a light pass of which the mask is unknown, and its slopes.

Only the right light and the right numbers give a mask that is possible: white, or at most the dim
background ``dim``, nowhere brighter and nowhere below black. A candidate is eight numbers; the mask
along each ray is solved for, see ``ray_kernel.py``.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from godfit.blind.ray_kernel import kernel_weights, cell_means, slopes, solve_rays

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


@dataclasses.dataclass(frozen=True, eq=False)
class RayMisfit:
    """The misfit on a copy (h, w) of a light pass in levels, known where ``known`` is 1."""

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

    def __call__(self, at: Candidate, x: np.ndarray, sweeps: int) -> tuple[float, np.ndarray]:
        """The cost of a candidate and its slopes (8,). ``x`` (rays, bins), levels of the light pass
        over the mask's values, is where the solution begins and where it is written."""
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
        kernel, inner = kernel_weights(at.kappa, at.rho, at.own, self.step, len(radii))
        place_in = (np.log(at.radius * w) - np.log(radii)) / self.step + 0.5
        inside = np.clip(place_in, 0, 1)
        inside[0] = 1.0
        upper = at.dim + (at.bright - at.dim) * inside
        pull = OPEN / x.size * (1 - inside)
        np.minimum(x, upper, out=x)
        bounds = np.stack([upper, pull])
        residual = solve_rays(light, weight, kernel, inner, bounds, x, sweeps)
        force = weight * residual
        cost = 0.5 * float((force * residual).sum() + 2 * (pull * (upper - x)).sum())
        cost += FAINT_LIGHT * np.log(at.bright) + SMALL_LIGHT * np.log(at.radius)
        by_kernel, by_inner, at_bound = slopes(x, force, kernel, inner, upper)
        slope = np.zeros(8)
        slope[0] = (force * by_x).sum() * w
        slope[1] = -(force * by_y).sum() * h
        for i, by in ((2, 1e-4), (3, 1e-4), (4, 1e-5)):
            moved = [
                kernel_weights(*(np.array(at[2:5]) + s * by * (np.arange(3) == i - 2)), self.step, len(radii))
                for s in (-1, 1)
            ]
            change = np.zeros(len(radii))
            change[: len(moved[1][0])] += moved[1][0]
            change[: len(moved[0][0])] -= moved[0][0]
            slope[i] = -(by_kernel @ change + by_inner @ (moved[1][1] - moved[0][1])) / (2 * by)
        interior = (x < upper).sum(0)
        by_upper = -at_bound + pull * interior
        slope[5] = (by_upper * (1 - inside)).sum()
        slope[6] = (by_upper * inside).sum() + FAINT_LIGHT / at.bright
        by_inside = by_upper * (at.bright - at.dim) - OPEN / x.size * (upper - x).sum(0)
        partly = (inside > 0) & (inside < 1)
        slope[7] = (by_inside * partly).sum() / (self.step * at.radius) + SMALL_LIGHT / at.radius
        return cost, slope


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

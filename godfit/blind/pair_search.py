"""The search of light and numbers in a light pass whose mask is unknown."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import optimize

from godfit.blind.rays import INNERMOST, Candidate, RayMisfit

SCALES = np.array([0.01, 0.01, 0.5, 0.05, 0.01, 3.0, 0.2, 0.2])
"""Steps of a candidate's numbers that change the cost alike; the last two are logarithms."""
LOWER = np.array([-0.5, -0.5, 0.02, 0.1, 0.0, 1e-3, 1.0, np.log(0.012)])
UPPER = np.array([1.5, 1.5, 20.0, 0.995, 0.3, 250.0, 9.0, np.log(0.4)])
"""Ranges of the eight numbers, the last two as logarithms."""
COARSE = (28, 0.13)
"""Rays and step of the misfit on the grid: a quarter of the work."""
GRID = 26
"""Lights of the grid across the picture's width."""
MARGIN = 0.15
"""How far the grid goes beyond the picture, as a share of its size."""
GRID_NUMBERS = ((2.0, 0.8, 0.05), (5.0, 0.8, 0.05), (3.0, 0.8, 0.12))
"""Attenuation, density and radius at each of the lights."""
STARTS = 8
"""Lights of the grid from which the numbers are solved for."""
APART = 0.04
"""Distance of two of them, in widths, at least."""
KEPT = 3
"""The best of them, which are solved for once more on the fine rays."""
FIRST_SWEEPS, SWEEPS = 30, 12
"""Sweeps along each ray from nothing, and from where the last candidate's solution is."""


class Place(NamedTuple):
    """A candidate and its cost."""

    at: Candidate
    cost: float


def _unpacked(z: np.ndarray) -> Candidate:
    z = np.clip(z * SCALES, LOWER, UPPER)
    return Candidate(*z[:6], float(np.exp(z[6])), float(np.exp(z[7])))


def _packed(at: Candidate) -> np.ndarray:
    z = np.array([*at[:6], np.log(at.bright), np.log(at.radius)])
    return np.clip(z, LOWER, UPPER) / SCALES


def climb(misfit: RayMisfit, start: Candidate, free: np.ndarray, steps: int) -> Place:
    """The candidate that L-BFGS reaches from ``start`` in at most so many ``steps``; ``free`` (8,)
    says which numbers move."""
    x = np.full((misfit.rays, len(misfit.radii)), start.dim)
    misfit(start, x, FIRST_SWEEPS)
    z0 = _packed(start)

    def cost(part):
        z = z0.copy()
        z[free] = part
        at = _unpacked(z)
        value, slope = misfit(at, x, SWEEPS)
        slope[6] *= at.bright
        slope[7] *= at.radius
        return value, (slope * SCALES)[free]

    bounds = list(zip((LOWER / SCALES)[free], (UPPER / SCALES)[free], strict=True))
    found = optimize.minimize(
        cost, z0[free], jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": steps}
    )
    z0[free] = found.x
    return Place(_unpacked(z0), float(found.fun))


def grid_lights(size: tuple[int, int], near: tuple[float, float] | None) -> np.ndarray:
    """(n, 2) lights that are tried: over the picture and a margin, or about ``near``."""
    if near is not None:
        steps = np.linspace(-0.04, 0.04, 5)
        return np.array([(near[0] + a, near[1] + b) for a in steps for b in steps])
    h, w = size
    across = np.linspace(-MARGIN, 1 + MARGIN, GRID)
    rows = max(4, int(round(GRID * h / w)))
    up = np.linspace(-MARGIN, 1 + MARGIN, rows)
    return np.array([(a, b) for a in across for b in up])


def first_places(image, known, lights, own, report: Callable | None = None) -> list[Place]:
    misfit = RayMisfit(image, known, *COARSE)
    shown = image[known > 0]
    dim = float(np.median(shown))
    bright = 2 * max(float(shown.max()), 50.0)
    x = np.empty((misfit.rays, len(misfit.radii)))
    out = []
    for u, v in lights:
        best = None
        for kappa, rho, radius in GRID_NUMBERS:
            at = Candidate(u, v, kappa, rho, own, dim, bright, radius)
            x[:] = dim
            value, _ = misfit(at, x, 8)
            if best is None or value < best.cost:
                best = Place(at, value)
        out.append(best)
    return sorted(out, key=lambda place: place.cost)


def apart(places: list[Place], count: int, aspect: float) -> list[Place]:
    kept = []
    for place in places:
        gaps = [np.hypot(place.at.u - o.at.u, (place.at.v - o.at.v) * aspect) for o in kept]
        if all(g > APART for g in gaps) and len(kept) < count:
            kept.append(place)
    return kept


def search(image, known, own_pixel: bool, near=None) -> list[Place]:
    """Places, best first."""
    h, w = image.shape
    own = 0.01 if own_pixel else 0.0
    free = np.ones(8, bool)
    free[4] = own_pixel
    grid = first_places(image, known, grid_lights((h, w), near), own)
    starts = apart(grid, STARTS, h / w)
    coarse = RayMisfit(image, known, *COARSE)
    climbed = sorted((climb(coarse, s.at, free, 40) for s in starts), key=lambda p: p.cost)
    fine = RayMisfit(image, known)
    ends = [climb(fine, p.at, free, 60) for p in apart(climbed, KEPT, h / w)]
    return sorted(ends, key=lambda p: p.cost)

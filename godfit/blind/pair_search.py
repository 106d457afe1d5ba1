"""The search of light and numbers in a light pass whose mask is unknown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from godfit.blind.rays import Candidate, RayMisfit, View
from godfit.runtime.parallel import parallel_map

SCALES = np.array([0.01, 0.01, 0.5, 0.05, 0.005, 3.0, 0.2, 0.2])
"""Steps of a candidate's numbers that change the cost alike; the last two are logarithms."""
LOWEST = np.array([-0.5, -0.5, 0.02, 0.1, 0.0, 1e-3, 1.0, np.log(0.012)])
HIGHEST = np.array([1.5, 1.5, 20.0, 0.995, 0.3, 250.0, 9.0, np.log(0.4)])
"""Ranges of the eight numbers, the last two as logarithms."""
OWN = (0.9, 3.5)
"""Range of the own pixel's weight times the number of taps: that of 1 over a shader's weight,
whose sliders end at 1."""
COARSE = (28, 0.13)
"""Rays and step of the misfit on the grid: a quarter of the work."""
FINE = (64, 0.055)
"""Those of the last climb, on the light pass's own texels."""
GRID = 20
"""Lights of the grid across the picture's width."""
MARGIN = 0.15
"""How far the grid goes beyond the picture, as a share of its size."""
GRID_NUMBERS = ((2.0, 0.8, 0.05), (5.0, 0.8, 0.05), (3.0, 0.8, 0.12))
"""Attenuation, density and radius at each of the lights."""
STARTS = 6
"""Lights of the grid from which the numbers are solved for."""
APART = 0.04
"""Distance of two of them, in widths, at least."""
KEPT = 3
"""The best of them, which are solved for once more on finer rays."""
FIRST_DAMPING, MOST_DAMPING = 0.1, 1e4
"""Damping of the first step, and that from which a candidate is left where it is."""
LEAST_CURVATURE = 1e-3
"""Curvature that damping adds to, in scaled numbers: that of the terms of the light's size."""
LONGEST_STEP = 3.0
"""Longest step, in scales: nearly linear changes."""
SMALL_GAIN = 5e-5
"""Gain in cost of a step from which two of them are the last."""
FIRST_BRIGHT = 2.0
"""Brightness of the first lights, in that of the brightest pixel: most discs are clipped."""
WIDEST = 0.2
"""Radius of the widest disc that a search begins with, in widths."""
GRID_ROUNDS = 3
"""Rounds along each ray on the grid."""
FIRST_SWEEPS, SWEEPS = 8, 3
"""Sweeps along each ray from nothing, and from where the last candidate's solution is."""


class Ranges(NamedTuple):
    """(8,) lower and upper ends of a candidate's numbers, in scales, and which of them move."""

    lower: np.ndarray
    upper: np.ndarray
    free: np.ndarray

    @staticmethod
    def of(image: np.ndarray, samples: int, own_pixel: bool) -> Ranges:
        """The ranges in a light pass (h, w) of a shader with so many ``samples``: no light is
        fainter than what is brightest."""
        lower, upper, free = LOWEST.copy(), HIGHEST.copy(), np.ones(8, bool)
        lower[4], upper[4] = np.array(OWN) / samples if own_pixel else (0.0, 0.0)
        lower[6] = np.log(max(image.max(), 1.0))
        free[4] = own_pixel
        return Ranges(lower / SCALES, upper / SCALES, free)

    @property
    def middle_own(self) -> float:
        """The own pixel's weight in the middle of its range."""
        return float(np.sqrt(self.lower[4] * self.upper[4]) * SCALES[4])

    def holding(self, index: int) -> Ranges:
        """The same with one more number that stays."""
        free = self.free.copy()
        free[index] = False
        return self._replace(free=free)

    def packed(self, at: Candidate) -> np.ndarray:
        z = np.array([*at[:6], np.log(at.bright), np.log(at.radius)]) / SCALES
        return np.clip(z, self.lower, self.upper)


class Place(NamedTuple):
    """A candidate and its cost."""

    at: Candidate
    cost: float


def _unpacked(z: np.ndarray) -> Candidate:
    z = z * SCALES
    return Candidate(*z[:6].tolist(), bright=float(np.exp(z[6])), radius=float(np.exp(z[7])))


def climb(misfit: RayMisfit, start: Candidate, ranges: Ranges, steps: int) -> Place:
    """The candidate that so many Levenberg-Marquardt ``steps`` lead to, at most, from ``start``.
    What is known of x is kept from step to step."""
    x = np.full((misfit.rays, len(misfit.radii)), start.dim)
    z, damping = ranges.packed(start), FIRST_DAMPING
    here = misfit(_unpacked(z), x, FIRST_SWEEPS)
    small = 0
    for _ in range(steps):
        assert here.slope is not None
        assert here.curvature is not None
        slope, bend = here.slope * SCALES, here.curvature * np.outer(SCALES, SCALES)
        # A number at its bound that would leave its range stays.
        stuck = ((z <= ranges.lower) & (slope > 0)) | ((z >= ranges.upper) & (slope < 0))
        move = ranges.free & ~stuck
        some = np.ix_(move, move)
        steep = bend[some] + damping * np.diag(np.diag(bend)[move] + LEAST_CURVATURE)
        step = np.zeros(8)
        step[move] = -np.linalg.solve(steep, slope[move])
        step /= max(1.0, np.abs(step).max() / LONGEST_STEP)
        there = np.clip(z + step, ranges.lower, ranges.upper)
        y = x.copy()
        next_ = misfit(_unpacked(there), y, SWEEPS)
        if next_.cost < here.cost:
            small = small + 1 if here.cost - next_.cost < SMALL_GAIN else 0
            z, x, here, damping = there, y, next_, damping / 3
            if small == 2:
                break
        else:
            damping *= 4
            if damping > MOST_DAMPING:
                break
    return Place(_unpacked(z), here.cost)


def grid_lights(size: tuple[int, int], near: tuple[float, float] | None) -> np.ndarray:
    """(n, 2) lights that are tried: over the picture and a margin, or about ``near``."""
    if near is not None:
        steps = np.linspace(-0.04, 0.04, 5)
        return np.array([(near[0] + a, near[1] + b) for a in steps for b in steps])
    h, w = size
    across = np.linspace(-MARGIN, 1 + MARGIN, GRID)
    rows = max(4, round(GRID * h / w))
    up = np.linspace(-MARGIN, 1 + MARGIN, rows)
    return np.array([(a, b) for a in across for b in up])


def first_places(misfit: RayMisfit, lights: np.ndarray, ranges: Ranges) -> list[Place]:
    """The best of a few numbers at each of ``lights`` (n, 2), best first."""
    dim = float(np.median(misfit.image[misfit.known > 0]))
    bright = float(FIRST_BRIGHT * np.exp(ranges.lower[6] * SCALES[6]))
    own = ranges.middle_own

    def best(light: np.ndarray) -> Place:
        x, places = np.empty((misfit.rays, len(misfit.radii))), []
        for kappa, rho, radius in GRID_NUMBERS:
            u, v = map(float, light)
            at = Candidate(u, v, kappa, rho, own, dim, bright, radius)
            x[:] = dim
            places.append(Place(at, misfit(at, x, GRID_ROUNDS, False).cost))
        return min(places, key=_cost)

    return sorted(parallel_map(best, lights), key=_cost)


def apart(places: list[Place], count: int, aspect: float) -> list[Place]:
    kept = []
    for place in places:
        gaps = [np.hypot(place.at.u - o.at.u, (place.at.v - o.at.v) * aspect) for o in kept]
        if all(g > APART for g in gaps) and len(kept) < count:
            kept.append(place)
    return kept


SHRINK = 0.85
"""Factor of the radius from one climb to the next: two bins."""
WORSE = 0.02
"""Rise of the cost over the least one from which smaller radii are not tried."""


def squeezed(misfit: RayMisfit, start: Candidate, ranges: Ranges, steps: int) -> Place:
    """The candidate of least cost as the light's disc is made smaller and smaller, the numbers
    following. A smaller disc than the true one explains nothing: there the cost has a wall, along
    which no descent finds its way, and which a residual beyond it pushes a candidate off."""
    ranges, smallest = ranges.holding(7), np.exp(LOWEST[7])
    best = here = climb(misfit, start, ranges, steps)
    rises = 0
    while here.at.radius * SHRINK > smallest:
        here = climb(misfit, here.at._replace(radius=here.at.radius * SHRINK), ranges, steps)
        if here.cost < best.cost:
            best, rises = here, 0
        else:
            rises += 1
        if here.cost > best.cost + WORSE and rises > 1:
            break
    return best


def search(
    copy: View,
    texels: View,
    ranges: Ranges,
    near: tuple[float, float] | None,
    begun: Sequence[Candidate] = (),
) -> list[Place]:
    """Places, best first: those of a small ``copy`` of the light pass, solved for on finer and
    finer rays, at last on its ``texels``. With ``near`` (u, v) lights about there alone. Places
    that are known to be good are ``begun`` from on the finest rays too."""
    (h, w), aspect = copy.image.shape, copy.image.shape[0] / copy.image.shape[1]
    coarse, middle = RayMisfit(*copy, *COARSE), RayMisfit(*copy)
    fine = RayMisfit(*texels, *FINE)
    grid = first_places(coarse, grid_lights((h, w), near), ranges)
    starts = apart(grid, STARTS, aspect)

    def ended(misfit: RayMisfit, grown: float, steps: int):
        def work(place: Place) -> Place:
            at = place.at._replace(radius=min(grown * place.at.radius, WIDEST))
            return squeezed(misfit, at, ranges, steps)

        return work

    found = parallel_map(ended(coarse, 3.0, 5), starts)
    found = apart(sorted(found, key=_cost), KEPT, aspect)
    found = parallel_map(ended(middle, 1.6, 5), found)
    found += [Place(at, 0.0) for at in begun]
    return sorted(parallel_map(ended(fine, 1.3, 6), found), key=_cost)


def _cost(place: Place) -> float:
    return place.cost

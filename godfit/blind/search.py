"""The search for a light under one hypothesis: five numbers, a global optimiser, one cost.

The cost has many minima, and none of them is found by its slope: a grid of lights, then
differential evolution from the best of them (Storn & Price, J. Global Optim. 11 (1997), 341), then
Nelder and Mead's simplex on more pairs. Nothing else starts a search.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import differential_evolution, minimize

from godfit.blind.hypotheses import Hypothesis
from godfit.blind.pairs import Pairs, costs, drawn
from godfit.runtime.interrupts import requested

GRID_U, GRID_V = 25, 15
"""Lights of the grid along the picture's width and height."""
OUTSIDE = (-0.35, -0.13)
"""Lights of the grid off the picture, as shares of it; as many beyond the other side."""
GRID_NUMBERS = ((3.0, 0.85, 0.03), (3.0, 0.85, 0.1))
"""Attenuation, density and radius of the grid's lights: the middle of what shaders ship."""
LOWEST = (-0.5, -0.5, 0.0, 0.4, 0.015)
"""Lower ends of the search: light u and v (see ``place_of``), attenuation for each unit of ray,
density, and radius as a share of the longer side. A shorter ray explains any picture by itself."""
HIGHEST = (1.5, 1.5, 9.0, 1.2, 0.35)
"""Upper ends: of real shaders 8.8 is the steepest; a steeper ray is a short one."""
BEYOND = 1.7
"""How fast places off the picture recede: at the end of the search a light is three pictures off,
where rays are nearly parallel."""
COARSE_PAIRS, PAIRS = 600, 2000
"""Pairs of the grid and of the evolution."""
FINE_PAIRS = 6000
"""Pairs of the simplex: the light is then known to a tenth of a pixel of the copy."""
NEAR_PAIRS, NEAR_TURNS = 3000, 2
"""Pairs about the light that was found, and how often they are drawn about where they led."""
POPULATION, FOLLOWED = 40, 8
"""Members of the evolution, and lights of the grid that they start around."""
GENERATIONS = 30
"""Generations of the evolution, at most: later ones change the light by less than the simplex."""
SPREADS = (0.02, 0.03, 1.0, 0.12, 0.5)
"""Standard deviations of the members about these lights; of the radius, of its logarithm."""
APART = 0.05
"""Least distance of two lights that are followed, as a share of the picture."""
NEAR = 0.06
"""Half the side of the square about a place that the user gives: twice the 3% of a click."""
SIMPLEX_STEPS = 160
"""Evaluations of the simplex, at most."""


class Candidate(NamedTuple):
    """Where a search ended: ``point`` (5,) in its own numbers, the light's ``place`` (u, v),
    ``kappa`` along the ray, ``density``, ``radius`` as a share of the longer side, and the
    ``cost`` per pair."""

    hypothesis: Hypothesis
    point: np.ndarray
    cost: float

    @property
    def place(self) -> tuple[float, float]:
        return float(place_of(self.point[0])), float(place_of(self.point[1]))

    @property
    def kappa(self) -> float:
        return float(self.point[2] * self.point[3])

    @property
    def density(self) -> float:
        return float(self.point[3])

    @property
    def radius(self) -> float:
        return float(np.exp(self.point[4]))


def place_of(number: np.ndarray | float) -> np.ndarray:
    """The texture coordinate of a number of the search: itself on the picture, and off it farther
    and farther away."""
    number = np.asarray(number, float)
    beyond = np.maximum(number - 1, 0) - np.maximum(-number, 0)
    return np.asarray(np.clip(number, 0, 1) + beyond / (1 - BEYOND * np.abs(beyond)))


def number_of(place: float) -> float:
    """The inverse of ``place_of``."""
    beyond = max(place - 1, 0) - max(-place, 0)
    return min(max(place, 0), 1) + beyond / (1 + BEYOND * abs(beyond))


def in_pixels(points: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    """(m, 5) points of the search in the kernel's numbers, on a copy of ``size``."""
    h, w = size
    out = np.atleast_2d(points).copy()
    out[:, 0] = place_of(out[:, 0]) * w
    out[:, 1] = (1 - place_of(out[:, 1])) * h
    out[:, 2] *= out[:, 3]
    out[:, 4] = np.exp(out[:, 4]) * max(h, w)
    return out


def ends(near: tuple[float, float] | None) -> tuple[np.ndarray, np.ndarray]:
    """(5,) lower and upper ends of the search, about the place ``near`` if there is one."""
    lower, upper = np.array(LOWEST), np.array(HIGHEST)
    lower[4], upper[4] = math.log(lower[4]), math.log(upper[4])
    if near is not None:
        for axis in range(2):
            lower[axis] = number_of(near[axis] - NEAR)
            upper[axis] = number_of(near[axis] + NEAR)
    return lower, upper


def searched(hypothesis: Hypothesis, near: tuple[float, float] | None, seed: int) -> Candidate:
    """The best light under a hypothesis, deterministic for a seed."""
    size = hypothesis.values.shape
    lower, upper = ends(near)
    coarse, pairs = drawn(hypothesis, COARSE_PAIRS, seed + 1), drawn(hypothesis, PAIRS, seed)
    grid = _grid(lower, upper)
    order = np.argsort(costs(in_pixels(grid, size), coarse, hypothesis))
    begun = _population(grid[order], lower, upper, seed)

    def cost(points):
        return costs(in_pixels(points.T, size), pairs, hypothesis)

    found = differential_evolution(
        cost, list(zip(lower, upper, strict=True)), vectorized=True, updating="deferred",
        init=begun,  # pyright: ignore[reportArgumentType]
        maxiter=GENERATIONS, tol=1e-4, rng=seed, polish=False, mutation=(0.5, 0.9),
        recombination=0.8, callback=lambda intermediate_result: requested(),
    )  # fmt: skip
    fine = drawn(hypothesis, FINE_PAIRS, seed + 2)
    best = climbed(Candidate(hypothesis, found.x, 0.0), fine, (lower, upper))
    return _refined(best, (lower, upper), seed) if hypothesis.windowed.all() else best


def _refined(candidate: Candidate, between: tuple[np.ndarray, np.ndarray], seed: int) -> Candidate:
    """The same minimum on pairs about its light, at the cost on pairs of the whole picture.

    Without a veil all light comes from within the radius, and its rays fade within a few radii.
    """
    point = candidate.point
    for turn in range(NEAR_TURNS):
        here = candidate._replace(point=point)
        pairs = drawn(candidate.hypothesis, NEAR_PAIRS, seed + 3 + turn, here.place)
        point = climbed(here, pairs, between).point
    return candidate._replace(point=point)


def climbed(
    candidate: Candidate, pairs: Pairs, between: tuple[np.ndarray, np.ndarray], rounds: int = 1
) -> Candidate:
    """The nearest minimum on other ``pairs``, by the simplex of Nelder and Mead."""
    hypothesis, size = candidate.hypothesis, candidate.hypothesis.values.shape
    lower, upper = between

    def cost(point):
        inside = np.clip(point, lower, upper)
        outside = float(np.abs(point - inside).sum())
        return float(costs(in_pixels(inside, size), pairs, hypothesis)[0]) + outside

    point = candidate.point
    for _ in range(rounds):
        steps = np.array([0.004, 0.006, 0.3, 0.03, 0.1])
        simplex = np.vstack(
            [point, point + np.diag(np.where(point + steps < upper, steps, -steps))]
        )
        found = minimize(
            cost, point, method="Nelder-Mead",
            options={"initial_simplex": simplex, "maxfev": SIMPLEX_STEPS, "fatol": 1e-6,
                     "xatol": 1e-5},
        )  # fmt: skip
        point = np.clip(found.x, lower, upper)
    return Candidate(hypothesis, point, float(found.fun))


def _grid(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """(m, 5) points: lights on the picture and off it, or between the ends of a narrower search."""
    u, v = ([*OUTSIDE, *np.linspace(0, 1, n), *(1 - np.array(OUTSIDE))] for n in (GRID_U, GRID_V))
    if upper[0] - lower[0] < 1:
        u, v = (np.linspace(lower[i], upper[i], 9) for i in range(2))
    lights = np.stack([z.ravel() for z in np.meshgrid(u, v)], -1)
    numbers = [(kappa, density, math.log(radius)) for kappa, density, radius in GRID_NUMBERS]
    points = np.concatenate([np.insert(lights, [2] * 3, more, axis=1) for more in numbers])
    return np.clip(points, lower, upper)


def _population(ranked: np.ndarray, lower: np.ndarray, upper: np.ndarray, seed: int) -> np.ndarray:
    """(members, 5) around the best points that lie apart."""
    kept: list[np.ndarray] = []
    for point in ranked:
        if all(np.abs(point[:2] - other[:2]).max() > APART for other in kept):
            kept.append(point)
        if len(kept) == FOLLOWED:
            break
    rng = np.random.default_rng(seed)
    members = [kept[i % len(kept)].copy() for i in range(POPULATION)]
    for i in range(len(kept), POPULATION):
        members[i] += rng.normal(0, SPREADS)
    return np.clip(members, lower, upper)

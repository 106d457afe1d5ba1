"""Beginnings: what the screening found as a model's coordinates, with the background that suits
them, and solved from there."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np

from godfit.inference.evaluate import predicted
from godfit.inference.likelihood import log_likelihood
from godfit.inference.observation import Observation
from godfit.inference.problem import Problem
from godfit.inference.solver import Point, solve
from godfit.io.filters import over_channels
from godfit.io.image import LEVELS
from godfit.models.background import terms
from godfit.models.bare_picture import AbstractBarePicture
from godfit.models.coordinates import FIRST_BACKGROUND
from godfit.models.disc_light import DiscLight
from godfit.runtime.parallel import parallel_map
from godfit.runtime.program_cache import cached_jit

# Brightness of the veils that a start is tried under, besides its own.
VEILS = (None, 0.05)
# Noise in levels that the first steps allow for, and the points that go on for more of them.
COARSE, AGAIN = 8.0, 4


def likeliest(
    begun: list[dict[str, float]], held: np.ndarray, model: DiscLight, seen: Observation
) -> list[dict[str, float]]:
    """The best of starts as they are, for every light; ``held`` (p,) is NaN where free."""

    def off(start: dict[str, float]) -> float:
        z = with_background(coordinates_of(start, model), held, model, seen)
        levels = predicted(z, held, model, seen)
        sigma = np.float32(COARSE)
        return -float(log_likelihood(levels, seen.lo, seen.hi, sigma, seen.foreign).sum())

    best: dict[tuple[float, float], dict[str, float]] = {}
    for start in sorted(begun, key=off):
        best.setdefault((start["light_x"], start["light_y"]), start)
    return list(best.values())


def rough(begun: list[dict[str, float]], problem: Problem, seen: Observation) -> list[Point]:
    """Solved for what is ``free`` (p,), ``held`` (p,) where not NaN, from every start under every
    veil, cheapest first."""
    model, held = problem.model, problem.held
    assert isinstance(model, DiscLight)

    def from_start(begin: tuple[dict[str, float], float | None]) -> Point:
        start, veil = begin
        z = with_background(coordinates_of(start | _veiled(start, veil), model), held, model, seen)
        # Wide first: what is far off must not pass for foreign.
        z = solve(z, problem, seen, 4 * COARSE).coordinates
        return solve(z, problem, seen, COARSE)

    def further(point: Point) -> Point:
        return solve(point.coordinates, problem, seen, COARSE)

    points = parallel_map(from_start, itertools.product(begun, VEILS))
    points.sort(key=lambda p: p.cost)
    points = [*parallel_map(further, points[:AGAIN]), *points[AGAIN:]]
    return sorted(points, key=lambda p: p.cost)


def _veiled(start: Mapping[str, float], veil: float | None) -> dict[str, float]:
    """A start's gains as they would be under a veil of this brightness."""
    if veil is None:
        return {}
    gain = max(start["veil_gain"] / veil, 0.3 * start["gain"])
    return {"gain": gain * (1 - veil), "veil_gain": gain * veil}


def coordinates_of(start: Mapping[str, float], model: AbstractBarePicture) -> np.ndarray:
    """Coordinates of what the screening found; the background is left out."""
    unit = model.convention.gain * float(np.asarray(model.colour).mean())
    disc, veil = (start[name] / unit for name in ("gain", "veil_gain"))
    both = max(disc + veil, 1e-2)
    veil = float(np.clip(veil, 0.003 * both, 0.5 * both))
    weight = model.shading.defaults.get("weight", 0.8)
    exposure = both * start["density"] / (model.samples * weight)
    place = start["light_x"], start["light_y"]
    first = [exposure, start["kappa"], start["density"], both - veil, *place]
    rest = [*np.zeros(model.background.size), *np.asarray(model.tint)]
    return np.array([*first, start["radius"], 0.004, veil, *rest], np.float32)


def with_background(
    z: np.ndarray, held: np.ndarray, model: AbstractBarePicture, seen: Observation
) -> np.ndarray:
    """Coordinates with the background that suits the rest of them best, by least squares."""
    light = np.asarray(_light(z, held, model, seen))
    k, c = model.background.shape
    lo, hi = (np.asarray(b).reshape(-1, c) for b in (seen.lo, seen.hi))
    known = over_channels(np.logical_and, np.isfinite(hi))
    if not known.any():
        return z
    basis = terms(np.asarray(seen.pixels), seen.size, k)[known]
    goal = ((np.maximum(lo, 0) + hi) / 2)[known] / LEVELS
    goal = goal - light[known, None] * np.asarray(model.colour)
    found = np.linalg.lstsq(basis, goal, rcond=None)[0]
    # Once more without the tenth that is farthest off.
    off = np.abs(goal - basis @ found).max(1)
    close = off <= np.quantile(off, 0.9)
    found = np.linalg.lstsq(basis[close], goal[close], rcond=None)[0]
    z = z.copy()
    z[FIRST_BACKGROUND : FIRST_BACKGROUND + found.size] = found.reshape(-1)
    return z.astype(np.float32)


@cached_jit
def _light(z, held, model: AbstractBarePicture, seen: Observation):
    at = model.moved(z, held)
    return at.light_pass(seen.mask, size=seen.size, pixels=seen.pixels)

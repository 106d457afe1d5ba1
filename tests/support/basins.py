"""Whether the climb alone, without any screening, arrives from a start that is far from the truth.

The light begins away from its own place by up to half a frame, attenuation and density away from
their own values. The light is found to within .002, decay to .001 and density to .005.
"""

from __future__ import annotations

import jax
import numpy as np

from godfit import FitResult
from godfit import fit as whole_fit
from godfit.inference.problem import SEARCH_PIXELS
from godfit.inference.settle import settle
from godfit.search import beyond_light, multigrid
from tests.support import random_targets
from tests.support.stability_judges import SAMPLES, TRUTH, light_pass, mask_of

REACH = 0.5
# What attenuation (kappa, by which light falls off along a ray) is multiplied by, and what is added
# to density.
FACTORS, DENSITIES = (0.25, 4.0), (-0.4, 0.2)
FOUND = {"light": 2e-3, "decay": 1e-3, "density": 5e-3}


def arrives(result: FitResult, start: np.ndarray) -> bool:
    """Whether the climb from coordinates ``start`` ends at the truth."""
    # Densities up to 1, as a search begins.
    problem = beyond_light.up_to_light(result.problem, {})
    with jax.enable_x64(False):
        point = multigrid.climb(problem.small, [start.astype(np.float32)], lambda _: None)
        settled, _ = settle(point.coordinates, problem, problem.observe(SEARCH_PIXELS))
        values = {k: float(v) for k, v in problem.at(settled.coordinates).values().items()}
    light = np.hypot(values["light_x"] - TRUTH["light_x"], values["light_y"] - TRUTH["light_y"])
    return bool(
        light < FOUND["light"]
        and abs(values["decay"] - TRUTH["decay"]) < FOUND["decay"]
        and abs(values["density"] - TRUTH["density"]) < FOUND["density"]
    )


def maps(kind: str, size: int, grid: int) -> tuple[np.ndarray, np.ndarray]:
    """(grid, grid) whether starts arrive: light across and down, attenuation and density."""
    mask = mask_of(size, kind)
    linear = light_pass(mask)
    target = random_targets.to_bytes(linear * (0.9 / np.quantile(linear, 0.98)))
    result = whole_fit(target, mask=mask, shader="dawntime", samples=SAMPLES)
    home = np.asarray(result.model.coordinates(), np.float64)
    light, other = np.zeros((grid, grid), bool), np.zeros((grid, grid), bool)
    offsets = np.linspace(-REACH, REACH, grid)
    factors = np.geomspace(*FACTORS, grid)
    densities = np.linspace(*DENSITIES, grid)
    for i in range(grid):
        for j in range(grid):
            start = home.copy()
            start[4:6] += offsets[j], -offsets[i]
            light[i, j] = arrives(result, start)
            start = home.copy()
            start[1:3] = home[1] * factors[i], home[2] + densities[j]
            other[i, j] = arrives(result, start)
    return light, other


def reach(light: np.ndarray) -> float:
    """The largest distance within which nine starts in ten arrive, in shares of the frame."""
    offsets = np.linspace(-REACH, REACH, len(light))
    away = np.hypot(offsets[:, None], offsets[None]).ravel()
    good = [d for d in np.unique(away) if light.ravel()[away <= d].mean() >= 0.9]
    return float(max(good, default=0.0))

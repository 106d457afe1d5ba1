"""How long ways to render the light in the plane take, and how wrong each is.

The canvases are those of data_synthetic, at the size asked for. Errors are rms over all pixels, as
a share of the rms of the reference: the distance march of 1,024 rays in float64, which is exact but
for the rays. Times are medians of warm runs in float32, the ways in turn.
"""

from __future__ import annotations

import functools
import statistics

import jax
import numpy as np

from godfit.flatland import Sky, from_rgba, render
from tests.support.synthetic import canvases
from tests.support.timing import timed

REFERENCE_RAYS = 1024
SKY = (140.0, 40.0, (0.95, 0.95, 0.9), (0.1, 0.16, 0.3))


def scenes(size: int) -> dict[str, np.ndarray]:
    """(size, size, 4) bytes by name."""
    cells = canvases.sand_frames(2, 20, size // 4)[1]
    return {
        "stroke": canvases.stroke(size, size),
        "window": canvases.window(size, size),
        "maze": canvases.maze(size, max(size // 16, 2)),
        "sand": canvases.sand_canvas(cells, 4),
    }


def reference(values: np.ndarray, rays: int = REFERENCE_RAYS) -> np.ndarray:
    with jax.enable_x64(True):
        return np.asarray(
            jax.jit(functools.partial(render, rays=rays))(from_rgba(values), Sky(*SKY))
        )


def rms(found, exact) -> float:
    return float(np.sqrt(np.mean((np.asarray(found) - exact) ** 2) / np.mean(exact**2)))


def measured(values: np.ndarray, ways: dict[str, dict], repeats: int, exact) -> dict[str, tuple]:
    """{way: (seconds, error)}"""
    made, sky = from_rgba(values), Sky(*SKY)
    programs = {
        name: functools.partial(jax.jit(functools.partial(render, **options)), made, sky)
        for name, options in ways.items()
    }
    errors = {name: rms(program(), exact) for name, program in programs.items()}
    seconds: dict[str, list[float]] = {name: [] for name in programs}
    for _ in range(repeats):
        for name, program in programs.items():
            seconds[name].append(timed(program))
    return {name: (statistics.median(seconds[name]), errors[name]) for name in programs}


def shapes(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """One of ten canvases for the flood and the gradients: discs and bars, square and not."""
    rng = np.random.default_rng(seed)
    h, w = ((200, 200), (150, 260), (280, 120))[seed % 3]
    y, x = np.mgrid[:h, :w]
    opacity = np.zeros((h, w))
    radiance = np.zeros((h, w, 3))
    for _ in range(6):
        at = np.hypot(y - rng.uniform(0, h), x - rng.uniform(0, w)) < rng.uniform(3, 20)
        opacity[at] = 1
        radiance[at] = rng.uniform(0, 1, 3) * (rng.random() < 0.5)
    for _ in range(2):
        row, column = rng.integers(0, h - 4), rng.integers(0, w // 2)
        opacity[row : row + 3, column : column + w // 3] = 1
        radiance[row : row + 3, column : column + w // 3] = 0
    return radiance, opacity

"""What the machine can do, and where the methods of the sum stand against it.

The sum is that of 512x512 pixels and 150 samples, dawntime's. Each tap is at least an interpolation
along the columns (3 operations) of a share 1 - t of the rows, then one along the rows that is added
up (2 multiplications, 2 additions), where nothing is flat.
"""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numba
import numpy as np

from godfit import Mitchell
from godfit.scattering.radial import METHODS
from tests.support import random_targets

SIZE, SAMPLES = 512, 150
DENSITY, LIGHT = 0.85, (0.56, 0.6)
TAPS = SAMPLES - 1
# The mean of 1 - t over the taps.
LEFT = 1 - DENSITY * SAMPLES / 2 / SAMPLES
OPERATIONS = TAPS * SIZE**2 * (4 + 3 * LEFT)
# Bytes that a tap reads for each pixel: of the mask, or of strips of it.
READS = {"strips": 8 + 8 * LEFT}
EXACT = 1e-5


def cores() -> list[int]:
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def shares(places: list[int], count: int) -> list[list[int]]:
    """``places`` for each of ``count`` processes; with more processes than places, in turn."""
    return [places[i::count] or [places[i % len(places)]] for i in range(count)]


@numba.njit(parallel=True, cache=True)
def copy(source, target, times):
    """Each thread copies its own part, ``times`` over."""
    for part in numba.prange(source.shape[0]):
        for _ in range(times):
            for i in range(source.shape[1]):
                target[part, i] = source[part, i]


@numba.njit(parallel=True, fastmath=True, cache=True)
def multiply_add(values, times):
    """``times`` multiplications and additions of each of values (parts, 64), float32: enough of
    them side by side to hide how long each takes."""
    a, b = np.float32(0.999), np.float32(0.001)
    for part in numba.prange(values.shape[0]):
        row = values[part].copy()
        for _ in range(times):
            for i in range(64):
                row[i] = a * row[i] + b
        values[part] = row


def seconds(function: Callable[[], object], repeats: int = 7) -> float:
    """Median of a warm function."""
    jax.block_until_ready(function())
    found = []
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(function())
        found.append(time.perf_counter() - began)
    return statistics.median(found)


def bandwidth(numbers: int, times: int) -> float:
    """Bytes a second, read and written, of copies of ``numbers`` float32 by every core."""
    parts = len(cores())
    source = np.ones((parts, numbers // parts), np.float32)
    target = np.empty_like(source)
    return 2 * source.nbytes * times / seconds(lambda: copy(source, target, times))


def arithmetic() -> float:
    """Multiplications and additions of float32 a second, every core."""
    values, times = np.ones((16 * len(cores()), 64), np.float32), 100_000
    return 2 * values.size * times / seconds(lambda: multiply_add(values, times))


def hard_mask() -> np.ndarray:
    return random_targets.triangles(np.random.default_rng(5), SIZE, np.array(LIGHT))


def exact(mask: np.ndarray, size: int = 64) -> list[str]:
    """Names of the methods that give the reference's numbers, on a corner of ``mask``."""
    part = mask[:size, :size]
    truth = {"exposure": 0.02, "decay": 0.985, "density": DENSITY, "weight": 0.7}
    expected = random_targets.render64(
        part, truth | {"light_x": LIGHT[0], "light_y": LIGHT[1], "samples": SAMPLES}
    )
    model = Mitchell(**truth, light=LIGHT, shader="dawntime", samples=SAMPLES)

    def worst(method):
        found = model.light_pass(jnp.asarray(part, jnp.float32), method=method)
        return np.abs(np.asarray(found) - expected).max()

    return [method for method in METHODS if worst(method) < EXACT]


def sum_seconds(mask: np.ndarray, method: str) -> float:
    model = Mitchell(0.02, 0.985, DENSITY, 0.7, LIGHT, "dawntime", SAMPLES)
    values = jnp.asarray(mask, jnp.float32)
    forward = jax.jit(lambda z: model.moved(z).light_pass(values, method=method))
    point = model.coordinates()
    return seconds(lambda: forward(point))

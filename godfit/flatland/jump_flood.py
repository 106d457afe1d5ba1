"""The nearest seed of every pixel, and the distance to it: jump flooding.

Rong & Tan, "Jump Flooding in GPU with Applications to Voronoi Diagram and Distance Transform",
I3D 2006: in passes at offsets N/2, N/4, ..., 1 every pixel compares its seed with those of its
eight neighbours at that offset, and keeps the nearest. The work is h w log2(max(h, w)), whatever
the number of seeds. Large solid shapes defeat the shortest form, so two variants are joined: all
the passes are made twice (JFA², same paper), and one at offset 1 goes before them (1+JFA, in
"Variants of Jump Flooding Algorithm for Computing Discrete Voronoi Diagrams", ISVD 2007).

The result is always a seed and the true distance to it, but now and then not the nearest seed: a
distance may be too long, never too short. Over 60 canvases of three discs, 1+JFA alone had up to
1.1% of the pixels wrong by more than half a pixel, and one by five; the two together had none.
Nothing here has a derivative with respect to the seeds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int32

COLUMN_BITS = 16
"""A seed is stored as one integer, row * 2**16 + column: one array to pad and to gather from is
nearly twice as fast as two."""

MAX_SEED_SIDE = 2 ** (31 - COLUMN_BITS)
"""Rows and columns: the row has the other bits of an int32 but its sign."""

NO_SEED = -1
"""Stands for the seed of a pixel that has none."""


class Nearest(NamedTuple):
    """The nearest seed of every pixel: its row, its column and the distance to it. Without any
    seed they are -1, -1 and infinity."""

    row: Int32[Array, "h w"]
    column: Int32[Array, "h w"]
    distance: Float[Array, "h w"]


def jump_flood(
    seeds: Bool[Array, "h w"],
    spacing: tuple[float, float] = (1.0, 1.0),
) -> Nearest:
    """The nearest seed of every pixel and the distance to it, centre to centre.

    ``spacing`` is (height, width) of a pixel, two plain numbers, static under ``jit``; distances
    are in its unit. Raises ValueError for a spacing that is not positive and finite, and for more
    than 32768 rows or columns.
    """
    h, w = seeds.shape
    if not all(0 < s < math.inf for s in spacing):
        raise ValueError(f"spacing: expected two positive, finite numbers, got {spacing}")
    if max(h, w) > MAX_SEED_SIDE:
        raise ValueError(f"seeds: expected at most {MAX_SEED_SIDE} rows and columns, got {h} x {w}")
    rows = jnp.arange(h, dtype=jnp.int32)[:, None]
    columns = jnp.arange(w, dtype=jnp.int32)[None]
    # An array has a dtype of its own. Python's floats would make the distance weakly typed, and
    # every function that takes it would be compiled once more.
    height, width = jnp.array(spacing)

    def row_and_column(seed):
        return seed >> COLUMN_BITS, seed & (2**COLUMN_BITS - 1)

    def squared_distance(seed):
        row, column = row_and_column(seed)
        y, x = (row - rows) * height, (column - columns) * width
        return jnp.where(seed == NO_SEED, jnp.inf, y * y + x * x)

    passes = (max(h, w) - 1).bit_length()
    offsets = [1, *2 * [2**i for i in reversed(range(passes))]]
    # Beyond the border there is no seed. An offset longer than a side need only leave it, so the
    # border of a narrow canvas stays narrow.
    pad_y, pad_x = min(max(offsets), h), min(max(offsets), w)

    def flood(nearest, offset):
        padded = jnp.pad(nearest, ((pad_y, pad_y), (pad_x, pad_x)), constant_values=NO_SEED)
        dy, dx = jnp.minimum(offset, pad_y), jnp.minimum(offset, pad_x)
        best = squared_distance(nearest)
        for i, j in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)):
            seed = jax.lax.dynamic_slice(padded, (pad_y + i * dy, pad_x + j * dx), (h, w))
            distance = squared_distance(seed)
            nearest = jnp.where(distance < best, seed, nearest)
            best = jnp.minimum(distance, best)
        return nearest, None

    start = jnp.where(seeds, (rows << COLUMN_BITS) + columns, NO_SEED)
    # A scan rather than a Python loop: one pass is compiled instead of twenty, and it runs faster.
    nearest, _ = jax.lax.scan(flood, start, jnp.array(offsets, jnp.int32))
    row, column = (jnp.where(nearest == NO_SEED, NO_SEED, z) for z in row_and_column(nearest))
    return Nearest(row, column, jnp.sqrt(squared_distance(nearest)))

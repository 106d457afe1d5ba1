"""Distance to, and place of, the nearest seed: jump flooding.

Rong & Tan, "Jump Flooding in GPU with Applications to Voronoi Diagram and Distance Transform",
I3D 2006: in passes at offsets N/2, N/4, ..., 1 every pixel looks at its eight neighbours that far
off, and keeps the nearest of the seeds that they know. The work is h w log2(max(h, w)), whatever
the number of seeds. Large solid shapes defeat the shortest form, so two variants are joined: all
the passes are made twice (JFA², same paper), and one at offset 1 goes before them (1+JFA, in
"Variants of Jump Flooding Algorithm for Computing Discrete Voronoi Diagrams", ISVD 2007).

The answer is always a seed and the true distance to it, but now and then not the nearest seed: a
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

# A seed's place travels as one integer, row * 2**16 + column: one array to pad and to read is
# nearly twice as fast as two.
BITS = 16
LARGEST = 2 ** (31 - BITS)
NONE = -1


class Nearest(NamedTuple):
    """The nearest seed of every pixel. Without any seed: -1, -1 and infinity."""

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
    if max(h, w) > LARGEST:
        raise ValueError(f"seeds: expected at most {LARGEST} rows and columns, got {h} x {w}")
    rows = jnp.arange(h, dtype=jnp.int32)[:, None]
    columns = jnp.arange(w, dtype=jnp.int32)[None]
    # As an array, of a dtype of its own: Python's floats would leave a weakly typed distance, for
    # which every function that takes it compiles once more.
    height, width = jnp.array(spacing)

    def split(place):
        return place >> BITS, place & (2**BITS - 1)

    def squared(place):
        row, column = split(place)
        y, x = (row - rows) * height, (column - columns) * width
        return jnp.where(place == NONE, jnp.inf, y * y + x * x)

    passes = (max(h, w) - 1).bit_length()
    offsets = [1, *2 * [2**i for i in reversed(range(passes))]]
    # Beyond the border nobody knows a seed. An offset longer than a side need only leave it, so the
    # border of a narrow canvas stays narrow.
    pad_y, pad_x = min(max(offsets), h), min(max(offsets), w)

    def flood(nearest, offset):
        known = jnp.pad(nearest, ((pad_y, pad_y), (pad_x, pad_x)), constant_values=NONE)
        dy, dx = jnp.minimum(offset, pad_y), jnp.minimum(offset, pad_x)
        best = squared(nearest)
        for i, j in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)):
            place = jax.lax.dynamic_slice(known, (pad_y + i * dy, pad_x + j * dx), (h, w))
            distance = squared(place)
            nearest = jnp.where(distance < best, place, nearest)
            best = jnp.minimum(distance, best)
        return nearest, None

    start = jnp.where(seeds, (rows << BITS) + columns, NONE)
    # A scan, not a Python loop: one pass is compiled instead of twenty, and it runs faster too.
    nearest, _ = jax.lax.scan(flood, start, jnp.array(offsets, jnp.int32))
    row, column = (jnp.where(nearest == NONE, NONE, z) for z in split(nearest))
    return Nearest(row, column, jnp.sqrt(squared(nearest)))

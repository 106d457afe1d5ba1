"""Strips: exact, compiled by numba, for CPUs; the fastest exact method there.

Tap k of a picture is the mask scaled about the light by 1 - t_k, so bilinear interpolation is
separable. For a tile of the picture, the few mask rows that it needs are first resampled along the
columns into strips. Each row of the tile is then a mix of two neighbouring strips, without an
index. Tile and strips stay in the cache closest to the core. Most of a mask is flat: where all
texels that a tile reads have one value, the tap is that value times its weight.

At points that are not a picture, those that follow each other in a row form a tile of one row,
which costs two to four times as much per point. Other points are summed one by one, from four reads
each, which costs four to ten times as much.

Cost: taps x points, a share (1 - t_k) of them with a read. Error: rounding; positions are computed
in float64.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from godfit.runtime import xla_ffi
from godfit.scattering.radial.derivatives import RayParameters, geometric_sum
from godfit.scattering.radial.pairs import pair_sums
from godfit.scattering.radial.strip_sizes import FLAT_CELL, TILE_ROWS
from godfit.scattering.taps import Count, Taps

STRIP_CALLS = xla_ffi.declare(
    "godfit",
    {
        double: f"godfit.scattering.radial.strips_kernel:_sums_{real}"
        for double, real in ((False, "single"), (True, "double"))
    },
)
"""Names of the compiled functions in XLA, by whether they sum in double precision."""
MAX_STRIP_CALLS = 16
"""Most calls for one picture: XLA distributes the calls of a program over its threads only where
there are many, and runs a program of few steps in order."""
MIN_POINTS_PER_CALL = 1024
"""Fewest points that are worth a call of their own."""
MAX_TEXELS_PER_POINT = 32
"""Texels for each point up to which flat cells are computed: they cost a pass over all texels."""


def _chunks(size: int, unit: int, most: int) -> list[tuple[int, int]]:
    """(begin, length) of at most ``most`` chunks of ``size``, each a multiple of ``unit`` long but
    for the last."""
    length = unit * -(-size // (unit * most))
    return [(begin, min(length, size - begin)) for begin in range(0, size, length)]


def strip_sums(
    mask: Float[Array, "h w"],
    ray: RayParameters,
    count: Count,
    at: Float[Array, "2 points"] | None,
    slopes: bool,
) -> Float[Array, "sums points"]:
    """See ``godfit.scattering.radial.derivatives.Sums``."""
    h, w = mask.shape
    dtype = mask.dtype
    padded = _padded(mask)
    packed = jnp.stack([jnp.asarray(z, dtype) for z in ray])
    sums = 4 if slopes else 1

    use_flat = at is None or MAX_TEXELS_PER_POINT * at.shape[1] >= h * w
    flat = _flat_cells(padded) if use_flat else _no_flat_cells(padded)

    def call(rows, columns, points, begin):
        shape = jax.ShapeDtypeStruct((sums, rows, columns), dtype)
        setup = jnp.asarray([count, begin], jnp.int32)
        return _call(shape, padded, flat, points, packed, setup)

    if at is not None:
        chunks = _chunks(at.shape[1], MIN_POINTS_PER_CALL, MAX_STRIP_CALLS)
        parts = [call(1, size, at[:, begin : begin + size], 0) for begin, size in chunks]
        return jnp.concatenate(parts, -1)[:, 0]
    unit = min(TILE_ROWS, -(-h // MAX_STRIP_CALLS))
    chunks = _chunks(h, unit, MAX_STRIP_CALLS)
    parts = [call(size, w, jnp.zeros((2, 0), dtype), begin) for begin, size in chunks]
    return jnp.concatenate(parts, 1).reshape(sums, h * w)


def _call(shape, *arguments):
    name = STRIP_CALLS[shape.dtype == jnp.float64]
    return xla_ffi.call(name, shape, *arguments, ranks="22211")


def sums_of_rays(
    mask: Float[Array, "h w"],
    rays: Float[Array, "n 5"],
    counts: Int[Array, " n"],
    at: Float[Array, "2 points"],
) -> Float[Array, "n points"]:
    """S at points for each of n ``RayParameters`` with as many taps as ``counts`` says."""
    padded = _padded(mask)
    shape = jax.ShapeDtypeStruct((1, len(counts), at.shape[1]), mask.dtype)
    setup = jnp.stack([counts, jnp.zeros_like(counts)], -1).reshape(-1).astype(jnp.int32)
    # Flat cells pay only for points in a row.
    return _call(shape, padded, _no_flat_cells(padded), at, rays.reshape(-1), setup)[0]


def _padded(mask):
    """The mask with a border that repeats its edge, as the compiled sums expect it."""
    return jnp.pad(mask, ((1, 1), (1, 2)), mode="edge")


def _cells(padded):
    """Number of flat cells down and across a padded mask."""
    return -(-padded.shape[0] // FLAT_CELL), -(-padded.shape[1] // FLAT_CELL)


def _no_flat_cells(padded):
    """(rows, columns) of cells, none of which counts as flat: NaN everywhere."""
    return jnp.full(_cells(padded), jnp.nan, padded.dtype)


def _flat_cells(padded):
    """(rows, columns) of cells: the mask's value in cells where it has one, NaN elsewhere."""
    (h, w), (rows, columns) = padded.shape, _cells(padded)
    beyond = (0, rows * FLAT_CELL - h), (0, columns * FLAT_CELL - w)
    cells = jnp.pad(padded, beyond, mode="edge").reshape(rows, FLAT_CELL, columns, FLAT_CELL)
    low, high = cells.min((1, 3)), cells.max((1, 3))
    return jnp.where(low == high, low, jnp.nan)


def strips(
    mask: Float[Array, "h w"],
    light: Float[Array, "2"],
    taps: Taps,
    at: Float[Array, "*points 2"] | None,
) -> Float[Array, "*points"]:
    """See ``godfit.scattering.radial.radial_sum``; serves taps whose unit is the ray."""
    return geometric_sum(strip_sums, mask, light, taps, at, linear=pair_sums)

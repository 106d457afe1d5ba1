"""Strips: exact, compiled by numba, for CPUs; the fastest that is.

Tap k of a picture is the mask scaled about the light by 1 - t_k, so that bilinear reads are
separable: for a tile of the picture, the few mask rows that it needs are resampled along the
columns, and these strips are mixed two by two into the tile's rows, without an index. The tile and
its strips stay in the cache closest to the core. Most of a mask is flat: where all that a tile
reads of it has one value, the tap is that value times its weight.

Of points that are not a picture, those that follow each other in a row are a tile of one row, which
costs two to four times as much; others are summed one by one, from four reads each, which costs
four to ten times.

Cost: taps x points, a share (1 - t_k) of them with a read. Error: rounding; positions are worked
out in float64.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from godfit.scattering.radial.derivatives import Numbers, geometric
from godfit.scattering.radial.pairs import pair_sums
from godfit.scattering.radial.strips_kernel import CELL, HIGH, target
from godfit.scattering.taps import Count, Taps

# Calls for one picture: XLA shares them out among its threads, if they are many (it runs programs
# of few steps in their order).
CALLS = 16
# Points that are worth a call of their own; and texels for each that are worth asking which are
# flat.
ENOUGH, FLAT = 1024, 32


def _shares(size: int, unit: int, most: int) -> list[tuple[int, int]]:
    """(begin, length) of at most ``most`` parts of ``size``, each a multiple of ``unit`` long."""
    length = unit * -(-size // (unit * most))
    return [(begin, min(length, size - begin)) for begin in range(0, size, length)]


def strip_sums(
    mask: Float[Array, "h w"],
    numbers: Numbers,
    count: Count,
    at: Float[Array, "2 points"] | None,
    slopes: bool,
) -> Float[Array, "sums points"]:
    """See ``godfit.scattering.radial.derivatives.Sums``."""
    h, w = mask.shape
    dtype, double = mask.dtype, mask.dtype == jnp.float64
    padded = jnp.pad(mask, ((1, 1), (1, 2)), mode="edge")
    packed = jnp.stack([jnp.asarray(z, dtype) for z in numbers])
    sums = 4 if slopes else 1

    def call(kind, shape, *arguments):
        made = jax.ffi.ffi_call(
            target(kind, double), jax.ShapeDtypeStruct(shape, dtype), vmap_method="sequential"
        )
        return made(padded, flat, *arguments)

    worth = at is None or FLAT * at.shape[1] >= h * w
    flat = _flat_cells(padded) if worth else _none_flat(padded)
    if at is not None:
        shares = _shares(at.shape[1], ENOUGH, CALLS)
        one = jnp.asarray([count], jnp.int32)
        parts = [
            call("points", (sums, 1, size), at[:, begin : begin + size], packed, one)
            for begin, size in shares
        ]
        return jnp.concatenate(parts, -1)[:, 0]
    parts = [
        call("picture", (sums, size, w), packed, jnp.asarray([count, begin], jnp.int32))
        for begin, size in _shares(h, min(HIGH, -(-h // CALLS)), CALLS)
    ]
    return jnp.concatenate(parts, 1).reshape(sums, h * w)


def _cells(padded):
    return -(-padded.shape[0] // CELL), -(-padded.shape[1] // CELL)


def _none_flat(padded):
    """(rows/CELL, columns/CELL) nothing is known to have one value."""
    return jnp.full(_cells(padded), jnp.nan, padded.dtype)


def _flat_cells(padded):
    """(rows/CELL, columns/CELL) the mask's value in cells where it has one, NaN elsewhere."""
    (h, w), (rows, columns) = padded.shape, _cells(padded)
    spread = jnp.pad(padded, ((0, rows * CELL - h), (0, columns * CELL - w)), mode="edge")
    cells = spread.reshape(rows, CELL, columns, CELL)
    low, high = cells.min((1, 3)), cells.max((1, 3))
    return jnp.where(low == high, low, jnp.nan)


def strips(
    mask: Float[Array, "h w"],
    light: Float[Array, "2"],
    taps: Taps,
    at: Float[Array, "*points 2"] | None,
) -> Float[Array, "*points"]:
    """See ``godfit.scattering.radial.radial_sum``; serves taps whose unit is the ray."""
    return geometric(strip_sums, mask, light, taps, at, linear=pair_sums)

"""Pairs: exact, on every device, plain XLA.

Two neighbours of a row are stored in one complex number, so that a tap needs two reads and not
four. The slopes of the mask at the tap come from the same two reads.

Cost: taps x points x 2 reads, about three times that with the derivatives. Error: rounding.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Complex, Float, Int

from godfit.scattering.radial.coordinates import points
from godfit.scattering.radial.derivatives import RayParameters, geometric_sum
from godfit.scattering.taps import Taps

POINTS_PER_BLOCK = 1 << 18
"""Points that are computed together: enough to keep every core busy, and few enough that memory
does not grow with the image."""

Pair = Complex[Array, " points"]
ReadPairs = Callable[[Int[Array, " points"]], tuple[Pair, Pair]]
"""From the index j (w + 2) + i, into a mask with a border of one pixel that repeats the edge, to
two pairs of neighbours in a row: M[j, i] + i M[j, i+1] and M[j+1, i] + i M[j+1, i+1]. With the
border, reads outside give the edge's value and slope zero without a test."""


def _sums(read_pairs: ReadPairs, size, xy, ray: RayParameters, count, slopes):
    """(1 or 4, points) at columns and rows ``xy`` (2, points) of a mask of ``size`` (h, w)."""
    (h, w), (x, y) = size, xy
    light_x, light_y, ratio, step, lag = ray
    # Without the barrier XLA computes these loop invariants again for every tap.
    x, y, ray_x, ray_y = lax.optimization_barrier((x, y, light_x - x, light_y - y))
    k = jnp.arange(1, count + 1, dtype=x.dtype)
    weight = ratio ** (k - 1)
    weight_r = (k - 1) * ratio ** jnp.maximum(k - 2, 0)

    def read(place):
        column = jnp.clip(x + place * step * ray_x, -1, w - 1)
        row = jnp.clip(y + place * step * ray_y, -1, h - 1)
        i, j = jnp.floor(column), jnp.floor(row)
        index = (j.astype(jnp.int32) + 1) * (w + 2) + (i.astype(jnp.int32) + 1)
        top, bottom = read_pairs(index)
        return top, bottom - top, column - i, row - j

    def value(total, tap):
        place, c, _ = tap
        top, down, fx, fy = read(place)
        pair = top + fy * down
        return total + c * (pair.real + fx * (pair.imag - pair.real)), None

    def value_and_slopes(totals, tap):
        # Two complex totals, S + i G_x and S_r + i G_y: XLA fuses the reads into each total, so
        # that four real ones would read every texel four times.
        a, b = totals
        place, c, c_r = tap
        top, down, fx, fy = read(place)
        pair = top + fy * down
        slope_x = pair.imag - pair.real
        slope_y = down.real + fx * (down.imag - down.real)
        v = pair.real + fx * slope_x
        return (
            a + lax.complex(c * v, place * c * slope_x),
            b + lax.complex(c_r * v, place * c * slope_y),
        ), None

    taps = (k - lag, weight, weight_r)
    if not slopes:
        return lax.scan(value, jnp.zeros_like(x), taps)[0][None]
    zero = lax.complex(jnp.zeros_like(x), jnp.zeros_like(x))
    a, b = lax.scan(value_and_slopes, (zero, zero), taps)[0]
    return jnp.stack([a.real, b.real, a.imag, b.imag])


def gathered_sums(
    read_pairs: ReadPairs,
    mask: Float[Array, "h w"],
    ray: RayParameters,
    count: int,
    at: Float[Array, "2 points"] | None,
    slopes: bool,
) -> Float[Array, "sums points"]:
    """See ``godfit.scattering.radial.derivatives.Sums``; only the mask's size and type are used,
    and texels come from ``read_pairs``."""
    h, w = mask.shape
    x, y = (z.reshape(-1) for z in points(h, w, None, mask.dtype)) if at is None else at
    (number,) = x.shape
    if number <= POINTS_PER_BLOCK:
        return _sums(read_pairs, (h, w), (x, y), ray, count, slopes)
    blocks = -(-number // POINTS_PER_BLOCK)
    pad = (0, blocks * POINTS_PER_BLOCK - number)
    x_blocks, y_blocks = (jnp.pad(z, pad).reshape(blocks, POINTS_PER_BLOCK) for z in (x, y))

    def block(xy: tuple[jax.Array, jax.Array]) -> jax.Array:
        return _sums(read_pairs, (h, w), xy, ray, count, slopes)

    out = lax.map(block, (x_blocks, y_blocks))
    return jnp.moveaxis(out, 0, 1).reshape(out.shape[1], -1)[:, :number]


def pair_sums(
    mask: Float[Array, "h w"],
    ray: RayParameters,
    count: int,
    at: Float[Array, "2 points"] | None,
    slopes: bool,
) -> Float[Array, "sums points"]:
    """See ``godfit.scattering.radial.derivatives.Sums``; linear in the mask, and JAX can transpose
    it."""
    padded = jnp.pad(mask, ((1, 1), (1, 2)), mode="edge")
    pairs_of_row = lax.complex(padded[:, :-1], padded[:, 1:]).ravel()
    next_row = mask.shape[1] + 2

    def read(index):
        top = pairs_of_row.at[index].get(mode="promise_in_bounds")
        return top, pairs_of_row.at[index + next_row].get(mode="promise_in_bounds")

    return gathered_sums(read, mask, ray, count, at, slopes)


def pairs(
    mask: Float[Array, "h w"],
    light: Float[Array, "2"],
    taps: Taps,
    at: Float[Array, "*points 2"] | None,
) -> Float[Array, "*points"]:
    """See ``godfit.scattering.radial.radial_sum``; serves taps whose unit is the ray."""
    return geometric_sum(pair_sums, mask, light, taps, at)

"""Pairs: exact, on every device, plain XLA.

Two neighbours of a row are kept in one complex number, so that a tap needs two reads and not four,
and the two that it reads give its slope as well.

Cost: taps x points x 2 reads, about three times that with the derivatives. Error: rounding.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Complex, Float, Int

from godfit.scattering.radial.coordinates import points
from godfit.scattering.radial.derivatives import Numbers, geometric
from godfit.scattering.taps import Taps

# Points that are worked on together: large enough to keep every core busy, small enough that
# memory does not grow with the image.
BLOCK = 1 << 18

Pair = Complex[Array, " points"]
# Index j (w + 2) + i into a mask with a border of one pixel that repeats the edge (reads outside
# give the edge's value and slope zero without a test) -> two pairs of neighbours in a row,
# M[j, i] + i M[j, i+1] and M[j+1, i] + i M[j+1, i+1].
Read = Callable[[Int[Array, " points"]], tuple[Pair, Pair]]


def _sums(read_pairs: Read, h, w, x, y, numbers: Numbers, count, slopes):
    """(1 or 4, points) at columns ``x`` and rows ``y`` (points,), in mask pixels."""
    light_x, light_y, ratio, step, lag = numbers
    # Loop invariants are made once: without the barrier XLA works them out again for every tap.
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
        # Two complex totals, S + i G_x and S_r + i G_y: XLA fuses each with its reads, where four
        # real ones would read everything four times.
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
    read_pairs: Read,
    mask: Float[Array, "h w"],
    numbers: Numbers,
    count: int,
    at: Float[Array, "2 points"] | None,
    slopes: bool,
) -> Float[Array, "sums points"]:
    """See ``godfit.scattering.radial.derivatives.Sums``; of the mask only its size is used."""
    h, w = mask.shape
    x, y = (z.reshape(-1) for z in points(h, w, None, mask.dtype)) if at is None else at
    (size,) = x.shape
    if size <= BLOCK:
        return _sums(read_pairs, h, w, x, y, numbers, count, slopes)
    blocks = -(-size // BLOCK)
    pad = (0, blocks * BLOCK - size)
    shaped = [jnp.pad(z, pad).reshape(blocks, BLOCK) for z in (x, y)]

    def block(xy: tuple[jax.Array, jax.Array]) -> jax.Array:
        return _sums(read_pairs, h, w, *xy, numbers, count, slopes)

    out = lax.map(block, tuple(shaped))
    return jnp.moveaxis(out, 0, 1).reshape(out.shape[1], -1)[:, :size]


def pair_sums(
    mask: Float[Array, "h w"],
    numbers: Numbers,
    count: int,
    at: Float[Array, "2 points"] | None,
    slopes: bool,
) -> Float[Array, "sums points"]:
    """See ``godfit.scattering.radial.derivatives.Sums``. Linear in the mask, and JAX can transpose it."""
    padded = jnp.pad(mask, ((1, 1), (1, 2)), mode="edge")
    flat = lax.complex(padded[:, :-1], padded[:, 1:]).ravel()
    row = mask.shape[1] + 2

    def read(index):
        top = flat.at[index].get(mode="promise_in_bounds")
        return top, flat.at[index + row].get(mode="promise_in_bounds")

    return gathered_sums(read, mask, numbers, count, at, slopes)


def pairs(
    mask: Float[Array, "h w"],
    light: Float[Array, "2"],
    taps: Taps,
    at: Float[Array, "*points 2"] | None,
) -> Float[Array, "*points"]:
    """See ``godfit.scattering.radial.radial_sum``; serves taps whose unit is the ray."""
    return geometric(pair_sums, mask, light, taps, at)

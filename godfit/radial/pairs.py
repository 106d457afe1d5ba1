"""Pairs: exact, on every device, with value and all derivatives from four sums.

Two neighbours of a row are kept in one complex number, so that a tap needs two reads and not four,
and the two that it reads give its slope as well. Taps are geometric (``godfit.taps``), so with

    S   = sum r^(k-1) I_k             S_r = sum (k-1) r^(k-2) I_k
    G_x = sum k r^(k-1) dI_k/dx       G_y = sum k r^(k-1) dI_k/dy

where I_k = M(x + k step (l - x)), the sum is out = own M(x) + first S, and its derivatives by own,
first, ratio, step and the light are products of these four with numbers that do not depend on the
tap. No other derivative is worked out.

Cost: taps x points x 2 reads, about three times that with the derivatives. Error: rounding.
"""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Complex, Float

from godfit.radial.geometry import points, to_pixels
from godfit.radial.reference import bilinear
from godfit.taps import Taps

# Points that are worked on together: large enough to keep every core busy, small enough that
# memory does not grow with the image.
BLOCK = 1 << 18


def _pack(mask: Float[Array, "h w"]) -> Complex[Array, "h2 w2"]:
    """M[j, i] + i M[j, i+1], with a border of one pixel that repeats the edge: reads outside give
    the edge's value and slope zero without a test."""
    padded = jnp.pad(mask, ((1, 1), (1, 2)), mode="edge")
    return lax.complex(padded[:, :-1], padded[:, 1:])


def _sums(packed, x, y, light_x, light_y, ratio, step, count, slopes):
    """S, or (S, S_r, G_x, G_y), at columns ``x`` and rows ``y`` (points,), all in mask pixels."""
    h, w = packed.shape[0] - 2, packed.shape[1] - 2
    flat = packed.ravel()
    # Loop invariants are made once: without the barrier XLA works them out again for every tap.
    x, y, ray_x, ray_y = lax.optimization_barrier((x, y, light_x - x, light_y - y))
    k = jnp.arange(1, count + 1, dtype=x.dtype)
    weight = ratio ** (k - 1)
    weight_r = (k - 1) * ratio ** jnp.maximum(k - 2, 0)

    def read(k):
        column = jnp.clip(x + k * step * ray_x, -1, w - 1)
        row = jnp.clip(y + k * step * ray_y, -1, h - 1)
        i, j = jnp.floor(column), jnp.floor(row)
        index = (j.astype(jnp.int32) + 1) * (w + 2) + (i.astype(jnp.int32) + 1)
        top = flat.at[index].get(mode="promise_in_bounds")
        bottom = flat.at[index + (w + 2)].get(mode="promise_in_bounds")
        return top, bottom - top, column - i, row - j

    def value(total, tap):
        k, c, _ = tap
        top, down, fx, fy = read(k)
        pair = top + fy * down
        return total + c * (pair.real + fx * (pair.imag - pair.real)), None

    def value_and_slopes(totals, tap):
        # Two complex totals, S + i G_x and S_r + i G_y: XLA fuses each with its reads, where four
        # real ones would read everything four times.
        a, b = totals
        k, c, c_r = tap
        top, down, fx, fy = read(k)
        pair = top + fy * down
        slope_x = pair.imag - pair.real
        slope_y = down.real + fx * (down.imag - down.real)
        v = pair.real + fx * slope_x
        return (
            a + lax.complex(c * v, k * c * slope_x),
            b + lax.complex(c_r * v, k * c * slope_y),
        ), None

    taps = (k, weight, weight_r)
    if not slopes:
        return lax.scan(value, jnp.zeros_like(x), taps)[0]
    zero = jnp.zeros_like(x, dtype=packed.dtype)
    a, b = lax.scan(value_and_slopes, (zero, zero), taps)[0]
    return a.real, b.real, a.imag, b.imag


def _blocks(packed, x, y, *rest):
    """``_sums`` over blocks of points."""
    (count,) = x.shape
    if count <= BLOCK:
        return _sums(packed, x, y, *rest)
    blocks = -(-count // BLOCK)
    pad = (0, blocks * BLOCK - count)
    shaped = [jnp.pad(z, pad).reshape(blocks, BLOCK) for z in (x, y)]
    out = lax.map(lambda xy: _sums(packed, *xy, *rest), tuple(shaped))
    return jax.tree.map(lambda z: z.reshape(-1)[:count], out)


@functools.partial(jax.custom_jvp, nondiff_argnums=(7,))
def _pairs(mask, light, own, first, ratio, step, at, count):
    h, w = mask.shape
    x, y = (z.reshape(-1) for z in points(h, w, at, mask.dtype))
    light_x, light_y = to_pixels(light, h, w)
    s = _blocks(_pack(mask), x, y, light_x, light_y, ratio, step, count, False)
    return own * _own(mask, x, y, at) + first * s


def _own(mask, x, y, at):
    return mask.reshape(-1) if at is None else bilinear(mask, x, y)


@functools.partial(_pairs.defjvp, symbolic_zeros=True)
def _pairs_jvp(count, primals, tangents):
    mask, light, own, first, ratio, step, at = primals
    d_mask, d_light, d_own, d_first, d_ratio, d_step, d_at = tangents
    if at is not None and not _is_zero(d_at):
        raise ValueError(
            "radial_sum is not differentiable in `at` by method 'pairs'; use 'reference'"
        )
    h, w = mask.shape
    x, y = (z.reshape(-1) for z in points(h, w, at, mask.dtype))
    light_x, light_y = to_pixels(light, h, w)
    out_own = _own(mask, x, y, at)
    s, s_r, g_x, g_y = _blocks(_pack(mask), x, y, light_x, light_y, ratio, step, count, True)
    out = own * out_own + first * s
    d_out = jnp.zeros_like(out)
    if not _is_zero(d_own):
        d_out += d_own * out_own
    if not _is_zero(d_first):
        d_out += d_first * s
    if not _is_zero(d_ratio):
        d_out += d_ratio * (first * s_r)
    if not _is_zero(d_step):
        d_out += d_step * (first * (g_x * (light_x - x) + g_y * (light_y - y)))
    if not _is_zero(d_light):
        # v points up, rows down.
        scale = first * step
        d_out += d_light[0] * (scale * w * g_x) - d_light[1] * (scale * h * g_y)
    if not _is_zero(d_mask):
        d_out += _pairs(d_mask, light, own, first, ratio, step, at, count)
    return out, d_out


def _is_zero(tangent) -> bool:
    return isinstance(tangent, jax.custom_derivatives.SymbolicZero)


def pairs(
    mask: Float[Array, "h w"],
    light: Float[Array, "2"],
    taps: Taps,
    at: Float[Array, "*points 2"] | None,
) -> Float[Array, "*points"]:
    """See ``godfit.radial.radial_sum``; serves taps whose unit is the ray."""
    if taps.unit != "ray":
        raise ValueError("method 'pairs' serves taps along the ray; use 'reference' for uv taps")
    flat = _pairs(mask, light, taps.own, taps.first, taps.ratio, taps.step, at, taps.count)
    return flat.reshape(mask.shape if at is None else at.shape[:-1])

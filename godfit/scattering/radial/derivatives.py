"""The derivatives of a sum over geometric taps, from four sums that one pass works out.

Taps are c_k = first ratio^(k-1) at t_k = (k - lag) step (``godfit.scattering.taps``), so with

    S   = sum r^(k-1) I_k                  S_r = sum (k-1) r^(k-2) I_k
    G_x = sum (k - lag) r^(k-1) dI_k/dx    G_y = sum (k - lag) r^(k-1) dI_k/dy

where I_k = M(x + t_k (l - x)), the sum is out = own M(x) + first S, and its derivatives by own,
first, ratio, step and the light are products of these four with numbers that do not depend on the
tap. A method supplies the four sums; no other derivative is worked out.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from godfit.scattering.radial.coordinates import points, to_pixels
from godfit.scattering.radial.reference import bilinear
from godfit.scattering.taps import Count, Taps, TracedCount, number_of


class Numbers(NamedTuple):
    """What the four sums depend on beside the mask: the light in pixels of the mask, and the taps'
    ratio, step and lag."""

    light_x: Float[Array, ""]
    light_y: Float[Array, ""]
    ratio: Float[Array, ""]
    step: Float[Array, ""]
    lag: Float[Array, ""]


# A method's part, (mask, numbers, count, at, slopes) -> (1 or 4, points): S, or with ``slopes`` S,
# S_r, G_x and G_y per pixel of the mask, at columns and rows ``at`` (2, points), or at every pixel,
# row by row, where it is None.
Sums = Callable[
    [Float[Array, "h w"], Numbers, Count, Float[Array, "2 points"] | None, bool],
    Float[Array, "sums points"],
]


def geometric(
    sums: Sums,
    mask: Float[Array, "h w"],
    light: Float[Array, "2"],
    taps: Taps,
    at: Float[Array, "*points 2"] | None,
    linear: Sums | None = None,
) -> Float[Array, "*points"]:
    """The radial sum by ``sums``; for a tangent of the mask by ``linear``, which JAX must be able
    to transpose, by default ``sums`` too."""
    along_the_ray(taps)
    numbers = (light, taps.own, taps.first, taps.ratio, taps.step)
    lag = jax.lax.stop_gradient(taps.lag)
    # A traced count is an argument of the sum, a known one is part of the program.
    traced = isinstance(taps.count, TracedCount)
    known, count = (None, number_of(taps)) if traced else (taps.count, None)
    flat = _sum(sums, linear or sums, known, mask, *numbers, lag, at, count)
    return flat.reshape(mask.shape if at is None else at.shape[:-1])


def along_the_ray(taps: Taps) -> None:
    """Raise ValueError for taps that are not, which only 'reference' serves."""
    if taps.unit != "ray":
        raise ValueError("this method serves taps along the ray; use 'reference' for uv taps")


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def _sum(sums, linear, known, mask, light, own, first, ratio, step, lag, at, count):
    numbers, where, out = _prepared(mask, light, ratio, step, lag, at)
    taken = count if known is None else known
    return own * out + first * sums(mask, numbers, taken, where, False)[0]


def _prepared(mask, light, ratio, step, lag, at):
    h, w = mask.shape
    numbers = Numbers(*to_pixels(light, h, w), ratio, step, lag)
    if at is None:
        return numbers, None, mask.reshape(-1)
    where = at.reshape(-1, 2).T
    return numbers, where, bilinear(mask, where[0], where[1])


@functools.partial(_sum.defjvp, symbolic_zeros=True)
def _sum_jvp(sums, linear, known, primals, tangents):
    mask, light, own, first, ratio, step, lag, at, count = primals
    d_mask, d_light, d_own, d_first, d_ratio, d_step, _, d_at, _ = tangents
    if at is not None and not is_zero(d_at):
        raise ValueError("radial_sum is differentiable in `at` by method 'reference' alone")
    numbers, where, itself = _prepared(mask, light, ratio, step, lag, at)
    four = sums(mask, numbers, count if known is None else known, where, True)
    by = partial_derivatives(itself, four, first, numbers, (mask.shape[0], mask.shape[1]), at)
    out = own * itself + first * four[0]
    d_out = jnp.zeros_like(out)
    each = zip((d_own, d_first, d_ratio, d_step), by, strict=False)
    for change, along in each:
        if not is_zero(change):
            d_out += change * along
    if not is_zero(d_light):
        d_out += d_light[0] * by.light_x + d_light[1] * by.light_y
    if not is_zero(d_mask):
        d_out += _sum(linear, linear, known, d_mask, light, own, first, ratio, step, lag, at, count)
    return out, d_out


class Partial(NamedTuple):
    """The derivatives of a sum, (points,) each, by the taps' numbers and by the light in texture
    coordinates."""

    own: Float[Array, " points"]
    first: Float[Array, " points"]
    ratio: Float[Array, " points"]
    step: Float[Array, " points"]
    light_x: Float[Array, " points"]
    light_y: Float[Array, " points"]


def partial_derivatives(
    itself: Float[Array, " points"],
    four: Float[Array, "4 points"],
    first: Float[Array, ""],
    numbers: Numbers,
    size: tuple[int, int],
    at: Float[Array, "*points 2"] | None,
) -> Partial:
    """From the mask at the points, ``itself``, and its ``four`` sums."""
    (h, w), (s, s_r, g_x, g_y) = size, four
    x, y = (z.reshape(-1) for z in points(h, w, at, s.dtype))
    by_step = first * (g_x * (numbers.light_x - x) + g_y * (numbers.light_y - y))
    # v points up, rows down.
    scale = first * numbers.step
    return Partial(itself, s, first * s_r, by_step, scale * w * g_x, -(scale * h * g_y))


def is_zero(tangent) -> bool:
    """Whether a rule with symbolic zeros is asked for no derivative by this."""
    return isinstance(tangent, jax.custom_derivatives.SymbolicZero)

"""The derivatives of a sum over geometric taps, from four sums that one pass over the taps gives.

Taps are c_k = first ratio^(k-1) at t_k = (k - lag) step (``godfit.scattering.taps``), so with

    S   = sum r^(k-1) I_k                  S_r = sum (k-1) r^(k-2) I_k
    G_x = sum (k - lag) r^(k-1) dI_k/dx    G_y = sum (k - lag) r^(k-1) dI_k/dy

where I_k = M(x + t_k (l - x)), the sum is out = own M(x) + first S, and its derivatives by own,
first, ratio, step and the light are products of these four with numbers that do not depend on the
tap. A method computes the four sums, and nothing else for the derivatives.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from godfit.scattering.radial.coordinates import points, to_pixels
from godfit.scattering.radial.reference import bilinear
from godfit.scattering.taps import Count, Scalar, Taps, TracedCount, number_of


class RayParameters(NamedTuple):
    """What the four sums depend on besides the mask: the light's column and row in pixels of the
    mask, and the taps' ratio, step and lag."""

    light_x: Float[Array, ""]
    light_y: Float[Array, ""]
    ratio: Float[Array, ""]
    step: Float[Array, ""]
    lag: Float[Array, ""]


Sums = Callable[
    [Float[Array, "h w"], RayParameters, Count, Float[Array, "2 points"] | None, bool],
    Float[Array, "sums points"],
]
"""A method's sums, (mask, ray, count, at, slopes) -> (1 or 4, points): S, or with ``slopes`` S,
S_r, G_x and G_y, whose slopes are per pixel of the mask. They are computed at columns and rows
``at`` (2, points), or at every pixel, row by row, where it is None."""


class TapParameters(NamedTuple):
    """The parameters of a sum besides the mask, by which it is differentiated: the light (u, v),
    and the taps' own weight, first weight, ratio and step. There is no derivative by the ``lag``,
    nor by the ``count``, which is None where it is known when the program is compiled."""

    light: Float[Array, "2"]
    own: Scalar
    first: Scalar
    ratio: Scalar
    step: Scalar
    lag: Scalar
    count: Int[Array, ""] | None


def geometric_sum(
    sums: Sums,
    mask: Float[Array, "h w"],
    light: Float[Array, "2"],
    taps: Taps,
    at: Float[Array, "*points 2"] | None,
    linear: Sums | None = None,
) -> Float[Array, "*points"]:
    """The radial sum by ``sums``.

    A tangent of the mask is summed by ``linear``, which JAX must be able to transpose; by default
    it is ``sums`` too. Raises ValueError for taps whose unit is not the ray.
    """
    require_ray_taps(taps)
    lag = jax.lax.stop_gradient(taps.lag)
    # A traced count is an argument of the sum, a known one a constant of the program.
    traced = isinstance(taps.count, TracedCount)
    known, count = (None, number_of(taps)) if traced else (taps.count, None)
    parameters = TapParameters(light, taps.own, taps.first, taps.ratio, taps.step, lag, count)
    flat = _sum(sums, linear or sums, known, mask, parameters, at)
    return flat.reshape(mask.shape if at is None else at.shape[:-1])


def require_ray_taps(taps: Taps) -> None:
    """Raise ValueError for taps in texture coordinates, which only 'reference' serves."""
    if taps.unit != "ray":
        raise ValueError("this method serves taps along the ray; use 'reference' for uv taps")


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def _sum(sums, linear, known, mask, parameters, at):
    ray, points_at, itself = _prepared(mask, parameters, at)
    count = parameters.count if known is None else known
    return parameters.own * itself + parameters.first * sums(mask, ray, count, points_at, False)[0]


def _prepared(mask, parameters, at):
    """The parameters in pixels, ``at`` as (2, points) or None, and the mask there (points,)."""
    h, w = mask.shape
    ratio, step, lag = parameters.ratio, parameters.step, parameters.lag
    ray = RayParameters(*to_pixels(parameters.light, h, w), ratio, step, lag)
    if at is None:
        return ray, None, mask.reshape(-1)
    points_at = at.reshape(-1, 2).T
    return ray, points_at, bilinear(mask, points_at[0], points_at[1])


@functools.partial(_sum.defjvp, symbolic_zeros=True)
def _sum_jvp(sums, linear, known, primals, tangents):
    mask, parameters, at = primals
    d_mask, d_parameters, d_at = tangents
    if at is not None and not is_symbolic_zero(d_at):
        raise ValueError("radial_sum is differentiable in `at` by method 'reference' alone")
    ray, points_at, itself = _prepared(mask, parameters, at)
    four = _four_sums(sums, linear, known, mask, ray, parameters.count, points_at)
    size = (mask.shape[0], mask.shape[1])
    by = partial_derivatives(itself, four, parameters.first, ray, size, at)
    out = parameters.own * itself + parameters.first * four[0]
    d_out = jnp.zeros_like(out)
    for name in ("own", "first", "ratio", "step"):
        tangent = getattr(d_parameters, name)
        if not is_symbolic_zero(tangent):
            d_out += tangent * getattr(by, name)
    d_light = d_parameters.light
    if not is_symbolic_zero(d_light):
        d_out += d_light[0] * by.light_x + d_light[1] * by.light_y
    if not is_symbolic_zero(d_mask):
        d_out += _sum(linear, linear, known, d_mask, parameters, at)
    return out, d_out


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def _four_sums(sums, linear, known, mask, ray, count, at):
    """The four sums of a first derivative. What differentiates them once more is ``linear``, whose
    derivatives are JAX's own: compiled ``sums`` have none."""
    return sums(mask, ray, count if known is None else known, at, True)


@functools.partial(_four_sums.defjvp, symbolic_zeros=True)
def _four_sums_jvp(sums, linear, known, primals, tangents):
    mask, ray, count, at = primals
    d_mask, d_ray = (jax.tree.map(_as_array, t, is_leaf=is_symbolic_zero) for t in tangents[:2])

    def four(mask, ray):
        return linear(mask, ray, count if known is None else known, at, True)

    _, d_four = jax.jvp(four, (mask, ray), (d_mask, d_ray))
    return _four_sums(sums, linear, known, mask, ray, count, at), d_four


def _as_array(tangent):
    """A tangent, with zeros in place of a symbolic zero."""
    return jnp.zeros(tangent.shape, tangent.dtype) if is_symbolic_zero(tangent) else tangent


class PartialDerivatives(NamedTuple):
    """The derivatives of a sum, (points,) each, by the taps' parameters and by the light in texture
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
    ray: RayParameters,
    size: tuple[int, int],
    at: Float[Array, "*points 2"] | None,
) -> PartialDerivatives:
    """From the mask at the points, ``itself``, and the ``four`` sums S, S_r, G_x and G_y there.

    ``first`` is the first tap's weight, ``size`` (h, w) the mask's. ``at`` holds the points'
    columns and rows, None for every pixel.
    """
    (h, w), (s, s_r, g_x, g_y) = size, four
    x, y = (z.reshape(-1) for z in points(h, w, at, s.dtype))
    by_step = first * (g_x * (ray.light_x - x) + g_y * (ray.light_y - y))
    # v points up, rows go down.
    scale = first * ray.step
    return PartialDerivatives(itself, s, first * s_r, by_step, scale * w * g_x, -(scale * h * g_y))


def is_symbolic_zero(tangent) -> bool:
    """Whether a rule with symbolic zeros need not differentiate by this argument."""
    return isinstance(tangent, jax.custom_derivatives.SymbolicZero)

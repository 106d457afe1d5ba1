"""Reference: the definition, a ``lax.scan`` over the taps with four texel reads for each.

Cost: taps x points x 4 reads. Error: rounding. Every derivative is JAX's own, so the other methods
and their hand-written derivatives are tested against this one.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from godfit.scattering.radial.coordinates import points, to_pixels
from godfit.scattering.taps import Scalar, Taps


def bilinear(
    mask: Float[Array, "h w"], x: Float[Array, "*points"], y: Float[Array, "*points"]
) -> Float[Array, "*points"]:
    """The mask at columns ``x`` and rows ``y`` (pixels), clamped to its edge (CLAMP_TO_EDGE)."""
    h, w = mask.shape
    i, j = jnp.floor(x), jnp.floor(y)
    fx, fy = x - i, y - j

    def read(row, column):
        return mask[
            jnp.clip(row, 0, h - 1).astype(jnp.int32), jnp.clip(column, 0, w - 1).astype(jnp.int32)
        ]

    top = (1 - fx) * read(j, i) + fx * read(j, i + 1)
    bottom = (1 - fx) * read(j + 1, i) + fx * read(j + 1, i + 1)
    return (1 - fy) * top + fy * bottom


def reference(
    mask: Float[Array, "h w"],
    light: Float[Array, "2"],
    taps: Taps,
    at: Float[Array, "*points 2"] | None,
) -> Float[Array, "*points"]:
    """See ``godfit.scattering.radial.radial_sum``; serves taps of every unit."""
    return weighted_sum(mask, light, WeightedTaps(taps.own, taps.c, taps.t), at, taps.unit)


class WeightedTaps(NamedTuple):
    """Taps of any weights ``c`` (count,) at any positions ``t`` (count,), and ``own``, the weight
    of the pixel's own value."""

    own: Scalar
    c: Float[Array, " count"]
    t: Float[Array, " count"]


def weighted_sum(
    mask: Float[Array, "h w"],
    light: Float[Array, "2"],
    taps: WeightedTaps,
    at: Float[Array, "*points 2"] | None,
    unit: str = "ray",
) -> Float[Array, "*points"]:
    """The sum over taps whose positions are in ``unit``, as in ``Taps``; see ``radial_sum``."""
    h, w = mask.shape
    x, y = points(h, w, at, mask.dtype)
    light_x, light_y = to_pixels(light, h, w)
    ray_x, ray_y = light_x - x, light_y - y
    # A step in texture coordinates is a fraction step / |l - x| of the ray. At the light itself the
    # ray has no direction; the 1 in place of its length keeps the derivative finite.
    squared = (ray_x / w) ** 2 + (ray_y / h) ** 2
    length = jnp.sqrt(jnp.where(squared > 0, squared, 1.0)) if unit == "uv" else 1.0

    def tap(total, ct):
        c, t = ct
        fraction = t / length
        value = c * bilinear(mask, x + fraction * ray_x, y + fraction * ray_y)
        if unit == "uv":
            value = jnp.where((fraction <= 1) & (squared > 0), value, 0.0)
        return total + value, None

    own = taps.own * bilinear(mask, x, y)
    total, _ = jax.lax.scan(tap, own, (taps.c, taps.t))
    return total

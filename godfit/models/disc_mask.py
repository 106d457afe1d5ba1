"""The occlusion mask of a disc light on a veil, and its derivatives.

``light`` (2,) is in texture coordinates; ``shape`` (3,) is radius and edge width, in picture
heights, and veil; ``open_`` (h, w) is the open mask.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

DISTANCE_SOFTENING = 1e-12
"""Added to the squared distance from the light, in squared heights of the mask: the square root
then has a derivative at the light itself."""


def occluded(
    light: Float[Array, " 2"],
    shape: Float[Array, " 3"],
    open_: Float[Array, "h w"],
    least: float = 0.0,
    cut: int = 1,
) -> Float[Array, "h w"]:
    """open (veil + (1 - veil) disc), at most 1. The disc's edge is at ``least`` so wide, in texels;
    each texel is the mean of ``cut`` parts a side."""
    radius, edge, veil = shape
    h, w = open_.shape
    away = distance_from_light(light, (h * cut, w * cut))[2].reshape(h, cut, w, cut)
    wide = jnp.maximum(edge, least / h)
    disc = jax.nn.sigmoid((radius - away) / wide).mean((1, 3))
    return jnp.minimum(open_ * (veil + (1 - veil) * disc), 1.0)


def occluded_slopes(
    light: Float[Array, " 2"],
    shape: Float[Array, " 3"],
    open_: Float[Array, "h w"],
    least: float,
) -> list[Float[Array, "h w"]]:
    """The five derivatives of ``occluded`` by light and shape, for texels that are not cut: an edge
    at ``least`` so wide stands for the mean over the parts.

    In closed form: for a whole picture, dual numbers in every part of a texel would cost twenty
    times the sum over taps.
    """
    radius, edge, veil = shape
    h, w = open_.shape
    wide = jnp.maximum(edge, least / h)
    x, y, away = distance_from_light(light, (h, w))
    disc = jax.nn.sigmoid((radius - away) / wide)
    lit = open_ * (veil + (1 - veil) * disc)
    by_radius = open_ * (1 - veil) * disc * (1 - disc) / wide
    by_edge = -by_radius * (radius - away) / wide * (edge >= least / h)
    slopes = [
        by_radius * x * (w / h) / away, by_radius * y / away, by_radius, by_edge,
        open_ * (1 - disc),
    ]  # fmt: skip
    # Where the mask is clipped to 1 it does not change.
    return [jnp.where(lit > 1, 0.0, slope) for slope in slopes]


def distance_from_light(light: Float[Array, " 2"], size: tuple[int, int]):
    """The texels of a mask of ``size`` (h, w), from the light and in heights of the mask: distance
    to the right (1, w), upwards (h, 1), and in a straight line (h, w)."""
    h, w = size
    rows, columns = (jnp.arange(n, dtype=light.dtype) for n in size)
    x = (columns + 0.5) / w - light[0]
    y = 1 - (rows + 0.5) / h - light[1]
    x, y = (x * w / h)[None], y[:, None]
    return x, y, jnp.sqrt(x**2 + y**2 + DISTANCE_SOFTENING)

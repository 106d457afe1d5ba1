"""The occlusion mask of a disc light on a veil, and its derivatives.

``light`` (2,) is in texture coordinates; ``shape`` (3,) is radius and edge, in picture heights, and
veil; ``open_`` (h, w) is what is open.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def occluded(
    light: Float[Array, " 2"],
    shape: Float[Array, " 3"],
    open_: Float[Array, "h w"],
    least: float = 0.0,
    cut: int = 1,
) -> Float[Array, "h w"]:
    """open (veil + (1 - veil) disc), at most 1, with the disc's edge at ``least`` so wide, in
    texels, each of which is ``cut`` into so many parts a side."""
    radius, edge, veil = shape
    h, w = open_.shape
    away = from_light(light, (h * cut, w * cut))[2].reshape(h, cut, w, cut)
    wide = jnp.maximum(edge, least / h)
    disc = jax.nn.sigmoid((radius - away) / wide).mean((1, 3))
    return jnp.minimum(open_ * (veil + (1 - veil) * disc), 1.0)


def occluded_slopes(
    light: Float[Array, " 2"],
    shape: Float[Array, " 3"],
    open_: Float[Array, "h w"],
    least: float,
) -> list[Float[Array, "h w"]]:
    """The five derivatives of ``occluded`` by light and shape, of texels that are not cut: what
    parts of one do apart, an edge at ``least`` so wide does together. In closed form: of a whole
    picture dual numbers of every part cost twenty times the sum over taps."""
    radius, edge, veil = shape
    h, w = open_.shape
    wide = jnp.maximum(edge, least / h)
    x, y, away = from_light(light, (h, w))
    disc = jax.nn.sigmoid((radius - away) / wide)
    lit = open_ * (veil + (1 - veil) * disc)
    by_radius = open_ * (1 - veil) * disc * (1 - disc) / wide
    by_edge = -by_radius * (radius - away) / wide * (edge >= least / h)
    each = [
        by_radius * x * (w / h) / away, by_radius * y / away, by_radius, by_edge,
        open_ * (1 - disc),
    ]  # fmt: skip
    return [jnp.where(lit > 1, 0.0, by) for by in each]


def from_light(light: Float[Array, " 2"], size: tuple[int, int]):
    """How far to the right and above (1, w), (h, 1) and how far (h, w) from the light texels of a
    mask of ``size`` are, in its heights."""
    h, w = size
    rows, columns = (jnp.arange(n, dtype=light.dtype) for n in size)
    x = (columns + 0.5) / w - light[0]
    y = 1 - (rows + 0.5) / h - light[1]
    x, y = (x * w / h)[None], y[:, None]
    return x, y, jnp.sqrt(x**2 + y**2 + 1e-12)

"""Texture coordinates and pixels of the mask, which all methods convert alike."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float


def to_pixels(
    uv: Float[Array, "*points 2"], height: int, width: int
) -> tuple[Float[Array, "*points"], Float[Array, "*points"]]:
    """Columns and rows of ``uv`` in pixels, 0 at the centre of the top left pixel."""
    return uv[..., 0] * width - 0.5, (1 - uv[..., 1]) * height - 0.5


def points(
    height: int, width: int, at: Float[Array, "*points 2"] | None, dtype
) -> tuple[Float[Array, "*points"], Float[Array, "*points"]]:
    """Columns and rows of ``at``, or of every pixel, (height, width), where it is None."""
    if at is not None:
        return at[..., 0], at[..., 1]
    x, y = jnp.arange(width, dtype=dtype), jnp.arange(height, dtype=dtype)
    columns, rows = jnp.meshgrid(x, y)
    return columns, rows

"""The part of a mask around a light's disc: little of a picture, and all that its edge changes.

A sum over taps that reads a mask which is dark but for that part needs no more than the part. The
border of a picture is repeated beyond it, so that of a part it must be dark wherever the picture
goes on.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

# Side, as a share of the picture's height, in whole cells of so many texels.
SIDE, CELL = 3 / 8, 8
# Texels from the outermost that is not dark to the window's border.
MARGIN = 2


class Window(NamedTuple):
    """``shape`` of the part, rows and columns, of a mask of ``size``, from ``corner`` (2,) on."""

    corner: Int[Array, " 2"]
    shape: tuple[int, int]
    size: tuple[int, int]

    @staticmethod
    def about(light: Float[Array, " 2"], size: tuple[int, int]) -> Window:
        """The one about a light (texture coordinates) that lies on the mask of ``size``."""
        side = _side(size)
        shape = min(side, size[0]), min(side, size[1])
        middle = jnp.stack([(1 - light[1]) * size[0], light[0] * size[1]])
        first = jnp.round(middle - jnp.array(shape) / 2)
        last = jnp.array(size) - jnp.array(shape)
        return Window(jnp.clip(first, 0, last).astype(jnp.int32), shape, size)

    @staticmethod
    def whole(size: tuple[int, int]) -> Window:
        """All of a mask of ``size``."""
        return Window(jnp.zeros(2, jnp.int32), size, size)

    def cut_into(self, parts: int) -> Window:
        """The same of a mask with so many times as many texels a side."""
        (rows, columns), (h, w) = self.shape, self.size
        return Window(self.corner * parts, (rows * parts, columns * parts), (h * parts, w * parts))

    @staticmethod
    def holds(reach: Float[Array, ""], size: tuple[int, int]) -> Bool[Array, ""]:
        """Whether all that lies within ``reach`` texels of a light does in its window."""
        return reach + MARGIN < _side(size) / 2

    def cut(self, mask: Float[Array, "h w"]) -> Float[Array, "rows columns"]:
        """What of a mask lies in it."""
        return jax.lax.dynamic_slice(mask, self.corner, self.shape)

    def dark_around(self, part: Float[Array, "rows columns"]) -> Float[Array, "rows columns"]:
        """With a border of 0 wherever the picture goes on."""
        rows, columns = (jnp.arange(n) for n in self.shape)
        (top, left), (h, w) = self.corner, self.size
        row = self._inside(rows, top, h)
        column = self._inside(columns, left, w)
        return jnp.where(row[:, None] & column[None], part, 0)

    @staticmethod
    def _inside(places, first, count):
        last = places.shape[0] - 1
        starts, ends = first == 0, first + last == count - 1
        return ((places > 0) | starts) & ((places < last) | ends)

    def light(self, light: Float[Array, "lights 2"]) -> Float[Array, "lights 2"]:
        """Where lights of the picture are in texture coordinates of the part."""
        (h, w), (rows, columns) = self.size, self.shape
        u = (light[:, 0] * w - self.corner[1]) / columns
        v = 1 - ((1 - light[:, 1]) * h - self.corner[0]) / rows
        return jnp.stack([u, v], -1)

    def at(self, points: Float[Array, "*points 2"]) -> Float[Array, "*points 2"]:
        """Columns and rows of the picture as those of the part."""
        first = self.corner[::-1].astype(points.dtype)
        return points - first.reshape((1,) * (points.ndim - 1) + (2,))


def _side(size: tuple[int, int]) -> int:
    """Texels of a window's side, where the mask of ``size`` has as many."""
    return -(-int(SIDE * size[0]) // CELL) * CELL

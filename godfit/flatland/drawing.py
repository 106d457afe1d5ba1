"""Shapes that a canvas is drawn from, differentiable in their positions, and their TOML file.

Positions and lengths are in picture heights, x to the right and y up, (0, 0) the bottom-left
corner; an edge is ``softness`` pixels wide. The distance to every shape is exact (after Quilez, "2D
distance functions"), also inside, so an edge has the same width everywhere.

Pixels stick out: a ray that grazes a disc meets pixels that are covered in part, one after another.
To the light the disc's radius is 0.6 pixels larger (0.4 where pixels are all or nothing).
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.errors import shown
from godfit.flatland.canvas import Canvas
from godfit.io.toml_table import Table
from godfit.runtime.memory import check_memory
from godfit.scenes.scene import MAX_PICTURE_SIDE

SHAPE_NUMBERS: dict[str, dict[str, int]] = {
    "disc": {"centre": 2, "radius": 1},
    "segment": {"start": 2, "end": 2, "thickness": 1},
    "box": {"centre": 2, "size": 2, "angle": 1},
    "polygon": {"points": 0},
}
"""The numbers of every kind of shape, by name, and how many of each; 0 for any number of points."""

DRAWING_BYTES = 64
"""Memory that a canvas takes a pixel, in bytes: four channels in float32, four times over."""
EDGE_SOFTNESS = 1.0
"""Pixels, the default width of an edge: that of an antialiased one."""


class Shape(eqx.Module):
    """A disc (centre, radius), a segment (start, end, thickness), a box (centre, size, angle in
    degrees) or a polygon (points (n, 2)), of one radiance (3,) and opacity (). A polygon's points
    are in order, either way round, and its outline does not cross itself."""

    kind: str = eqx.field(static=True)
    numbers: dict[str, Float[Array, "..."]]
    radiance: Float[Array, "3"]
    opacity: Float[Array, ""]

    def __init__(self, kind, radiance=(0.0, 0.0, 0.0), opacity=1.0, **numbers):
        self.kind = kind
        self.numbers = {name: jnp.asarray(value, float) for name, value in numbers.items()}
        self.radiance, self.opacity = jnp.asarray(radiance, float), jnp.asarray(opacity, float)

    def distance(self, x: Float[Array, "h w"], y: Float[Array, "h w"]) -> Float[Array, "h w"]:
        """The distance from (x, y) to the edge, in picture heights, negative inside."""
        n = self.numbers
        if self.kind == "disc":
            return _length(x - n["centre"][0], y - n["centre"][1]) - n["radius"]
        if self.kind == "segment":
            return _to_segment(x, y, n["start"], n["end"]) - n["thickness"] / 2
        if self.kind == "box":
            turn = jnp.deg2rad(n["angle"])
            c, s = jnp.cos(turn), jnp.sin(turn)
            dx, dy = x - n["centre"][0], y - n["centre"][1]
            a = jnp.abs(c * dx + s * dy) - n["size"][0] / 2
            b = jnp.abs(c * dy - s * dx) - n["size"][1] / 2
            return _length(jnp.maximum(a, 0), jnp.maximum(b, 0)) + jnp.minimum(jnp.maximum(a, b), 0)
        return _to_polygon(x, y, n["points"])

    def shifted(self, by: Float[Array, "2"]) -> Shape:
        """The shape, moved ``by`` (x, y) picture heights."""
        numbers = dict(self.numbers)
        for name in ("centre", "start", "end"):
            if name in numbers:
                numbers[name] = numbers[name] + by
        if "points" in numbers:
            numbers["points"] = numbers["points"] + by[None]
        return eqx.tree_at(lambda s: s.numbers, self, numbers)


class Drawing(eqx.Module):
    """Shapes, later ones over earlier ones, on a canvas of ``size`` (h, w) pixels, and the
    ``settings`` of the render (name, value) that their file has."""

    shapes: tuple[Shape, ...]
    size: tuple[int, int] = eqx.field(static=True)
    softness: float = eqx.field(static=True, default=EDGE_SOFTNESS)
    settings: tuple[tuple[str, Any], ...] = eqx.field(static=True, default=())

    def drawn(self) -> Canvas:
        """The canvas, differentiable in every number of every shape."""
        h, w = self.size
        y = jnp.broadcast_to(1 - (jnp.arange(h) + 0.5)[:, None] / h, (h, w))
        x = jnp.broadcast_to((jnp.arange(w) + 0.5)[None] / h, (h, w))
        radiance, opacity = jnp.zeros((h, w, 3)), jnp.zeros((h, w))
        for shape in self.shapes:
            # Coverage falls from 1 half the softness inside to 0 half of it outside, smooth at both
            # ends.
            t = jnp.clip(0.5 - shape.distance(x, y) * h / self.softness, 0, 1)
            coverage = t * t * (3 - 2 * t)
            alpha = coverage * shape.opacity
            emission = jnp.expand_dims(shape.radiance, (0, 1))
            radiance = coverage[..., None] * emission + (1 - alpha)[..., None] * radiance
            opacity = alpha + (1 - alpha) * opacity
        return Canvas(radiance, opacity)


def _length(a, b):
    """hypot, whose derivative at 0 is 0."""
    square = a * a + b * b
    safe = jnp.where(square > 0, square, 1)
    return jnp.where(square > 0, jnp.sqrt(safe), 0)


def _to_segment(x, y, start, end):
    """The distance from (x, y) to the line between two points."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    square = dx * dx + dy * dy
    along = ((x - start[0]) * dx + (y - start[1]) * dy) / jnp.where(square > 0, square, 1)
    along = jnp.clip(along, 0, 1)
    return _length(x - start[0] - along * dx, y - start[1] - along * dy)


def _to_polygon(x, y, points):
    """The distance from (x, y) to a polygon's outline, negative inside (even-odd rule)."""
    nearest, inside = jnp.full(x.shape, jnp.inf), jnp.zeros(x.shape, bool)
    for i in range(points.shape[0]):
        a, b = points[i - 1], points[i]
        nearest = jnp.minimum(nearest, _to_segment(x, y, a, b))
        spans = (a[1] > y) != (b[1] > y)
        rise = jnp.where(a[1] == b[1], 1, b[1] - a[1])
        inside ^= spans & (x < a[0] + (y - a[1]) * (b[0] - a[0]) / rise)
    return jnp.where(inside, -nearest, nearest)


def read_drawing(path: str | os.PathLike[str]) -> Drawing:
    """Read a scene of shapes. Raises InputError, which names the file, the key, what was expected
    and what was got.

    ``[image]`` has width and height and may have softness; ``[[shape]]`` a kind, its numbers,
    radiance (three numbers of 0 or more, or "#rrggbb") and opacity; ``[sky]`` may have sun_angle,
    sun_width, sun and sky.
    """
    path = Path(path)
    root = Table.read(path, "a scene of shapes")
    image, sky = root.table("image"), root.table("sky", {})
    shapes = [_shape(Table(path, f"shape[{i}]", t)) for i, t in enumerate(root.tables("shape"))]
    root.finish()
    size = image.whole("height", 1, MAX_PICTURE_SIDE), image.whole("width", 1, MAX_PICTURE_SIDE)
    check_memory(DRAWING_BYTES * size[0] * size[1], f"'{path}': {size[1]}x{size[0]} pixels")
    softness = image.number("softness", EDGE_SOFTNESS, above=0.0)
    settings = [(k, sky.number(k)) for k in ("sun_angle", "sun_width") if k in sky.data]
    settings += [(k, tuple(_radiance(sky, k))) for k in ("sun", "sky") if k in sky.data]
    sky.may_have("sun_angle", "sun_width", "sun", "sky")
    for table in (image, sky):
        table.finish()
    return Drawing(tuple(shapes), size, softness, tuple(settings))


def _shape(table: Table) -> Shape:
    kind = table.text("kind")
    if kind not in SHAPE_NUMBERS:
        got = "nothing; add it" if kind is None else shown(kind)
        raise table.error("kind", f"one of {', '.join(SHAPE_NUMBERS)}", got)
    numbers: dict[str, Any] = {}
    for name, count in SHAPE_NUMBERS[kind].items():
        if count == 1:
            default = 0.0 if name == "angle" else None
            numbers[name] = table.number(name, default, -np.inf if name == "angle" else 0.0)
        elif count == 2:
            numbers[name] = table.numbers(name, 2, above=0.0 if name == "size" else -np.inf)
        else:
            numbers[name] = table.points(name)
    opacity = table.number("opacity", 1.0)
    if not 0 <= opacity <= 1:
        raise table.error("opacity", "a number from 0 to 1", f"{opacity:g}")
    radiance = _radiance(table, "radiance")
    table.finish()
    return Shape(kind, radiance, opacity, **numbers)


def _radiance(table: Table, key: str) -> list[float]:
    """Three numbers of 0 or more, or "#rrggbb"; black if the key is missing."""
    value = table.get(key, "#000000", "a colour")
    if isinstance(value, str):
        return list(table.colour(key, "#000000"))
    numbers = table.numbers(key, 3)
    if min(numbers) < 0:
        raise table.error(key, "three numbers of 0 or more", shown(value))
    return numbers

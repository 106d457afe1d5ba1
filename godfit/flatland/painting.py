"""Canvases painted with strokes, as the page of jason.today/gi (2024) paints them.

Positions are in pixels from the top left corner, x to the right and y down, as a mouse has them.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from godfit.errors import InputError
from godfit.flatland.canvas import MAX_CANVAS_SIDE

PALETTE = ("#fff6d3", "#f9a875", "#eb6b6f", "#7c3f58", "#000000")
"""The page's colours, from the brightest lamp to the black that hides light."""

BRUSH_RADIUS = 5.0
"""Pixels: the radius that the page's canvases give their brush. The brush's own default is 6."""

SATURATION_CHANGES = (-20, 0)
"""Percent, whole numbers from the first to below the last: the change of a grain's saturation."""

LIGHTNESS_CHANGES = (-5, 5)
"""Percent, whole numbers from the first to below the last: the change of a grain's lightness."""

EXAMPLE_DURATION = 10.0
"""The page's example is drawn from time 0 to before this, in its own unit."""

STROKE_INTERVAL = 0.3
"""Time between two points of the example's stroke."""

SHADOW_INTERVAL = 0.5
"""Time between two points of the example's shadow."""


class Stroke(NamedTuple):
    """A line through ``points`` (n, 2), x and y, in a ``colour`` ("#rrggbb"), drawn with a round
    brush of some ``radius`` in pixels. One point is a dot."""

    points: Float[np.ndarray, "n 2"]
    colour: str
    radius: float = BRUSH_RADIUS

    def rgb(self) -> tuple[int, int, int]:
        """The colour as three bytes. Raises InputError."""
        if not re.fullmatch(r"#[0-9a-fA-F]{6}", self.colour):
            raise InputError(f"colour: expected #rrggbb, got {self.colour!r}")
        r, g, b = (int(self.colour[i : i + 2], 16) for i in (1, 3, 5))
        return r, g, b

    def segments(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """The pairs of points to draw between: the first with itself, then each with the next.
        Raises InputError."""
        points = np.asarray(self.points, float)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0:
            raise InputError(f"points: expected (n, 2) with n of 1 or more, got {points.shape}")
        if not np.isfinite(points).all() or not 0 < self.radius < math.inf:
            raise InputError(
                f"stroke: expected finite points and a radius above 0, got radius {self.radius:g}"
            )
        return [(points[0], points[0]), *itertools.pairwise(points)]


def painted(size: tuple[int, int], strokes: Sequence[Stroke]) -> UInt8[np.ndarray, "h w 4"]:
    """A canvas of ``size`` (h, w) as bytes, transparent where no stroke covers a pixel's middle and
    opaque elsewhere, in the colour of the last stroke that does. Raises InputError."""
    check_size(size)
    h, w = size
    y, x = np.arange(h)[:, None] + 0.5, np.arange(w)[None] + 0.5
    out = np.zeros((h, w, 4), np.uint8)
    for stroke in strokes:
        inside = np.zeros((h, w), bool)
        for (ax, ay), (bx, by) in stroke.segments():
            dx, dy = bx - ax, by - ay
            square = dx * dx + dy * dy
            along = ((x - ax) * dx + (y - ay) * dy) / (square if square > 0 else 1.0)
            along = along.clip(0, 1)
            apart = (x - ax - along * dx) ** 2 + (y - ay - along * dy) ** 2
            inside |= apart <= stroke.radius**2
        out[inside] = (*stroke.rgb(), 255)
    return out


def example_strokes() -> tuple[Stroke, Stroke]:
    """The page's example for a canvas 300 pixels wide and 300 or more high: a glowing stroke, and a
    black one that throws a shadow."""
    t = np.array(list(_times(STROKE_INTERVAL)))
    angle = t * 0.05 * math.pi * 2
    x = 100 + 100 * np.sin(angle + 0.25) * np.cos(angle * 0.15)
    y = 50 + 100 * np.sin(angle * 0.7)
    t = np.array(list(_times(SHADOW_INTERVAL)))
    shadow = np.stack([90 + 12 * t, 200 + 1 * t], -1)
    return Stroke(np.stack([x, y], -1), PALETTE[1]), Stroke(shadow, PALETTE[-1])


def varied(
    rgb: tuple[int, int, int], count: int, rng: np.random.Generator
) -> UInt8[np.ndarray, "n 3"]:
    """``count`` variations of a colour of three bytes: saturation and lightness are changed by
    whole percents at random, as the page does for its sand."""
    hue, saturation, lightness = _to_hsl(rgb)
    s = (saturation + rng.integers(*SATURATION_CHANGES, count)).clip(0, 100)
    l = (lightness + rng.integers(*LIGHTNESS_CHANGES, count)).clip(0, 100)  # noqa: E741
    return _from_hsl(hue, s, l)


def check_size(size: tuple[int, int]) -> None:
    """Raise InputError for a (height, width) that no canvas has."""
    if not all(1 <= n <= MAX_CANVAS_SIDE for n in size):
        raise InputError(
            f"size: expected (height, width) from 1 to {MAX_CANVAS_SIDE} pixels, got {size}"
        )


def _times(interval: float) -> Iterator[float]:
    """The times of the example's points, added up as the page does."""
    t = 0.0
    while t < EXAMPLE_DURATION:
        yield t
        t += interval


def _to_hsl(rgb: tuple[int, int, int]) -> tuple[float, float, float]:
    """Hue in degrees, saturation and lightness in percent, of a colour of three bytes."""
    r, g, b = (value / 255 for value in rgb)
    high, low = max(r, g, b), min(r, g, b)
    lightness, d = (high + low) / 2, high - low
    if d == 0:
        return 0.0, 0.0, 100 * lightness
    saturation = d / (2 - high - low) if lightness > 0.5 else d / (high + low)
    if high == r:
        sixths = (g - b) / d + (6 if g < b else 0)
    elif high == g:
        sixths = (b - r) / d + 2
    else:
        sixths = (r - g) / d + 4
    return 60 * sixths, 100 * saturation, 100 * lightness


def _from_hsl(hue: float, saturation: np.ndarray, lightness: np.ndarray) -> np.ndarray:
    """(n, 3) bytes, rounded half up, of a hue in degrees and n saturations and lightnesses in
    percent (CSS Color Module Level 4, section 7.1)."""
    s, light = saturation / 100, lightness / 100
    chroma = s * np.minimum(light, 1 - light)
    channels = []
    for n in (0, 8, 4):
        k = (n + hue / 30) % 12
        channels.append(light - chroma * max(-1.0, min(k - 3, 9 - k, 1.0)))
    return np.floor(255 * np.stack(channels, -1) + 0.5).astype(np.uint8)

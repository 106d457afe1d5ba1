"""The canvases of the light in the plane, and the skies that they are rendered under.

A canvas is an RGBA picture: colour is emission and alpha opacity; a black and opaque pixel hides
light. All but the sand's and the maze are drawn larger by formula and averaged. All are rounded to
bytes before anything is rendered from them.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from godfit.flatland.sand import Sand, falling_sand

ARTICLE_SKY = (0.02, 0.08, 0.2)
"""Radiance of the sky, red, green, blue, as in the article (jason.today/gi)."""

ARTICLE_SUN = (0.95, 0.95, 0.9)
"""Radiance of the sun, red, green, blue, as in the article."""

SAND_FRAMES = 6
"""Canvases of the falling sand: from the full funnel to nearly all of it fallen."""

SAND_FRAME_STEPS = 45
"""Frames of the sand between two of its canvases."""

SAND_SEED = 11
"""Seed of the grains and of how they fall; any would do."""

SAND_SIZE = 96
"""Cells of the sand from side to side."""

GRAIN_COLOURS = ((1.0, 0.55, 0.15), (0.2, 0.75, 1.0), (0.75, 0.25, 0.9))
"""Red, green, blue of the three kinds of grains: far apart, so that their light can be traced."""

GRAIN_BRIGHTNESS = 0.6
"""A grain's emission as a share of its colour: fainter than a lamp."""


class PlaneTruth(NamedTuple):
    """A sky, angle and width of the sun in degrees and radiances, and the exposure."""

    sun_angle: float
    sun_width: float
    sun: tuple[float, float, float]
    sky: tuple[float, float, float]
    exposure: float


class Sheet:
    """RGBA to draw on, four by four samples a pixel; x and y in picture heights, y up."""

    SAMPLES_PER_SIDE = 4

    def __init__(self, height: int, width: int):
        v = 1 - (np.arange(height * self.SAMPLES_PER_SIDE) + 0.5) / (height * self.SAMPLES_PER_SIDE)
        u = (np.arange(width * self.SAMPLES_PER_SIDE) + 0.5) / (height * self.SAMPLES_PER_SIDE)
        self.x, self.y = np.meshgrid(u, v)
        self.colour = np.zeros((*self.x.shape, 3))
        self.alpha = np.zeros(self.x.shape)

    def draw(self, inside: np.ndarray, colour=(0.0, 0.0, 0.0)) -> None:
        """Make the samples ``inside`` opaque, of this colour."""
        self.colour[inside], self.alpha[inside] = colour, 1.0

    def on_line(self, points: np.ndarray, thickness: float) -> np.ndarray:
        """True within half a thickness of the line through ``points`` (n, 2)."""
        inside = np.zeros(self.x.shape, bool)
        for (ax, ay), (bx, by) in itertools.pairwise(points):
            dx, dy = bx - ax, by - ay
            along = ((self.x - ax) * dx + (self.y - ay) * dy) / (dx * dx + dy * dy)
            along = along.clip(0, 1)
            inside |= np.hypot(self.x - ax - along * dx, self.y - ay - along * dy) < thickness / 2
        return inside

    def to_bytes(self) -> np.ndarray:
        """(h, w, 4) bytes, colour not multiplied by alpha."""
        both = np.concatenate([self.colour * self.alpha[..., None], self.alpha[..., None]], -1)
        h, w = (n // self.SAMPLES_PER_SIDE for n in self.alpha.shape)
        mean = both.reshape(h, self.SAMPLES_PER_SIDE, w, self.SAMPLES_PER_SIDE, 4).mean((1, 3))
        mean[..., :3] /= np.maximum(mean[..., 3:], 1e-9)
        return np.floor(mean * 255 + 0.5).astype(np.uint8)


def stroke(height: int = 256, width: int = 256) -> np.ndarray:
    """A glowing stroke beside a black one that casts its shadow, and a lamp at its end."""
    s = Sheet(height, width)
    t = np.linspace(0, 1, 60)
    wave = np.stack([0.18 + 0.5 * t, 0.62 + 0.13 * np.sin(2 * np.pi * t)], -1)
    s.draw(s.on_line(wave, 0.035), (1.0, 0.45, 0.1))
    shadow = np.stack([0.3 + 0.45 * t, 0.33 + 0.06 * np.cos(3 * t)], -1)
    s.draw(s.on_line(shadow, 0.04))
    s.draw(np.hypot(s.x - 0.8, s.y - 0.72) < 0.05, (0.3, 0.6, 1.0))
    return s.to_bytes()


def window(height: int = 160, width: int = 288) -> np.ndarray:
    """A section of a room: walls, a floor, a window with a bar, a table and a red lamp."""
    s = Sheet(height, width)
    aspect = width / height
    s.draw(s.y < 0.06)
    s.draw((s.y > 0.93) & (s.x > 0.3))
    s.draw((np.abs(s.x - 0.4) < 0.02) & ((s.y < 0.42) | (s.y > 0.78)))
    s.draw((np.abs(s.x - 0.4) < 0.015) & (np.abs(s.y - 0.6) < 0.012))
    s.draw(s.x > aspect - 0.05)
    s.draw((np.abs(s.x - 1.1) < 0.17) & (np.abs(s.y - 0.32) < 0.015))
    for leg in (0.97, 1.23):
        s.draw((np.abs(s.x - leg) < 0.012) & (s.y < 0.32))
    s.draw(np.hypot(s.x - 1.55, s.y - 0.8) < 0.03, (0.9, 0.15, 0.1))
    return s.to_bytes()


def maze(size: int = 192, cells: int = 12, seed: int = 3) -> np.ndarray:
    """Walls between cells, a way to every cell, with lamps in some and gaps to the sky."""
    rng = np.random.default_rng(seed)
    # Every cell opens upwards or to the right: a binary tree, so that there is a way out.
    up = rng.random((cells, cells)) < 0.5
    up[:, -1], up[0, :] = True, False
    canvas = np.zeros((size, size, 4), np.uint8)
    pitch = size // cells
    for row in range(cells):
        for column in range(cells):
            top, left = row * pitch, column * pitch
            if not up[row, column]:
                canvas[top : top + 2, left : left + pitch, 3] = 255
            if up[row, column] and column < cells - 1:
                canvas[top : top + pitch, left + pitch - 2 : left + pitch, 3] = 255
    for row, column, colour in (
        (2, 3, (255, 200, 90)),
        (7, 8, (80, 255, 120)),
        (9, 2, (90, 140, 255)),
    ):
        y, x = row * pitch + pitch // 2, column * pitch + pitch // 2
        canvas[y - 2 : y + 3, x - 2 : x + 3] = (*colour, 255)
    return canvas


def hourglass(size: int = SAND_SIZE) -> Sand:
    """(size, size) a funnel full of grains of three colours above ledges that catch some."""
    y, x = np.mgrid[:size, :size] / size
    rng = np.random.default_rng(SAND_SEED)
    cells = np.zeros((size, size), np.int32)
    solid = -1 - len(GRAIN_COLOURS)
    slope = np.abs(x - 0.5) - (0.035 + 0.9 * np.maximum(0.42 - y, 0))
    cells[(np.abs(slope) < 0.02) & (y > 0.12) & (y < 0.45)] = solid
    for height, left, right in ((0.62, 0.3, 0.52), (0.76, 0.5, 0.74)):
        ledge = np.abs(y - height - 0.25 * (x - left)) < 0.012
        cells[ledge & (x > left) & (x < right)] = solid
    full = (slope < -0.02) & (y > 0.15) & (y < 0.4) & (rng.random((size, size)) < 0.9)
    colour = 1 + ((y - 0.15) / 0.25 * 3).astype(np.int32).clip(0, 2)
    cells[full] = colour[full]
    colours = GRAIN_BRIGHTNESS * np.array([*GRAIN_COLOURS, (0.0, 0.0, 0.0)])
    return Sand(cells, np.floor(colours * 255 + 0.5).astype(np.uint8))


def sand_canvas(cells: np.ndarray, scale: int) -> np.ndarray:
    """(scale h, scale w, 4) bytes: a solid cell hides light, a grain glows in its colour."""
    return hourglass()._replace(cells=cells).rgba().repeat(scale, 0).repeat(scale, 1)


def sand_frames(
    count: int = SAND_FRAMES, every: int = SAND_FRAME_STEPS, size: int = SAND_SIZE
) -> list[np.ndarray]:
    """``count`` states (size, size) of the falling sand, ``every`` frames apart."""
    return list(falling_sand(hourglass(size).cells, count, SAND_SEED, every))


CANVASES = {
    "plane_stroke": (
        stroke, PlaneTruth(140.0, 40.0, ARTICLE_SUN, ARTICLE_SKY, 0.87),
        "the source's demonstration",
    ),
    "plane_window": (
        window, PlaneTruth(155.0, 25.0, (9.0, 8.4, 7.2), (0.25, 0.4, 0.62), 0.8),
        "a shaft of light through a window, wider than high",
    ),
    "plane_maze": (
        maze, PlaneTruth(60.0, 70.0, (4.0, 3.7, 3.2), (0.35, 0.42, 0.7), 0.87),
        "far from the sky; most rays are short",
    ),
}  # fmt: skip
"""By name: the function that draws the canvas, its sky, and its purpose."""


def sand_truth(frame: int, frames: int) -> PlaneTruth:
    """The sky at one of ``frames`` frames: the sun passes overhead while the sand falls."""
    sun_angle = 150.0 - 120.0 * frame / (frames - 1)
    return PlaneTruth(sun_angle, 45.0, (0.7, 0.65, 0.55), ARTICLE_SKY, 1.0)

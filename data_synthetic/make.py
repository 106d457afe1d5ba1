"""Draws the synthetic targets: masks by formula, true parameters, and the pictures they make.

    python data_synthetic/make.py [FOLDER]

Each mask is rounded to bytes before anything is rendered from it, so the parameters in the table
below are exactly those of the picture. Pictures are rendered by the reference sum in float64 and
rounded once. ``x.toml`` tells the command line about ``x.png``; manifest.json holds the truth.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from godfit.image import atomic_write, write_image
from godfit.models import Mitchell
from godfit.radial.reference import bilinear

HERE = Path(__file__).parent
GOLDEN = (5**0.5 - 1) / 2  # multiples of it, modulo 1, look scattered without being random


class Canvas:
    """A picture to paint on. x and y are in picture heights, y up, (0.5, 0.5) in the middle."""

    def __init__(self, height: int, width: int, value):
        u, v = (np.arange(width) + 0.5) / width, 1 - (np.arange(height) + 0.5) / height
        self.x, self.y = np.meshgrid((u - 0.5) * width / height + 0.5, v)
        self.pixel = 1 / height
        self.values = np.broadcast_to(value, (height, width, *np.shape(value)[-1:])).astype(float)

    def paint(self, distance, value, soft: float = 0.0) -> None:
        """Paint where ``distance`` (to a shape's edge, in heights) is negative. The edge is one
        pixel wide, or ``soft`` heights."""
        cover = np.clip(0.5 - distance / max(self.pixel, soft), 0, 1)
        cover = cover.reshape(cover.shape + (1,) * (self.values.ndim - 2))
        self.values += cover * (value - self.values)

    def disc(self, x: float, y: float, radius: float):
        return np.hypot(self.x - x, self.y - y) - radius

    def box(self, left: float, right: float, bottom: float, top: float):
        across = np.abs(self.x - (left + right) / 2) - (right - left) / 2
        return np.maximum(across, np.abs(self.y - (bottom + top) / 2) - (top - bottom) / 2)

    def bar(self, x: float, y: float, degrees: float, width: float):
        """An endless bar through (x, y)."""
        angle = np.deg2rad(degrees)
        across = (self.x - x) * np.sin(angle) - (self.y - y) * np.cos(angle)
        return np.abs(across) - width / 2

    def polar(self, x: float, y: float):
        return np.hypot(self.x - x, self.y - y), np.arctan2(self.y - y, self.x - x)


def disc(height: int, width: int):
    """A disc light on a faint veil behind a few bars."""
    c = Canvas(height, width, 0.04)
    c.paint(c.disc(0.56, 0.6, 0.15), 1.0)
    for x, y, degrees, thick in (
        (0.6, 0.64, 118, 0.03),
        (0.5, 0.56, 22, 0.04),
        (0.5, 0.6, 75, 0.02),
    ):
        c.paint(c.bar(x, y, degrees, thick), 0.0)
    return c.values


def bars(height: int, width: int):
    """A low sun and its glow behind a fence of uneven bars."""
    c = Canvas(height, width, 0.0)
    far = c.disc(0.38, 0.55, 0.0)
    c.values = 0.3 * np.exp(-((far / 0.45) ** 2))
    c.paint(far - 0.11, 1.0)
    for i in range(-4, 14):
        x = 0.115 * i + 0.03 * np.sin(2.4 * i)
        c.paint(c.bar(x, 0.5, 90 + 3 * np.sin(1.7 * i), 0.028 + 0.014 * (i * GOLDEN % 1)), 0.0)
    c.paint(c.bar(0.5, 0.3, 0, 0.035), 0.0)
    c.paint(c.y - 0.12, 0.0)
    return c.values


def window(height: int, width: int):
    """An arched window of small panes in a dark wall, brighter towards the sun behind it."""
    c = Canvas(height, width, 0.02)
    arch = np.where(
        c.y > 0.62, c.disc(0.4, 0.62, 0.24), np.maximum(np.abs(c.x - 0.4) - 0.24, 0.3 - c.y)
    )
    c.paint(arch, 0.35 + 0.65 * np.exp(-((c.disc(0.46, 0.66, 0) / 0.2) ** 2)))
    for x in (0.28, 0.4, 0.52):
        c.paint(c.bar(x, 0.5, 90, 0.02), 0.02)
    for y in (0.42, 0.54, 0.66, 0.78):
        c.paint(c.bar(0.4, y, 0, 0.016), 0.02)
    return c.values


def trees(height: int, width: int):
    """Trunks and crowns against a bright sky with a sun."""
    c = Canvas(height, width, 0.0)
    c.values = 0.1 + 0.25 * np.clip(c.y, 0, 1)
    c.paint(c.disc(0.62, 0.64, 0.075), 1.0)
    for i, x in enumerate((-0.28, -0.08, 0.1, 0.29, 0.5, 0.74, 0.93, 1.12, 1.3)):
        lean, thick = 0.04 * np.sin(3.1 * i), 0.022 + 0.02 * (i * GOLDEN % 1)
        c.paint(np.abs(c.x - x - lean * c.y) - thick * (1.2 - c.y) / 1.2, 0.0)
        for k in range(14):
            angle, out = 2.4 * k + i, 0.035 * k**0.5
            at = x + lean + out * np.cos(angle), 0.83 + 0.05 * np.sin(2 * i) + out * np.sin(angle)
            c.paint(c.disc(*at, 0.022 + 0.016 * (k * GOLDEN % 1)), 0.0)
    c.paint(c.y - 0.13 - 0.025 * np.sin(5 * c.x) - 0.008 * np.sin(41 * c.x), 0.0)
    return c.values


def ring(height: int, width: int):
    """An eclipse: a ring brighter on one side, and stars."""
    c = Canvas(height, width, 0.0)
    far, angle = c.polar(0.47, 0.53)
    c.values = (
        0.45
        * np.exp(-np.maximum(far - 0.17, 0) / 0.05)
        * (1 + 0.4 * np.sin(7 * angle) * np.sin(3 * angle))
    )
    c.paint(far - 0.185, 0.65 + 0.35 * np.cos(angle - 0.6))
    c.paint(far - 0.16, 0.0)
    for k in range(1, 40):
        c.paint(c.disc(k * GOLDEN % 1, k * GOLDEN * 7.3 % 1, 0.003 + 0.002 * (k % 3)), 0.5)
    return c.values


def two_lights(height: int, width: int):
    """Two lamps, one larger, behind crossed rods."""
    c = Canvas(height, width, 0.02)
    c.paint(c.disc(0.1, 0.62, 0.12), 1.0)
    c.paint(c.disc(0.95, 0.45, 0.085), 0.85)
    for x, degrees, thick in (
        (0.06, 82, 0.03),
        (0.15, 108, 0.02),
        (0.5, 12, 0.035),
        (0.92, 65, 0.02),
        (0.98, 98, 0.025),
    ):
        c.paint(c.bar(x, 0.53, degrees, thick), 0.0)
    return c.values


def skyline(height: int, width: int):
    """Towers against a sky that brightens towards a sun outside the picture, top left."""
    c = Canvas(height, width, 0.0)
    c.values = 0.06 + 0.9 * np.exp(-((c.disc(-0.02, 1.05, 0) / 0.55) ** 2))
    for i in range(-3, 12):
        left, wide = 0.125 * i + 0.02 * np.sin(5 * i), 0.07 + 0.05 * (i * GOLDEN % 1)
        top = 0.3 + 0.42 * (i * i * GOLDEN % 1)
        c.paint(c.box(left, left + wide, -0.1, top), 0.0)
        c.paint(c.box(left + wide / 2 - 0.006, left + wide / 2 + 0.006, top - 0.1, top + 0.09), 0.0)
    return c.values


def fan(height: int, width: int):
    """A light behind the blades of a fan in a wall."""
    c = Canvas(height, width, 0.015)
    far, angle = c.polar(0.5, 0.5)
    c.paint(far - 0.3, 0.25 + 0.75 * np.exp(-((c.disc(0.54, 0.56, 0) / 0.16) ** 2)))
    c.paint(np.maximum(-np.sin(5 * (angle + 1.4 * far)) * far / 5 - 0.01, far - 0.27), 0.0)
    c.paint(far - 0.055, 0.0)
    return c.values


def peaks(height: int, width: int):
    """A sun that sets behind mountains, as the light pass sees it: no sky."""
    c = Canvas(height, width, 0.0)
    c.paint(c.disc(0.55, 0.56, 0.1), 1.0)
    c.paint(c.disc(0.55, 0.56, 0.16), np.maximum(c.values, 0.12), soft=0.12)
    c.paint(c.y - ridge(c.x), 0.0)
    return c.values


def ridge(x):
    """Height of the mountains."""
    saw = lambda period, at: np.abs((x - at) / period % 1 - 0.5) * 2
    return 0.36 + 0.2 * saw(0.52, 0.3) + 0.06 * saw(0.17, 0.02) + 0.02 * saw(0.061, 0.0)


def dusk(height: int, width: int):
    """The ordinary picture of ``peaks``: an evening sky, the sun, and two ranges."""
    c = Canvas(height, width, [0.0, 0.0, 0.0])
    up = np.clip((c.y - 0.35) / 0.65, 0, 1)[..., None]
    c.values = (1 - up) * [0.62, 0.3, 0.18] + up * [0.1, 0.14, 0.32]
    c.paint(c.disc(0.55, 0.56, 0.1), np.array([0.85, 0.65, 0.4]))
    c.paint(c.y - ridge(c.x), np.array([0.09, 0.07, 0.12]))
    c.paint(c.y - 0.7 * ridge(1.3 * c.x + 0.4), np.array([0.035, 0.03, 0.05]))
    return c.values


def rose(height: int, width: int):
    """A rose window: rings of round panes."""
    c = Canvas(height, width, 0.03)
    c.paint(c.disc(0.5, 0.5, 0.065), 1.0)
    for count, out, radius, value in (
        (8, 0.15, 0.048, 0.9),
        (12, 0.265, 0.055, 0.6),
        (24, 0.355, 0.022, 0.8),
    ):
        for k in range(count):
            angle = 2 * np.pi * (k + 0.3) / count
            c.paint(c.disc(0.5 + out * np.cos(angle), 0.5 + out * np.sin(angle), radius), value)
    return c.values


def glass(height: int, width: int):
    """Leaded glass in warm colours: each pane is what lies nearest to its seed."""
    c = Canvas(height, width, [0.02, 0.015, 0.01])
    seeds = [
        (0.5 + 0.058 * k**0.5 * np.cos(2.4 * k), 0.5 + 0.058 * k**0.5 * np.sin(2.4 * k))
        for k in range(40)
    ]
    far = np.stack([c.disc(x, y, 0) for x, y in seeds])
    near = np.sort(far, 0)
    hues = np.array([[1.0, 0.72, 0.3], [0.95, 0.4, 0.12], [1.0, 0.88, 0.6], [0.75, 0.18, 0.1]])
    pane = (
        hues[np.argmin(far, 0) * 7 % 4]
        * (0.25 + 0.75 * np.exp(-(((near[0] * 0 + c.disc(0.56, 0.57, 0)) / 0.2) ** 2)))[..., None]
    )
    c.paint(np.maximum(c.disc(0.5, 0.5, 0.33), 0.007 - (near[1] - near[0]) / 2), pane)
    return c.values


def barn(height: int, width: int):
    """Chinks between the boards of a wall, a knothole, and daylight behind."""
    c = Canvas(height, width, 0.0)
    day = 0.3 + 0.7 * np.exp(-((c.disc(0.44, 0.58, 0) / 0.28) ** 2))
    for i in range(-4, 14):
        thick = 0.004 + 0.016 * (i * GOLDEN % 1)
        c.paint(
            np.maximum(
                c.bar(0.11 * i + 0.01, 0.5, 90 + 1.5 * np.sin(2 * i), thick),
                np.abs(c.y - 0.52) - 0.36,
            ),
            day,
        )
    for x, y, radius in ((0.405, 0.6, 0.03), (0.71, 0.33, 0.018), (0.17, 0.73, 0.014)):
        c.paint(c.disc(x, y, radius), day)
    for y in (0.3, 0.74):
        c.paint(c.bar(0.5, y, 2, 0.05), 0.0)
    return c.values


def asteroids(height: int, width: int):
    """A small white sun among tumbling rocks."""
    c = Canvas(height, width, 0.0)
    c.values = 0.1 * np.exp(-c.disc(0.64, 0.58, 0) / 0.3)
    c.paint(c.disc(0.64, 0.58, 0.1), 1.0)
    for k in range(1, 46):
        out = 0.05 + 0.115 * k**0.5
        x, y = 0.64 + out * np.cos(2.4 * k + 0.5), 0.58 + out * np.sin(2.4 * k + 0.5)
        far, angle = c.polar(x, y)
        c.paint(
            far
            - (0.018 + 0.03 * (k * GOLDEN % 1))
            * (1 + 0.2 * np.sin(2 * angle + k) + 0.1 * np.sin(5 * angle)),
            0.0,
        )
    return c.values


def target(
    draw,
    size,
    shader,
    samples,
    note,
    exposure,
    light,
    decay=None,
    density=None,
    weight=None,
    mask_size=None,
    background=None,
):
    return locals()


TARGETS = {
    "disc": target(
        disc,
        (256, 256),
        "dawntime",
        100,
        "The README's example: nothing clever, everything determined.",
        0.11,
        [(0.56, 0.6)],
        0.97,
        0.9,
        0.5,
    ),
    "bars": target(
        bars,
        (200, 320),
        "mitchell",
        100,
        "A wide frame and thin bars.",
        0.1,
        [(0.425, 0.55)],
        0.965,
        0.85,
        0.6,
    ),
    "window": target(
        window,
        (256, 256),
        "vesper",
        150,
        "A regular grid, which repeats itself along the rays.",
        0.05,
        [(0.46, 0.66)],
        0.985,
        0.75,
        0.7,
    ),
    "trees": target(
        trees,
        (256, 320),
        "article-glsl",
        100,
        "Fine detail against a bright sky.",
        0.2,
        [(0.6, 0.64)],
        0.968,
        0.926,
        0.58767,
    ),
    "ring": target(ring, (256, 256), "three", 18, "three", 0.69, [(0.5, 0.5)]),
    "two_lights": target(
        two_lights,
        (192, 288),
        "mitchell",
        80,
        "Two lights",
        0.1,
        [(0.24, 0.62), (0.8, 0.45)],
        0.96,
        0.9,
        0.6,
    ),
    "offscreen": target(
        skyline,
        (256, 256),
        "mitchell",
        100,
        "The light is outside the frame, where no pixel shows it.",
        0.05,
        [(-0.12, 1.2)],
        0.975,
        0.8,
        0.6,
    ),
    "halfres": target(
        fan,
        (256, 256),
        "dawntime",
        200,
        "The light pass is half",
        0.05,
        [(0.54, 0.56)],
        0.985,
        0.8,
        0.8,
        mask_size=(128, 128),
    ),
    "background": target(
        peaks,
        (256, 256),
        "babylon",
        100,
        "A composite",
        0.3,
        [(0.55, 0.56)],
        0.96815,
        0.926,
        0.58767,
        background=dusk,
    ),
    "clipped": target(
        rose,
        (256, 256),
        "vesper",
        120,
        "A tenth of the pixels is clipped to 255.",
        0.09,
        [(0.5, 0.5)],
        0.975,
        0.85,
        0.8,
    ),
    "coloured": target(
        glass, (240, 240), "dawntime", 120, "Three channels", 0.08, [(0.56, 0.57)], 0.975, 0.85, 0.6
    ),
    "decay_one": target(
        barn,
        (256, 256),
        "mitchell",
        100,
        "Decay and density are exactly 1",
        0.1,
        [(0.44, 0.58)],
        1.0,
        1.0,
        0.1,
    ),
    "pmndrs": target(
        asteroids, (216, 384), "pmndrs", 60, "No own pixel", 0.6, [(0.58, 0.58)], 0.93, 0.96, 0.3
    ),
}


def to_bytes(values):
    """Values rounded to bytes as a PNG rounds them, half up."""
    return np.floor(np.clip(values, 0, 1) * 255 + 0.5) / 255


def render(t, mask, background):
    known = {k: t[k] or 1.0 for k in ("exposure", "decay", "density", "weight", "light")}
    model = Mitchell(**known, shader=t["shader"], samples=t["samples"])
    if t["mask_size"] is None:
        behind = None if background is None else jnp.asarray(background)
        return np.asarray(model(jnp.asarray(mask), behind, method="reference"))
    small = jnp.asarray(to_bytes(model(jnp.asarray(mask), method="reference")))
    (h, w), (height, width) = small.shape, t["size"]
    x, y = np.meshgrid(
        (np.arange(width) + 0.5) * w / width - 0.5, (np.arange(height) + 0.5) * h / height - 0.5
    )
    return np.asarray(bilinear(small, jnp.asarray(x), jnp.asarray(y)))


def make(folder):
    import time

    for name, t in TARGETS.items():
        t0 = time.time()
        mask = to_bytes(t["draw"](*(t["mask_size"] or t["size"])))
        b = t["background"] and to_bytes(t["background"](*t["size"]))
        im = render(t, mask, b)
        write_image(folder / f"{name}.png", im)
        write_image(folder / f"{name}_mask.png", mask)
        if b is not None:
            write_image(folder / f"{name}_background.png", b)
        print(
            name,
            "clipped %.3f" % (im >= 254.5 / 255).mean(),
            "max %.2f" % im.max(),
            "mean %.2f" % im.mean(),
            "%.2fs" % (time.time() - t0),
        )


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)

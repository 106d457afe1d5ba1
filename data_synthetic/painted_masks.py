"""The masks and the background of the synthetic targets, painted by formula.

A function draws a mask (height, width), one channel or three, linear; its name is its subject.
"""

from __future__ import annotations

import numpy as np

GOLDEN_FRACTION = (5**0.5 - 1) / 2
"""Its multiples, modulo 1, look scattered without being random."""


def scattered(k: int) -> float:
    """The k-th of numbers from 0 to 1 that look scattered."""
    return k * GOLDEN_FRACTION % 1


class Painting:
    """Values (height, width) or (height, width, 3) to paint over. ``x`` and ``y`` are in picture
    heights, y up, (0.5, 0.5) in the middle.

    The methods that draw shapes return the distance to the shape's edge, negative inside; ``glow``
    and ``angle`` are fields.
    """

    def __init__(self, height: int, width: int, value: float | list[float] = 0.0):
        u, v = (np.arange(width) + 0.5) / width, 1 - (np.arange(height) + 0.5) / height
        self.x, self.y = np.meshgrid((u - 0.5) * width / height + 0.5, v)
        self.values = np.broadcast_to(value, (height, width, *np.shape(value))).astype(float)

    def paint(self, distance, value: float | list[float] | np.ndarray = 0.0) -> None:
        """Paint where ``distance`` to a shape's edge (in heights) is negative; the edge is one
        pixel wide."""
        coverage = np.clip(0.5 - distance * len(self.x), 0, 1)
        coverage = coverage.reshape(coverage.shape + (1,) * (self.values.ndim - 2))
        self.values += coverage * (value - self.values)

    def disc(self, x: float, y: float, radius: float | np.ndarray = 0.0):
        return np.hypot(self.x - x, self.y - y) - radius

    def glow(self, x: float, y: float, width: float):
        """A Gaussian about (x, y), 1 in the middle and 1/e at ``width``."""
        return np.exp(-((self.disc(x, y) / width) ** 2))

    def angle(self, x: float, y: float):
        """Radians about (x, y), counterclockwise from the right."""
        return np.arctan2(self.y - y, self.x - x)

    def bar(self, x: float, y: float, degrees: float, width: float):
        """An endless bar through (x, y), at an angle in degrees to the x axis."""
        turn = np.deg2rad(degrees)
        across = (self.x - x) * np.sin(turn) - (self.y - y) * np.cos(turn)
        return np.abs(across) - width / 2

    def upright(self, x: float, bottom: float, top: float, width: float):
        """A vertical bar of some height."""
        return np.maximum(np.abs(self.x - x) - width / 2, np.maximum(bottom - self.y, self.y - top))


def disc(height: int, width: int) -> np.ndarray:
    """A disc light on a faint veil behind a few bars."""
    c = Painting(height, width, 0.04)
    c.paint(c.disc(0.56, 0.6, 0.14), 1.0)
    for x, y, degrees, thick in (
        (0.61, 0.6, 112, 0.03), (0.5, 0.55, 22, 0.035),
        (0.49, 0.6, 75, 0.02), (0.6, 0.68, 155, 0.02),
    ):  # fmt: skip
        c.paint(c.bar(x, y, degrees, thick))
    return c.values


def bars(height: int, width: int) -> np.ndarray:
    """A low sun and its glow behind a fence of uneven bars."""
    c = Painting(height, width)
    c.values += 0.4 * c.glow(0.38, 0.52, 0.4)
    c.paint(c.disc(0.38, 0.52, 0.14), 1.0)
    for i in range(-4, 14):
        x, thick = 0.16 * i + 0.02 * np.sin(2.4 * i), 0.02 + 0.035 * scattered(i)
        c.paint(c.bar(x - 0.02, 0.5, 90 + 8 * np.sin(1.7 * i), thick))
    c.paint(c.bar(0.5, 0.36, 1.5, 0.03))
    c.paint(c.bar(0.5, 0.78, -1, 0.03))
    c.paint(c.y - 0.1)
    return c.values


def window(height: int, width: int) -> np.ndarray:
    """An arched window of small panes in a dark wall, brighter towards the sun behind it."""
    c = Painting(height, width, 0.02)
    arch = np.where(c.y > 0.62, c.disc(0.4, 0.62, 0.24), c.upright(0.4, 0.3, 0.7, 0.48))
    c.paint(arch, 0.25 + 0.75 * c.glow(0.46, 0.6, 0.14))
    for offset in (-0.12, 0.0, 0.12):
        c.paint(c.bar(0.4 + offset, 0.5, 90, 0.02), 0.02)
        c.paint(c.bar(0.4, 0.54 + offset, 0, 0.016), 0.02)
    c.paint(c.bar(0.4, 0.78, 0, 0.016), 0.02)
    return c.values


def trees(height: int, width: int) -> np.ndarray:
    """Trunks and crowns against a bright sky with a sun."""
    c = Painting(height, width)
    c.values += 0.05 + 0.1 * c.y
    c.paint(c.disc(0.6, 0.7, 0.11), 1.0)
    for i, x in enumerate((-0.28, -0.08, 0.1, 0.29, 0.5, 0.66, 0.9, 1.08, 1.28)):
        lean, thick = 0.04 * np.sin(3.1 * i), 0.016 + 0.016 * scattered(i)
        c.paint(np.abs(c.x - x - lean * c.y) - thick * (1.2 - c.y))
        for k in range(34):  # leaves on a spiral
            turn, out = 2.4 * k + i, 0.024 * k**0.5
            up = 0.82 + 0.06 * np.sin(2 * i) + 0.8 * out * np.sin(turn)
            c.paint(c.disc(x + lean + out * np.cos(turn), up, 0.008 + 0.016 * scattered(k)))
    c.paint(c.y - 0.13 - 0.025 * np.sin(5 * c.x) - 0.008 * np.sin(41 * c.x))
    return c.values


def ring(height: int, width: int) -> np.ndarray:
    """A big wheel, dark against a bright sky."""
    c = Painting(height, width, 1.0)
    for radius in (0.33, 0.28):
        c.paint(np.abs(c.disc(0.5, 0.54, radius)) - 0.012)
    for k in range(16):
        turn = 2 * np.pi * (k + 0.3) / 16
        x, y = 0.5 + 0.33 * np.cos(turn), 0.54 + 0.33 * np.sin(turn)
        c.paint(np.maximum(c.bar(0.5, 0.54, np.rad2deg(turn), 0.01), c.disc(0.5, 0.54, 0.33)))
        c.paint(c.disc(x, y - 0.03, 0.034))
    for degrees in (68, 112):
        c.paint(np.maximum(c.bar(0.5, 0.54, degrees, 0.03), c.y - 0.54))
    c.paint(c.disc(0.5, 0.54, 0.035))
    c.paint(c.y - 0.09 - 0.012 * np.sin(19 * c.x))
    return c.values


def two_lights(height: int, width: int) -> np.ndarray:
    """Two lamps, one larger, behind crossed rods."""
    c = Painting(height, width, 0.01)
    c.paint(c.disc(0.11, 0.6, 0.15), 1.0)
    c.paint(c.disc(0.95, 0.45, 0.11), 0.8)
    for x, degrees, thick in (
        (0.06, 80, 0.03), (0.17, 112, 0.025), (0.5, 10, 0.035), (0.9, 65, 0.025), (0.99, 100, 0.02)
    ):  # fmt: skip
        c.paint(c.bar(x, 0.53, degrees, thick))
    c.paint(c.bar(0.1, 0.63, 30, 0.02))
    c.paint(c.bar(0.95, 0.47, 140, 0.015))
    return c.values


def skyline(height: int, width: int) -> np.ndarray:
    """Broken cloud and towers; the sun is outside the frame, top left."""
    c = Painting(height, width)
    c.values += 0.03 + 0.97 * c.glow(-0.02, 1.05, 0.5)
    for k in range(60):  # cloud: small discs in a band that slopes with the sun's side
        along = scattered(k)
        c.paint(c.disc(1.1 * along - 0.05, 0.78 + 0.2 * (k / 60) - 0.1 * along,
                       0.012 + 0.03 * scattered(k * k)))  # fmt: skip
    for i in range(-3, 12):
        thick, top = 0.05 + 0.05 * scattered(i), 0.12 + 0.3 * scattered(i * i)
        c.paint(c.upright(0.11 * i, -0.1, top, thick))
        c.paint(c.upright(0.11 * i, -0.1, top + 0.07, 0.012))
    return c.values


def fan(height: int, width: int) -> np.ndarray:
    """A light behind the blades of a fan in a wall."""
    c = Painting(height, width, 0.015)
    far = c.disc(0.5, 0.5)
    c.paint(far - 0.3, 0.25 + 0.75 * c.glow(0.54, 0.56, 0.16))
    blades = -np.sin(5 * (c.angle(0.5, 0.5) + 1.4 * far)) * far / 5 - 0.01
    c.paint(np.maximum(blades, far - 0.27))
    c.paint(far - 0.055)
    return c.values


def land(c: Painting):
    """Mountains and three tall rocks: the distance to their edge, negative inside."""
    edge = c.y - 0.34
    for height, period, peak in ((0.2, 0.52, 0.3), (0.06, 0.17, 0.02), (0.02, 0.061, 0.0)):
        edge = edge - height * np.abs((c.x - peak) / period % 1 - 0.5) * 2
    for x, top, slope in ((0.53, 0.64, 0.1), (0.61, 0.6, 0.12), (0.45, 0.61, 0.08)):
        rough = 0.004 * np.sin(70 * c.y + 9 * x) + 0.012 * np.sin(13 * c.y)
        edge = np.minimum(edge, np.abs(c.x - x + rough) - slope * (top - c.y))
    return edge


def peaks(height: int, width: int) -> np.ndarray:
    """A sun setting behind mountains, as the light pass has it: without the sky."""
    c = Painting(height, width)
    c.values += 0.4 * c.glow(0.55, 0.56, 0.16)
    c.paint(c.disc(0.55, 0.56, 0.09), 1.0)
    c.paint(land(c))
    return c.values


def dusk(height: int, width: int) -> np.ndarray:
    """The ordinary picture for ``peaks``: an evening sky, the sun and two ranges, in colour."""
    c = Painting(height, width, [0.0, 0.0, 0.0])
    up = np.clip((c.y - 0.35) / 0.65, 0, 1)[..., None]
    c.values += (1 - up) * [0.45, 0.2, 0.12] + up * [0.05, 0.08, 0.24]
    c.paint(c.disc(0.55, 0.56, 0.09), [0.7, 0.5, 0.25])
    c.paint(land(c), [0.07, 0.055, 0.1])
    near = 0.2 + 0.06 * np.sin(6 * c.x + 1) + 0.02 * np.sin(17 * c.x) + 0.004 * np.sin(90 * c.x)
    c.paint(c.y - near, [0.03, 0.025, 0.045])
    return c.values


def rose(height: int, width: int) -> np.ndarray:
    """A rose window: rings of round panes."""
    c = Painting(height, width, 0.03)
    c.paint(c.disc(0.5, 0.5, 0.065), 1.0)
    for count, out, radius, value in (
        (8, 0.15, 0.048, 0.9), (12, 0.265, 0.055, 0.6), (24, 0.355, 0.022, 0.8)
    ):  # fmt: skip
        for turn in 2 * np.pi * (np.arange(count) + 0.3) / count:
            c.paint(c.disc(0.5 + out * np.cos(turn), 0.5 + out * np.sin(turn), radius), value)
    return c.values


def glass(height: int, width: int) -> np.ndarray:
    """Leaded glass in warm colours: a pane is the cell of its seed on a spiral (Voronoi)."""
    c = Painting(height, width, [0.02, 0.015, 0.01])
    far = np.stack([
        c.disc(0.5 + 0.058 * k**0.5 * np.cos(2.4 * k), 0.5 + 0.058 * k**0.5 * np.sin(2.4 * k))
        for k in range(40)
    ])  # fmt: skip
    nearest, next_nearest = np.sort(far, axis=0)[:2]
    hues = np.array([[1.0, 0.72, 0.3], [0.95, 0.4, 0.12], [1.0, 0.88, 0.6], [0.75, 0.18, 0.1]])
    light = 0.25 + 0.75 * c.glow(0.56, 0.57, 0.2)[..., None]
    pane = np.maximum(c.disc(0.5, 0.5, 0.33), 0.007 - (next_nearest - nearest) / 2)
    c.paint(pane, hues[np.argmin(far, axis=0) * 7 % 4] * light)
    return c.values


def barn(height: int, width: int) -> np.ndarray:
    """Daylight through the chinks between boards, and through holes in them."""
    c = Painting(height, width)
    day = 0.25 + 0.75 * c.glow(0.44, 0.58, 0.3)
    for i in range(-3, 8):
        thick = 0.008 + 0.022 * scattered(i)
        chink = c.bar(0.18 * i - 0.01, 0.5, 90 + 2 * np.sin(2 * i), thick)
        c.paint(np.maximum(chink, np.abs(c.y - 0.5) - 0.42), day)
    c.paint(c.disc(0.44, 0.58, 0.06 * (1 + 0.15 * np.sin(3 * c.angle(0.44, 0.58)))), day)
    for x, y, radius in ((0.6, 0.24, 0.03), (0.26, 0.82, 0.025), (0.8, 0.68, 0.035)):
        c.paint(c.disc(x, y, radius), day)
    c.paint(c.bar(0.5, 0.36, 2, 0.05))
    c.paint(c.bar(0.44, 0.57, 38, 0.012))
    return c.values


def asteroids(height: int, width: int) -> np.ndarray:
    """A white sun among tumbling rocks."""
    c = Painting(height, width)
    c.values += 0.3 * np.exp(-c.disc(0.64, 0.58) / 0.35)
    c.paint(c.disc(0.64, 0.58, 0.13), 1.0)
    for k in range(1, 80):
        out = 0.09 * k**0.5
        x, y = 0.64 + out * np.cos(2.4 * k + 0.5), 0.58 + out * np.sin(2.4 * k + 0.5)
        rough = 1 + 0.2 * np.sin(2 * c.angle(x, y) + k) + 0.1 * np.sin(5 * c.angle(x, y))
        c.paint(c.disc(x, y, (0.024 + 0.024 * scattered(k)) * rough))
    return c.values

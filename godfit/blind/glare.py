"""Starting points from the outline of glare.

What is clipped says nothing of how bright it is, and where all else is dark the screening has
nothing to go by. But where no shadow falls a disc's glow is as bright all around: the outline of
what is clipped lies on circles about the light. They are found by consensus (Fischler & Bolles,
Comm. ACM 24 (1981), 381): of many circles through three of its pixels, those that pass most others.
"""

from __future__ import annotations

import itertools

import numpy as np

from godfit.blind.consensus import passed_by
from godfit.blind.segment import grown
from godfit.inference.observation import Picture
from godfit.io.filters import over_channels
from godfit.io.image import LEVELS

# Circles that are tried, kept, and the share of the outline that these pass at least.
TRIES, KEEP, LEAST = 4000, 2, 0.2
# Pixels of the outline, most and least, and how near a circle passes, in pixels and as a share
# of the height, whichever is more.
OUTLINE, FEW, NEAR, SHARE = 1000, 40, 1.0, 1 / 300
# Levels by which a glow is fainter one pixel farther away, most.
STEP = 24.0
# Lights that are no farther outside the picture, and radii, in picture heights.
MARGIN, RADII = 0.3, (0.03, 1.0)
# What a disc may be like of whose glow such a circle is where it clips: density, attenuation, and
# by how much farther away the disc is seen at all.
DENSITIES, KAPPAS, FARTHER = (0.5, 0.65, 0.8, 0.9, 0.97), (0.5, 2.5), (1.03, 1.2)
# Of what the disc adds, the veil's share.
VEILED = 0.1
STEPS = 64


def circles(picture: Picture, seed: int, keep: int = KEEP) -> np.ndarray:
    """(n, 3) circles that the outlines of where any channel is clipped and of where all are lie on,
    at most so many (``keep``) of each: middles in texture coordinates, radii in picture heights."""
    white = over_channels(np.logical_and, picture.levels >= LEVELS - picture.half)
    outlines = (
        (picture.clipped, over_channels(np.maximum, picture.levels)),
        (white, over_channels(np.minimum, picture.levels)),
    )
    each = [_around(picture, *outline, seed, keep) for outline in outlines]
    return np.concatenate(each if np.any(white != picture.clipped) else each[:1])


def _around(
    picture: Picture, glare: np.ndarray, levels: np.ndarray, seed: int, keep: int
) -> np.ndarray:
    """Those of one outline, of ``glare`` (h, w), where what is beside it is nearly as bright, in
    ``levels`` (h, w): a sun ends at once, and so does what an object or its shadow cuts off."""
    h, w = picture.size
    faint = picture.valid & ~glare & (levels >= LEVELS - STEP)
    rows, columns = np.nonzero(glare & picture.valid & grown(faint))
    if len(rows) < FEW:
        return np.zeros((0, 3))
    rng = np.random.default_rng(seed)
    some = rng.permutation(len(rows))[:OUTLINE]
    x, y = (columns[some] + 0.5) / h, 1 - (rows[some] + 0.5) / h
    three = rng.integers(0, len(x), (TRIES, 3))
    found = _through(x[three], y[three])
    u, v, radius = found.T
    outside = np.maximum(np.abs(u * h / w - 0.5), np.abs(v - 0.5)) > 0.5 + MARGIN
    # None of a triple on a line, or of one pixel twice, is a number.
    found = found[(RADII[0] < radius) & (radius < RADII[1]) & ~outside]
    passed = passed_by(found, x, y, max(NEAR / h, SHARE))
    kept: list[np.ndarray] = []
    for i in np.argsort(-passed):
        if len(kept) == keep or passed[i] < LEAST * len(x):
            break
        if all(np.abs(found[i] - other).max() > 0.05 for other in kept):
            kept.append(found[i])
    return np.array(kept).reshape(-1, 3) * (h / w, 1, 1)


def _through(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(n, 3) middles and radii of the circles through three points each, (n, 3) in x and y."""
    bx, by = x[:, 1] - x[:, 0], y[:, 1] - y[:, 0]
    cx, cy = x[:, 2] - x[:, 0], y[:, 2] - y[:, 0]
    b, c = bx**2 + by**2, cx**2 + cy**2
    with np.errstate(divide="ignore", invalid="ignore"):
        twice = 2 * (bx * cy - by * cx)
        u, v = (cy * b - by * c) / twice, (bx * c - cx * b) / twice
    return np.stack([x[:, 0] + u, y[:, 0] + v, np.hypot(u, v)], 1)


def starts(picture: Picture, seed: int) -> list[dict[str, float]]:
    """Lights in the middle of such circles, as ``screen_disc.starts`` gives them: discs whose glow
    clips where the circle is."""
    levels = picture.levels[picture.valid & ~picture.clipped]
    room = 1 - float(np.median(levels)) / LEVELS if len(levels) else 1.0
    found = []
    for (u, v, clips), density, kappa, farther in itertools.product(
        circles(picture, seed), DENSITIES, KAPPAS, FARTHER
    ):
        radius = clips * farther * (1 - density)
        # As far along the ray as the disc begins.
        t = np.linspace(1 - radius / clips, density, STEPS)
        gain = room / max(float(np.exp(-kappa * t).mean()) * (t[-1] - t[0]), 1e-3)
        found.append(
            {
                "light_x": float(u),
                "light_y": float(v),
                "radius": float(radius),
                "kappa": float(kappa),
                "density": float(density),
                "gain": gain,
                "veil_gain": VEILED * gain,
            }
        )
    return found

"""Light in the plane by other means: geometry pixel by pixel in numpy, and closed forms."""

import numpy as np


def crossings(shape, row, column, angle):
    """Pixels that a ray from a pixel's middle crosses, by the borders it meets: (row, column)."""
    h, w = shape
    dx, dy = np.cos(angle), -np.sin(angle)
    x, y = column + 0.5, row + 0.5
    far = h + w
    columns, rows = np.arange(w + 1), np.arange(h + 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.concatenate([(columns - x) / dx, (rows - y) / dy])
    t = np.sort(t[np.isfinite(t) & (t > 0) & (t < far)])
    middle = (t[:-1] + t[1:]) / 2
    middle = middle[np.diff(t) > 1e-12]
    i, j = np.floor(y + middle * dy).astype(int), np.floor(x + middle * dx).astype(int)
    inside = (i >= 0) & (i < h) & (j >= 0) & (j < w)
    return i[inside], j[inside]


def reached(radiance, opacity, row, column, angles, beyond):
    """(3,) the mean over ``angles`` (radians) of what a pixel's rays see; ``beyond`` (n, 3)."""
    total = np.zeros(3)
    for angle, sky in zip(angles, beyond, strict=True):
        i, j = crossings(opacity.shape, row, column, angle)
        passing = np.concatenate([[1.0], np.cumprod(1 - opacity[i, j])])
        total += (passing[:-1, None] * radiance[i, j]).sum(0) + passing[-1] * sky
    return total / len(angles)


def random_canvas(size, seed, share=0.06, partial=True):
    """Blocks and single pixels, some of them lamps, some of them let light through."""
    h, w = size
    rng = np.random.default_rng(seed)
    opacity = (rng.random(size) < share).astype(float)
    for _ in range(3):
        i, j = rng.integers(0, h), rng.integers(0, w)
        opacity[i : i + rng.integers(1, h // 3 + 2), j : j + rng.integers(1, w // 3 + 2)] = 1
    if partial:
        opacity *= np.where(rng.random(size) < 0.3, rng.uniform(0.2, 0.9, size), 1.0)
    radiance = rng.uniform(0, 2, (h, w, 3)) * opacity[..., None]
    radiance *= (rng.random(size) < 0.4)[..., None]
    return radiance, opacity

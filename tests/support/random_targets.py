"""Random masks and truths: none of the masks is used anywhere else.

A truth is drawn over the whole range that a fit promises to recover, and its target is rendered by
the reference sum in float64, independently of the method that the fit uses, then rounded to bytes.
"""

from __future__ import annotations

import io

import numpy as np
from PIL import Image
from scipy import ndimage


def triangles(rng: np.random.Generator, size: int, light: np.ndarray) -> np.ndarray:
    """A disc light on a grey veil behind black triangles."""
    x, y = _grid(size)
    mask = np.full((size, size), rng.uniform(0.03, 0.12))
    mask[np.hypot(x - light[0], y - light[1]) < rng.uniform(0.05, 0.2)] = 1
    for _ in range(rng.integers(4, 12)):
        a, b, c = rng.uniform(0, 1, 2) + rng.uniform(-0.2, 0.2, (3, 2))
        inside = [
            np.sign((q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]))
            for p, q in ((a, b), (b, c), (c, a))
        ]
        mask[np.abs(sum(inside)) == 3] = 0
    return mask


def clouds(rng: np.random.Generator, size: int, light: np.ndarray) -> np.ndarray:
    """Soft noise, bright near the light."""
    x, y = _grid(size)
    noise = ndimage.gaussian_filter(rng.standard_normal((size, size)), size / rng.uniform(20, 60))
    noise = np.clip(0.5 + noise / noise.std() * 0.5, 0, 1)
    return noise * np.exp(-(np.hypot(x - light[0], y - light[1]) ** 2) / rng.uniform(0.05, 0.4))


def lattice(rng: np.random.Generator, size: int, light: np.ndarray) -> np.ndarray:
    """A bright sky behind crossed bars of random widths, none of them upright."""
    x, y = _grid(size)
    mask = np.full((size, size), rng.uniform(0.3, 1.0))
    for _ in range(rng.integers(5, 14)):
        angle, offset = rng.uniform(0, np.pi), rng.uniform(-0.7, 0.7)
        across = (x - 0.5) * np.cos(angle) + (y - 0.5) * np.sin(angle) - offset
        mask[np.abs(across) < rng.uniform(0.004, 0.03)] = 0
    mask[y < rng.uniform(0.0, 0.4)] *= rng.uniform(0, 0.3)
    return mask


def ellipses(rng: np.random.Generator, size: int, light: np.ndarray) -> np.ndarray:
    """A soft sun behind dark and half-transparent ellipses."""
    x, y = _grid(size)
    mask = np.exp(-(np.hypot(x - light[0], y - light[1]) ** 2) / rng.uniform(0.01, 0.1))
    mask = np.maximum(mask, rng.uniform(0.02, 0.2))
    for _ in range(rng.integers(5, 20)):
        u, v, angle = *rng.uniform(0, 1, 2), rng.uniform(0, np.pi)
        along = (x - u) * np.cos(angle) + (y - v) * np.sin(angle)
        across = (y - v) * np.cos(angle) - (x - u) * np.sin(angle)
        inside = np.hypot(along / rng.uniform(0.03, 0.15), across / rng.uniform(0.01, 0.06)) < 1
        mask[inside] *= rng.choice([0.0, 0.0, 0.5])
    return mask


def terrain(rng: np.random.Generator, size: int, light: np.ndarray) -> np.ndarray:
    """Black ridges before a graded sky."""
    x, y = _grid(size)
    mask = rng.uniform(0.1, 0.4) + rng.uniform(0.1, 0.6) * y
    for level in (0.15, 0.3, 0.45):
        waves = sum(
            rng.uniform(0, 0.3 / k) * np.sin(2 * np.pi * k * x + rng.uniform(0, 6.3))
            for k in range(1, 12)
        )
        mask[y < level * rng.uniform(0.5, 1.2) + 0.3 * waves] *= rng.uniform(0, 0.4)
    return mask


def maze(rng: np.random.Generator, size: int, light: np.ndarray) -> np.ndarray:
    """Bright and dark cells of a coarse grid, turned."""
    x, y = _grid(size)
    angle, cells = rng.uniform(0, np.pi), int(rng.integers(5, 16))
    along = (x - 0.5) * np.cos(angle) + (y - 0.5) * np.sin(angle) + 1
    across = (y - 0.5) * np.cos(angle) - (x - 0.5) * np.sin(angle) + 1
    values = rng.choice([0.0, 0.05, rng.uniform(0.3, 1)], (2 * cells, 2 * cells))
    return values[(along * cells).astype(int), (across * cells).astype(int)]


MASKS = {
    "triangles": triangles,
    "clouds": clouds,
    "lattice": lattice,
    "ellipses": ellipses,
    "terrain": terrain,
    "maze": maze,
}
# The last three were not looked at while the fit was made.
FRESH = ("ellipses", "terrain", "maze")


def _grid(size: int) -> tuple[np.ndarray, np.ndarray]:
    """u and v of the pixel centres."""
    centres = (np.arange(size) + 0.5) / size
    return np.meshgrid(centres, centres[::-1])


def render64(
    mask: np.ndarray, truth: dict[str, float], jitter: np.ndarray | float = 0.0
) -> np.ndarray:
    """Dawntime's light pass in float64, tap by tap, scipy's bilinear read: (h, w), unclamped. Taps
    lie ``jitter`` (h, w) of a step nearer to the pixel."""
    h, w = mask.shape
    n = int(truth["samples"])
    rows, columns = np.mgrid[:h, :w].astype(np.float64)
    light_x, light_y = truth["light_x"] * w - 0.5, (1 - truth["light_y"]) * h - 0.5
    out = mask.astype(np.float64)
    for i in range(1, n):
        t = (i - jitter) * truth["density"] / n
        at = [rows + t * (light_y - rows), columns + t * (light_x - columns)]
        read = ndimage.map_coordinates(mask, at, order=1, mode="nearest")
        out += truth["weight"] * truth["decay"] ** i * read
    return truth["exposure"] * out


def draw(
    seed: int, kind: str, size: int = 256, samples: int | None = None
) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
    """(mask as bytes, light pass unclamped (h, w) float64, truth) for a seed; the number of samples
    is drawn as well where none is given."""
    rng = np.random.default_rng([seed, list(MASKS).index(kind)])
    light = rng.uniform(-0.2, 1.2, 2)
    mask = np.floor(MASKS[kind](rng, size, light) * 255 + 0.5).clip(0, 255).astype(np.uint8)
    drawn = int(rng.integers(40, 201))
    samples = samples or drawn
    truth = {
        "decay": float(rng.uniform(0.001, 0.9) ** (1 / samples)),
        "density": float(rng.uniform(0.3, 1.0)),
        "weight": float(rng.uniform(0.2, 1.0)),
        "light_x": float(light[0]),
        "light_y": float(light[1]),
        "samples": samples,
        "exposure": 1.0,
    }
    linear = render64(mask / 255, truth)
    # Exposed so that a few pixels clip, as people set it.
    truth["exposure"] = float(rng.uniform(0.7, 1.2) / np.quantile(linear, 0.98))
    return mask, linear * truth["exposure"], truth


def to_bytes(image: np.ndarray, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    """8-bit image; ``noise`` is added before rounding, in levels."""
    levels = image * 255 + noise * np.random.default_rng(seed).standard_normal(image.shape)
    return np.floor(levels + 0.5).clip(0, 255).astype(np.uint8)


def enlarged(low: np.ndarray, size: int) -> np.ndarray:
    """(size, size) read bilinearly at pixel centres."""
    return np.asarray(
        ndimage.zoom(low, size / low.shape[0], order=1, mode="nearest", grid_mode=True)
    )


def encoded(levels: np.ndarray, quality: int) -> np.ndarray:
    """Bytes after a JPEG of that quality."""
    file = io.BytesIO()
    Image.fromarray(levels).save(file, "JPEG", quality=quality)
    return np.asarray(Image.open(file))

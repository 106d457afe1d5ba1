"""How much of a picture a light explains, and what no light does: texture."""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage

from godfit.inference.evaluate import predicted
from godfit.inference.observation import Picture
from godfit.io.filters import shrink
from godfit.models.background import TERM_COUNTS, terms
from godfit.models.bare_picture import AbstractBarePicture
from godfit.models.disc_light import DiscLight

# Longest side of the copy on which it is asked how much the light explains: fine texture is gone.
COPY = 60
# Noise, in levels, from which on a picture is textured.
TEXTURE = 1.0
# What varies less than so many levels is rounding.
VARIES = 0.1
# Pixels about which texture is averaged out, and of how many, in bands of how many rows, it is
# asked.
AROUND, FEW, BAND = 6, 1 << 19, 36


def explained(z, held, model: DiscLight, small: Picture, texture: float) -> float:
    """The share that the light at coordinates ``z`` (p,), ``held`` (p,) where not NaN, explains of
    what a smooth background alone would leave, in absolute deviations of the pixels whose light
    pass can be read; 1 is all, below 0 is worse than none. Where there is ``texture``, in levels,
    it is not asked for: nothing explains it."""
    # Cells of what the picture's own texels make: of a light beside the picture, coarse ones make
    # another.
    seen = small.observe(np.arange(small.size[0] * small.size[1]))
    made = np.asarray(predicted(z, held, model, seen)).reshape(*small.size, -1)
    small = small.shrunk(-(-max(small.size) // COPY))
    usable = np.flatnonzero(small.valid & ~small.clipped)
    if len(usable) < 50:
        return 0.0
    off = np.abs(small.levels - shrink(made, small.size))
    left = np.maximum(off - small.half, 0).max(-1).reshape(-1)[usable].mean()
    goal = small.levels.reshape(-1, small.channels)[usable].astype(np.float64)
    off = _off_background(goal, usable, small.size)
    alone = np.maximum(off - max(small.half, 0.5), 0).mean()
    if alone < VARIES:
        return 0.0
    # The mean deviation of a Gaussian. Rays and outlines, where there is no texture, look like it.
    unasked = grain(small) * math.sqrt(2 / math.pi) if texture >= TEXTURE else 0.0
    return float((alone - left) / max(alone - unasked, alone / 4))


def explained_of_cells(z, held, model: AbstractBarePicture, picture: Picture) -> float:
    """The same where little of the picture can be read, and that little is textured: in means over
    what can be read of each cell of COPY to the longer side, 1 is all, 0 none."""
    seen = picture.observe(np.arange(picture.size[0] * picture.size[1]))
    made = np.asarray(predicted(z, held, model, seen)).reshape(*picture.size, -1)
    factor = -(-max(picture.size) // COPY)
    size = (max(1, picture.size[0] // factor), max(1, picture.size[1] // factor))
    known = (picture.valid & ~picture.clipped).astype(np.float32)
    share = shrink(known, size)
    usable = np.flatnonzero(share > 0.5)
    if len(usable) < 50:
        return 0.0

    def means(levels: np.ndarray) -> np.ndarray:
        cells = shrink(levels * known[..., None], size) / np.maximum(share, 0.5)[..., None]
        return cells.reshape(-1, picture.channels)[usable].astype(np.float64)

    goal = means(picture.levels)
    alone = _off_background(goal, usable, size).mean()
    if alone < VARIES:
        return 0.0
    return float(1 - np.abs(goal - means(made)).max(1).mean() / alone)


def _off_background(goal: np.ndarray, cells: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(n,) levels by which ``goal`` (n, c) at row-major ``cells`` of a copy of ``size`` is off a
    smooth background, the one with the least absolute deviations."""
    basis, weight, off = terms(cells, size, TERM_COUNTS[3]), np.ones(len(goal)), np.zeros(len(goal))
    for _ in range(10):
        root = np.sqrt(weight)[:, None]
        fitted = basis @ np.linalg.lstsq(basis * root, goal * root, rcond=None)[0]
        off = np.abs(goal - fitted).max(1)
        weight = 1 / np.maximum(off, 0.5)
    return off


def grain(picture: Picture) -> float:
    """The texture of what is open, in levels: a robust deviation from the mean around. No light
    explains it, and what is off by as much is not foreign."""
    known, levels = (_bands(each) for each in (picture.valid & ~picture.clipped, picture.levels))
    if np.count_nonzero(known) < 100:
        return 0.0
    weight = known.astype(np.float32)
    within = (0, AROUND, AROUND)
    share = np.maximum(ndimage.gaussian_filter(weight, within), 1e-3)[..., None]
    mean = ndimage.gaussian_filter(levels * weight[..., None], (*within, 0)) / share
    # Beside what is unknown the mean is one-sided.
    beside = ndimage.generate_binary_structure(2, 1)[None]
    inner = np.asarray(ndimage.binary_erosion(known, beside, iterations=2))
    off = np.abs(levels - mean)[np.where(inner.any(), inner, known)]
    return float(np.median(off) / 0.6745)


def _bands(values: np.ndarray) -> np.ndarray:
    """(bands, rows, w, ...) some of ``values`` (h, w, ...), BAND rows each; all, in one, where
    there are no more than FEW."""
    h, w = values.shape[:2]
    if h * w <= FEW:
        return values[None]
    each = values[: h // BAND * BAND].reshape(h // BAND, BAND, *values.shape[1:])
    return each[:: -(-h * w // FEW)]

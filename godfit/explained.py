"""How much of a picture a light explains, and what no light does: texture."""

from __future__ import annotations

import math

import equinox as eqx
import numpy as np
from scipy import ndimage

from godfit.disc import TERMS, DiscLight, terms
from godfit.observation import Picture, shrink

# Longest side of the copy on which it is asked how much the light explains: fine texture is gone.
COPY = 60
# What varies less than so many levels is rounding.
VARIES = 0.1
# Pixels about which texture is averaged out.
AROUND = 6


def explained(z, held, model: DiscLight, small: Picture) -> float:
    """The share that the light at coordinates ``z`` (p,), ``held`` (p,) where not NaN, explains of
    what a smooth background alone would leave, in absolute deviations of the pixels whose light
    pass can be read; 1 is all, below 0 is worse than none. Texture, which nothing explains, is not
    asked for."""
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
    basis = terms(usable, small.size, TERMS[3])
    weight = np.ones(len(goal))
    for _ in range(10):
        root = np.sqrt(weight)[:, None]
        fitted = basis @ np.linalg.lstsq(basis * root, goal * root, rcond=None)[0]
        off = np.abs(goal - fitted).max(1)
        weight = 1 / np.maximum(off, 0.5)
    alone = np.maximum(off - max(small.half, 0.5), 0).mean()
    if alone < VARIES:
        return 0.0
    # The mean deviation of a Gaussian.
    texture = grain(small) * math.sqrt(2 / math.pi)
    return float((alone - left) / max(alone - texture, alone / 4))


def grain(picture: Picture) -> float:
    """The texture of what is open, in levels: a robust deviation from the mean around. No light
    explains it, and what is off by as much is not foreign."""
    known = (picture.valid & ~picture.clipped).astype(np.float32)
    if np.count_nonzero(known) < 100:
        return 0.0
    share = np.maximum(ndimage.gaussian_filter(known, AROUND), 1e-3)[..., None]
    levels = picture.levels * known[..., None]
    mean = ndimage.gaussian_filter(levels, (AROUND, AROUND, 0)) / share
    # Beside what is unknown the mean is one-sided.
    inner = np.asarray(ndimage.binary_erosion(known > 0, iterations=2))
    off = np.abs(picture.levels - mean)[inner if inner.any() else known > 0]
    return float(np.median(off) / 0.6745)


@eqx.filter_jit
def predicted(z, held, model, seen):
    """(n c,) levels at the pixels seen, every pixel's channels together, for coordinates ``z``
    (p,)."""
    return seen.predict(model.moved(z, held))

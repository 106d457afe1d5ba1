"""What it costs that a mask is as it is, where glare hides everything.

Elsewhere colour tells what stands in the way. Where all channels are clipped nothing is seen, and
what is there goes on as what is seen beside it: a texel costs by how much it is not as those around
it (Geman & Geman, IEEE PAMI 6 (1984), 721), and a mask by the length of its outline. Given those
around, that is a price for being open or for being solid, whichever fewer of them are, as of any
other texel that is not what it was thought to be; texels and those around them take turns (iterated
conditional modes: Besag, J. R. Stat. Soc. B 48 (1986), 259).
"""

from __future__ import annotations

import itertools

import numpy as np
from scipy import ndimage

from godfit.inference.observation import Picture
from godfit.io.filters import shrink

# Rows and columns to either side that are around a texel.
AROUND = 2
SIDE = 2 * AROUND + 1
# Half of the pairs of neighbours, as steps in rows and columns: the other half are the same.
STEPS = [
    (i, j)
    for i, j in itertools.product(range(AROUND + 1), range(-AROUND, AROUND + 1))
    if (i, j) > (0, 0)
]


def hidden(picture: Picture, unknown: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Where in a mask of that ``size`` (h, w) glare hides what is ``unknown``, an image of any."""
    glare = shrink(picture.glare.astype(np.float32), size) > 0.5
    return glare & (shrink(unknown.astype(np.float32), size) > 0)


def thought(mask: np.ndarray, where: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(k,) each: whether most of those around the k texels of ``mask`` (h, w) that are asked,
    ``where`` (h, w), are open, and by how much they are the more, between 0 and 1: what it costs to
    be otherwise."""
    if not where.any():
        return np.zeros(0, np.float32), np.zeros(0)
    near = _around(where)
    mask, where = mask[near], where[near]
    sums = ndimage.uniform_filter(mask.astype(np.float64), SIDE, mode="nearest") * SIDE**2
    mean = ((sums - mask) / (SIDE**2 - 1))[where]
    return (mean > 0.5).astype(np.float32), np.abs(2 * mean - 1)


def length(mask: np.ndarray, where: np.ndarray) -> float:
    """Of the outline of ``mask`` (h, w), in single texels' own: how much neighbours differ, one of
    which at least is ``where`` (h, w) that is asked."""
    if not where.any():
        return 0.0
    near = _around(where)
    mask, where = mask[near], where[near]
    h, w = mask.shape
    total = 0.0
    for i, j in STEPS:
        here = slice(0, h - i), slice(max(-j, 0), w - max(j, 0))
        there = slice(i, h), slice(max(j, 0), w + min(j, 0))
        total += float(np.abs(mask[here] - mask[there])[where[here] | where[there]].sum())
    return total / (SIDE**2 - 1)


def _around(where: np.ndarray) -> tuple[slice, ...]:
    """The rows and columns of all that is ``where`` (h, w) and around it."""
    rows, columns = (np.flatnonzero(where.any(axis)) for axis in (1, 0))
    return tuple(slice(max(at[0] - AROUND, 0), at[-1] + AROUND + 1) for at in (rows, columns))

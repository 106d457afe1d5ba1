"""Whether a picture's light pass was rendered at half its size, told from its pixels alone.

What is read bilinearly from texels twice as wide bends only at their middles: of three steps from
pixel to pixel in a row the outer two, and the one between them twice, cancel wherever the one
between does not leave a texel, which is at every other pixel. A pass of the picture's own size
bends as often at the others.
"""

from __future__ import annotations

import numpy as np

from godfit.inference.observation import Picture
from godfit.io.filters import over_channels

# The size of a light pass that is told from the picture's own.
HALF = 0.5
# Third differences, in steps of rounding, that one rounding does not make and two seldom do, and so
# large that objects' edges do, no light.
LEAST, MOST = 4.01, 12.0
# Bends that tell, least: at every other pixel more than twice as many as at the others, which
# chance makes of one in a thousand; and in all where there is such a share of them at the others.
MORE, ENOUGH, ALIKE = 10, 40, 0.75
# A JPEG bends where its blocks meet: most times the mean at one of their pixels.
BLOCK, UNEVEN = 8, 1.25


def pass_scale_of(picture: Picture) -> float | None:
    """1.0 of a light pass of the picture's own size, 0.5 of one of half of it, both only where this
    is beyond doubt."""
    inside, between = _bends(picture).reshape(-1, 2).T
    if _uneven(inside) or _uneven(between):
        return None
    few, many = inside.sum(), between.sum()
    if many >= 2 * few + MORE:
        return HALF
    return 1.0 if few + many >= ENOUGH and few >= ALIKE * many else None


def _bends(picture: Picture) -> np.ndarray:
    """(BLOCK,) third differences that are large, by the pixel (from 0) before the middle one: where
    that is even, the middle step is within a texel of a pass of half the size. Along sides of an
    even number of pixels."""
    known = picture.valid & ~picture.clipped
    step = 2 * picture.half or 1.0
    out = np.zeros(BLOCK, int)
    for axis in (0, 1):
        if known.shape[axis] % 2:
            continue
        p, k = np.moveaxis(picture.levels, axis, 0), np.moveaxis(known, axis, 0)
        size = np.abs(p[3:] - 3 * (p[2:-1] - p[1:-2]) - p[:-3]) / step
        large = over_channels(np.logical_or, (size > LEAST) & (size <= MOST))
        large &= k[3:] & k[2:-1] & k[1:-2] & k[:-3]
        for first in range(BLOCK):
            out[(first + 1) % BLOCK] += np.count_nonzero(large[first::BLOCK])
    return out


def _uneven(counts: np.ndarray) -> bool:
    mean = counts.mean()
    return bool(counts.max() > UNEVEN * mean + 3 * np.sqrt(mean))

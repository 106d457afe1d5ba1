"""Whether a picture was a JPEG once.

JPEG rounds the 64 cosine coefficients of every 8x8 block to multiples of a step, most of the fine
ones to zero (ITU-T T.81, annex A). On the grid that it used they are then smaller than on the same
grid moved by a few pixels; in a picture that never was a JPEG no grid is better than another. The
idea of comparing grids is Fan & de Queiroz's, IEEE Trans. Image Process. 12 (2003), 230.
"""

from __future__ import annotations

import numpy as np
from scipy import fft

BLOCK = 8
# Grids to compare with, out of step both ways, and blocks looked at, most.
SHIFTS = ((4, 4), (2, 2), (6, 6), (3, 5), (5, 3), (2, 6), (6, 2), (4, 2))
MAX_BLOCKS = 1024
# A coefficient below this (levels; orthonormal, where rounding alone leaves .29) counts as none.
NONE = 0.6
# How much larger than on other grids the share of such must be, in units of how those differ.
SURE, LEAST = 4.0, 0.025


def _share_of_none(levels: np.ndarray, down: int, right: int) -> float:
    """Share of the coefficients that are none, in blocks that are neither flat nor clipped."""
    h, w = ((n - BLOCK) // BLOCK for n in levels.shape)
    part = levels[down : down + h * BLOCK, right : right + w * BLOCK]
    blocks = part.reshape(h, BLOCK, w, BLOCK).swapaxes(1, 2).reshape(-1, BLOCK, BLOCK)
    spread = blocks.max((1, 2)) - blocks.min((1, 2))
    clipped = (blocks.max((1, 2)) >= 254.5) | (blocks.min((1, 2)) <= 0.5)
    blocks = blocks[(spread >= 3) & ~clipped]
    if len(blocks) > MAX_BLOCKS:
        blocks = blocks[np.random.default_rng(0).permutation(len(blocks))[:MAX_BLOCKS]]
    if len(blocks) < 8:
        return float("nan")
    size = np.abs(np.asarray(fft.dctn(blocks, axes=(1, 2), norm="ortho")))
    return float(np.mean(size.reshape(-1, 64)[:, 1:] < NONE))


def was_jpeg(levels: np.ndarray) -> bool:
    """Whether ``levels`` (h, w), 8-bit, agree with the grid of a JPEG that begins in the corner."""
    if min(levels.shape) < 4 * BLOCK:
        return False
    own = _share_of_none(levels, 0, 0)
    others = np.array([_share_of_none(levels, *shift) for shift in SHIFTS])
    others = others[np.isfinite(others)]
    if not np.isfinite(own) or len(others) < 4:
        return False
    ahead = own - others.mean()
    return bool(ahead > LEAST and ahead > SURE * others.std(ddof=1))

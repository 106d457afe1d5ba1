"""A JPEG's compression: recognised, and done once more.

The quality is the one at which the picture, compressed again, stays as it is (Farid, IEEE Trans.
Inf. Forensics Secur. 4 (2009), 154).
"""

from __future__ import annotations

import io

import numpy as np
from PIL import Image
from scipy import fft

from godfit.io.image import LEVELS

QUALITIES = range(30, 101)
# Colour at full and at half resolution, as Pillow numbers them.
SUBSAMPLINGS = (0, 2)
# Levels, in the mean, by which a picture changes at most that is compressed as it was before, and
# the most that this is of what qualities two apart change; tables of neighbours nearly agree.
SAME, TELLING = 0.15, 0.55


def compressed(levels: np.ndarray, quality: int, subsampling: int) -> np.ndarray:
    """(h, w, c) levels, rounded, after a JPEG."""
    data = np.floor(levels + 0.5).clip(0, LEVELS).astype(np.uint8)
    file = io.BytesIO()
    picture = Image.fromarray(data[..., 0] if data.shape[2] == 1 else data)
    picture.save(file, "JPEG", quality=quality, subsampling=subsampling)
    return np.asarray(Image.open(file), np.float32).reshape(levels.shape)


def settings_of(levels: np.ndarray) -> tuple[int, int] | None:
    """Quality and subsampling of the JPEG that ``levels`` (h, w, c) were; None if they were none,
    or of another maker's tables."""
    found = []
    for subsampling in SUBSAMPLINGS[: 1 if levels.shape[2] == 1 else 2]:
        changes = [
            float(np.abs(compressed(levels, quality, subsampling) - levels).mean())
            for quality in QUALITIES
        ]
        for before, change, after, quality in zip(
            changes, changes[2:], changes[4:], QUALITIES[2:], strict=False
        ):
            if change < min(SAME, TELLING * before, TELLING * after):
                found.append((change, quality, subsampling))
    return min(found)[1:] if found else None


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

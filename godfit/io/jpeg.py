"""A JPEG's compression: recognised, measured, and applied again.

The quality is the one at which another compression leaves the picture as it is (Farid, IEEE Trans.
Inf. Forensics Secur. 4 (2009), 154). A compressed picture
is recognised by its blocks of 8x8 pixels: in their alignment, and in no other, many coefficients of
the cosine transform are zero.
"""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from godfit.io.image import LEVELS

JPEG_QUALITIES = range(30, 101)
"""Qualities that are tried."""
JPEG_SUBSAMPLINGS = (0, 2)
"""Colour at full and at half resolution, as Pillow numbers them."""
MAX_RECOMPRESSION_CHANGE = 0.15
"""Levels, in the mean, by which a picture changes at most that is compressed once more as before:
its colours are rounded in between."""
MAX_CHANGE_RATIO = 0.55
"""Largest ratio of that change to the change at qualities two lower and two higher. Those one apart
have nearly the same tables."""

JPEG_BLOCK = 8
"""Side of a block in pixels."""
_PLACES = np.arange(JPEG_BLOCK)
DCT = np.cos(np.pi / JPEG_BLOCK * np.outer(_PLACES, _PLACES + 0.5))
DCT *= np.where(_PLACES == 0, 1 / JPEG_BLOCK, 2 / JPEG_BLOCK)[:, None] ** 0.5
"""(8, 8) the orthonormal cosine transform of a block's rows or columns, scipy.fft's of type 2."""
BLOCK_SHIFTS = ((4, 4), (2, 2), (6, 6), (3, 5), (5, 3), (2, 6), (6, 2), (4, 2))
"""Alignments, rows and columns, against which that of a JPEG is compared: out of step both ways."""
MAX_COMPARED_BLOCKS = 1024
"""Most blocks whose coefficients are computed, a random choice: enough for their share of zeros."""
MIN_COMPARED_BLOCKS = 8
"""Fewest blocks whose share of zeros is used."""
MIN_BLOCK_RANGE = 3.0
"""Levels between the darkest and the brightest pixel of a block that is not flat."""
MAX_ZERO_COEFFICIENT = 0.6
"""Size in levels below which a coefficient (orthonormal) counts as zero: twice what rounding of the
pixels gives it, 0.29."""
MIN_ZERO_EXCESS = 0.025
"""Least excess of the JPEG alignment's share of zeros over the mean of the others."""
MIN_ZERO_EXCESS_SIGMAS = 4.0
"""The same in standard deviations of the other alignments' shares."""
MIN_COMPARED_SHIFTS = 4
"""Fewest other alignments of which there is a share: fewer give no reliable standard deviation."""


def compressed(levels: np.ndarray, quality: int, subsampling: int) -> np.ndarray:
    """(h, w, c) 8-bit levels, rounded and decoded from a JPEG of this quality and subsampling."""
    data = np.floor(levels + 0.5).clip(0, LEVELS).astype(np.uint8)
    file = io.BytesIO()
    picture = Image.fromarray(data[..., 0] if data.shape[2] == 1 else data)
    picture.save(file, "JPEG", quality=quality, subsampling=subsampling)
    return np.asarray(Image.open(file), np.float32).reshape(levels.shape)


def settings_of(levels: np.ndarray) -> tuple[int, int] | None:
    """Quality and subsampling of the JPEG from which ``levels`` (h, w, c) were decoded.

    None if they were decoded from no JPEG, or one with tables other than libjpeg's.
    """
    matches = []
    for subsampling in JPEG_SUBSAMPLINGS[: 1 if levels.shape[2] == 1 else 2]:
        changes = [
            float(np.abs(compressed(levels, quality, subsampling) - levels).mean())
            for quality in JPEG_QUALITIES
        ]
        for before, change, after, quality in zip(
            changes, changes[2:], changes[4:], JPEG_QUALITIES[2:], strict=False
        ):
            neighbours = MAX_CHANGE_RATIO * before, MAX_CHANGE_RATIO * after
            if change < min(MAX_RECOMPRESSION_CHANGE, *neighbours):
                matches.append((change, quality, subsampling))
    return min(matches)[1:] if matches else None


def _share_of_zeros(levels: np.ndarray, down: int, right: int) -> float:
    """Share of zeros among the coefficients of blocks that begin at row ``down``, column ``right``.

    Flat and clipped blocks are left out, and constant terms; NaN where too few blocks remain.
    """
    h, w = ((n - JPEG_BLOCK) // JPEG_BLOCK for n in levels.shape)
    part = levels[down : down + h * JPEG_BLOCK, right : right + w * JPEG_BLOCK]
    blocks = part.reshape(h, JPEG_BLOCK, w, JPEG_BLOCK).swapaxes(1, 2)
    blocks = blocks.reshape(-1, JPEG_BLOCK, JPEG_BLOCK)
    darkest, brightest = blocks.min((1, 2)), blocks.max((1, 2))
    clipped = (brightest >= LEVELS - 0.5) | (darkest <= 0.5)
    blocks = blocks[(brightest - darkest >= MIN_BLOCK_RANGE) & ~clipped]
    if len(blocks) > MAX_COMPARED_BLOCKS:
        order = np.random.default_rng(0).permutation(len(blocks))
        blocks = blocks[order[:MAX_COMPARED_BLOCKS]]
    if len(blocks) < MIN_COMPARED_BLOCKS:
        return float("nan")
    size = np.abs(DCT @ blocks @ DCT.T)
    size = size.reshape(-1, JPEG_BLOCK**2)[:, 1:]
    return float(np.mean(size < MAX_ZERO_COEFFICIENT))


def was_jpeg(levels: np.ndarray) -> bool:
    """Whether ``levels`` (h, w), 8-bit, have the blocks of a JPEG that begins in the corner."""
    if min(levels.shape) < 4 * JPEG_BLOCK:
        return False
    own = _share_of_zeros(levels, 0, 0)
    others = np.array([_share_of_zeros(levels, *shift) for shift in BLOCK_SHIFTS])
    others = others[np.isfinite(others)]
    if not np.isfinite(own) or len(others) < MIN_COMPARED_SHIFTS:
        return False
    excess = own - others.mean()
    sigmas = MIN_ZERO_EXCESS_SIGMAS * others.std(ddof=1)
    return bool(excess > MIN_ZERO_EXCESS and excess > sigmas)

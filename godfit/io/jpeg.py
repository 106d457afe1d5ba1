"""A JPEG's compression: recognised, and done once more.

The quality is the one at which the picture, compressed again, stays as it is (Farid, IEEE Trans.
Inf. Forensics Secur. 4 (2009), 154).
"""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from godfit.inference.observation import LEVELS

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

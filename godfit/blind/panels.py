"""Panels of a user interface that lie on top of a finished picture."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

LEAST_AREA = 2e-3
"""Least share of the picture that a panel covers."""
LEAST_SIDE = 10
"""Least side of a panel, in pixels."""
FILLED = 0.93
"""Least share of its rectangle that a panel fills."""
FLAT = 0.5
"""Least share of a panel that has one of its four commonest colours."""
GAP = 6
"""Pixels over which parts of a panel are joined: a line of text."""


def panels(other: np.ndarray, levels: np.ndarray) -> list[tuple[int, int, int, int]]:
    """(x, y, width, height) of flat rectangles with upright edges among what is ``other`` (h, w)
    than the ground of a picture (h, w, c) in levels."""
    h, w = other.shape
    wide_margin = 2 * GAP
    padded = np.pad(other, wide_margin, mode="edge")
    closed = np.asarray(ndimage.binary_closing(padded, iterations=GAP))
    closed = closed[wide_margin:-wide_margin, wide_margin:-wide_margin]
    label = np.zeros(closed.shape, np.int32)
    ndimage.label(closed, output=label)
    found = []
    for number, where in enumerate(ndimage.find_objects(label), 1):
        rows, columns = where
        tall, wide = rows.stop - rows.start, columns.stop - columns.start
        if tall * wide < LEAST_AREA * h * w or min(tall, wide) < LEAST_SIDE:
            continue
        inside = np.asarray(ndimage.binary_fill_holes(label[where] == number))
        if inside.mean() < FILLED:
            continue
        colours = levels[where].reshape(-1, levels.shape[-1]).astype(np.int64)
        code = np.array([1 << 16, 1 << 8, 1])[: colours.shape[1]]
        _, counts = np.unique(colours @ code, return_counts=True)
        if np.sort(counts)[::-1][:4].sum() > FLAT * counts.sum():
            found.append((columns.start, rows.start, wide, tall))
    return found

"""Frames of a sequence whose parameters differ from those around them."""

from __future__ import annotations

import numpy as np

WINDOW = 9
"""Frames over which a median is taken: a light that moves is nearly still over so few."""
OUTLYING = 6.0
"""Errors from the median of the frames around it from which a frame is an outlier. The errors
include the scatter of all frames, so that normal scatter gives one in a million."""
GAUSSIAN = 1.4826
"""Standard deviation of Gaussian numbers whose median absolute deviation is one."""


def outlying(values: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """(n,) by how many errors each of ``values`` (n,) differs from the median of the WINDOW frames
    about it, 0 where it is NaN.

    ``errors`` (n,) are standard errors, NaN where there is none. To their squares that of the
    scatter is added: GAUSSIAN times the median absolute difference of all frames (Huber, Robust
    Statistics, section 5.1).
    """
    from scipy import ndimage

    out = np.zeros(len(values))
    known = np.isfinite(values)
    if known.sum() < 3:
        return out
    found = values[known]
    median = ndimage.median_filter(found, min(WINDOW, len(found)), mode="nearest")
    difference = np.abs(found - median)
    # Whatever a median over few frames leaves is scatter too, and half of them are on it.
    away = difference[difference > 0]
    scatter = GAUSSIAN * float(np.median(away)) if away.size else 0.0
    total = np.hypot(np.nan_to_num(errors[known]), scatter)
    out[known] = np.divide(difference, total, out=np.zeros_like(difference), where=total > 0)
    return out

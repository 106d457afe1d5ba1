"""What a resize of the finished target adds, as noise of each value.

The target was bytes before, and an image program rounds to bytes again after the columns and after
the rows. A value that mixes several bytes with weights w has their roundings with the variance
sum w^2 / 12 in levels, and the last rounding beside that. A value that is one byte of the target
before has its rounding alone.

A box leaves most values single bytes. Other kernels mix them all. Neighbours then share roundings,
which is no noise of each value, and pictures that are resized and fitted in the same way give the
errors (``inference/indirect_inference.py``).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from godfit.scattering.resize_kernels import kernel_taps

ROUNDING = 1 / 12
"""Variance of a rounding to bytes, in levels squared."""
ONE_BYTE = 1 - 1e-6
"""Sum of squared weights from which a value is one byte of the picture before."""
FEW_MIXED = 0.1
"""Share of values that mix bytes up to which their noise is that of each alone."""


def resize_variance(
    pixels: np.ndarray, size: tuple[int, int], low: tuple[int, int], kernel: str
) -> Float[np.ndarray, " n"] | None:
    """Variances in levels squared, beside the last rounding, of the values at row-major ``pixels``
    (n,) of a picture of ``size`` that a ``kernel`` made of one of size ``low``; None where they are
    no noise of each value."""
    sides = zip(low, size, strict=True)
    rows, columns = ((kernel_taps(*side, kernel)[1] ** 2).sum(1) for side in sides)
    row, column = rows[pixels // size[1]], columns[pixels % size[1]]
    across = np.where(column < ONE_BYTE, column * ROUNDING, 0)
    between = np.where(column < ONE_BYTE, ROUNDING, 0)
    variance = np.where(row < ONE_BYTE, row * (column * ROUNDING + between), across)
    return variance if (variance > 0).mean() <= FEW_MIXED else None

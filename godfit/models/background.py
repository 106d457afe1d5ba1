"""The background of a bare picture: a polynomial of the place, of a low degree.

Places are (x, y), each from -1 to 1 over the picture: x to the right, y up.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Array, Float, Int

TERM_POWERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))
"""Powers of x and y in each term, in order of degree."""
TERM_COUNTS = {0: 1, 1: 3, 2: 6, 3: 10}
"""Number of terms, by degree. A cubic is the most that a background needs beside its texture."""
CHANNEL_NAMES = "rgb"
"""Channels in the names of a background's parameters."""
DARKEST_BACKGROUND = -0.05
"""Least value of a constant background, linear. It lies below 0, because colour management of a
window can shift black to below 0."""


def term_values(x, y, count: int) -> list:
    """The first ``count`` terms at places ``x`` and ``y``, arrays of one shape."""
    return [x**i * y**j for i, j in TERM_POWERS[:count]]


def terms(
    pixels: Int[Array | np.ndarray, " n"], size: tuple[int, int], count: int
) -> Float[Array | np.ndarray, "n k"]:
    """The first ``count`` terms at row-major ``pixels`` of a picture of ``size`` (height, width).

    The result is of the library of ``pixels``: NumPy has nothing to compile for another number of
    pixels.
    """
    h, w = size
    x, y = 2 * (pixels % w + 0.5) / w - 1, 1 - 2 * (pixels // w + 0.5) / h
    return pixels.__array_namespace__().stack(term_values(x, y, count), -1)

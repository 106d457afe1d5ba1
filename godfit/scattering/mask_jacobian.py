"""The Jacobian of a radial sum by the mask: a sparse matrix, compiled by numba.

A radial sum is linear in the mask. A row of the matrix is a pixel of the light pass; a column is an
unknown of the mask, which one or several texels share. Texels whose value is known add a constant.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from godfit.runtime.numba_jit import jit


class PixelTaps(NamedTuple):
    """Taps towards one light: its column and row (2,) in the mask, and the taps' positions ``t``
    (k,) along the ray from the pixel, 0, to the light, 1, and weights ``c`` (k,)."""

    light: np.ndarray
    t: np.ndarray
    c: np.ndarray


class PartlyKnownMask(NamedTuple):
    """A mask of ``size`` (h, w) of which some texels are unknown; arrays are (h w,), row-major.

    ``values`` are those of the known texels. ``unknown`` is the index of a texel's unknown, -1
    where its value is known, and ``unknowns`` the number of unknowns. ``brightness`` scales both.
    """

    size: tuple[int, int]
    values: np.ndarray
    unknown: np.ndarray
    unknowns: int
    brightness: np.ndarray


@jit
def mask_jacobian(pixels, taps, mask):
    """The sum at row-major ``pixels`` (n,) of the light pass: of what is known, and the Jacobian.

    ``taps`` is a PixelTaps, ``mask`` a PartlyKnownMask. Reads are bilinear, clamped to the edge.
    Returns the sum over known texels (n,) in float64, and the Jacobian (n, unknowns) in compressed
    rows: starts (n + 1,), columns, and float32 values.
    """
    (h, w), t, c = mask.size, taps.t, taps.c
    light_x, light_y = taps.light[0], taps.light[1]
    texel_value, texel_unknown, brightness = mask.values, mask.unknown, mask.brightness
    known = np.zeros(len(pixels))
    # Where in ``columns`` an unknown was last written: an entry of this row if it lies behind the
    # row's start.
    entry = np.full(mask.unknowns, -1, np.int64)
    starts = np.zeros(len(pixels) + 1, np.int32)
    columns, values = np.empty(len(pixels), np.int32), np.empty(len(pixels), np.float32)
    end = 0
    for n in range(len(pixels)):
        # The number of entries is not known beforehand: there is always room for one more row.
        if end + 4 * len(t) > len(columns):
            length = 2 * len(columns) + 4 * len(t)
            columns, values = _lengthened(columns[:end], length), _lengthened(values[:end], length)
        from_row, from_column = pixels[n] // w, pixels[n] % w
        for k in range(len(t)):
            x = from_column + t[k] * (light_x - from_column)
            y = from_row + t[k] * (light_y - from_row)
            left, top = np.floor(x), np.floor(y)
            for corner in range(4):
                right, bottom = corner % 2, corner // 2
                i = min(max(int(left) + right, 0), w - 1)
                j = min(max(int(top) + bottom, 0), h - 1)
                texel = j * w + i
                share_x = x - left if right else 1 - (x - left)
                share_y = y - top if bottom else 1 - (y - top)
                weight = c[k] * share_x * share_y * brightness[texel]
                column = texel_unknown[texel]
                if column < 0:
                    known[n] += weight * texel_value[texel]
                elif entry[column] < starts[n]:
                    entry[column] = end
                    columns[end], values[end] = column, weight
                    end += 1
                else:
                    values[entry[column]] += weight
        starts[n + 1] = end
    return known, starts, columns[:end].copy(), values[:end].copy()


@jit
def _lengthened(values, length):
    """An array (length,) that begins with ``values``; the rest is not set."""
    out = np.empty(length, values.dtype)
    for n in range(len(values)):
        out[n] = values[n]
    return out

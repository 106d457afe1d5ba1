"""What a sum over taps reads of every texel, compiled by numba: a sparse matrix, row by row."""

from __future__ import annotations

import numpy as np

from godfit.native import compiled


@compiled
def texel_sums(texels, h, w, light, t, c, lit, values, place):
    """Sums at row-major ``texels`` (n,) of a pass of ``h`` by ``w``: what taps ``t``, ``c`` (k,)
    towards column and row ``light`` (2,) read of a mask ``lit`` (h w,) times ``values`` (h w,)
    where ``place`` (h w,) is -1, and the rest as a sparse matrix in columns ``place``."""
    known = np.zeros(len(texels))
    # Where a texel that is read more than once is kept.
    kept = np.empty(len(place), np.int64)
    starts = np.zeros(len(texels) + 1, np.int32)
    # Counted first, so that no more is held than is needed.
    read, share = np.empty(0, np.int32), np.empty(0, np.float32)
    for fill in (False, True):
        if fill:
            read, share = np.empty(starts[-1], np.int32), np.empty(starts[-1], np.float32)
        kept[:] = -1
        end = 0
        for n in range(len(texels)):
            row, column = texels[n] // w, texels[n] % w
            for k in range(len(t)):
                x = column + t[k] * (light[0] - column)
                y = row + t[k] * (light[1] - row)
                left, low = np.floor(x), np.floor(y)
                for corner in range(4):
                    right, high = corner % 2, corner // 2
                    i = min(max(int(left) + right, 0), w - 1)
                    j = min(max(int(low) + high, 0), h - 1)
                    at = j * w + i
                    part_x = x - left if right else 1 - (x - left)
                    part_y = y - low if high else 1 - (y - low)
                    part = c[k] * part_x * part_y * lit[at]
                    if place[at] < 0:
                        known[n] += part * values[at] if fill else 0.0
                        continue
                    if kept[at] < starts[n]:
                        kept[at] = end
                        if fill:
                            read[end], share[end] = place[at], part
                        end += 1
                    elif fill:
                        share[kept[at]] += part
            starts[n + 1] = end
    return known, starts, read, share

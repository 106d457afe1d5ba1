"""What a sum over taps reads of every texel, compiled by numba: a sparse matrix, row by row."""

from __future__ import annotations

import numpy as np

from godfit.runtime.numba_jit import jit


@jit
def texel_sums(texels, h, w, light, t, c, lit, values, place, count):
    """Sums at row-major ``texels`` (n,) of a pass of ``h`` by ``w``: what taps ``t``, ``c`` (k,)
    towards column and row ``light`` (2,) read of a mask ``lit`` (h w,) times ``values`` (h w,)
    where ``place`` (h w,) is -1, and the rest as a sparse matrix in columns ``place``, of which
    there are ``count``."""
    known = np.zeros(len(texels))
    # Where a column that is read more than once is kept.
    kept = np.full(count, -1, np.int64)
    starts = np.zeros(len(texels) + 1, np.int32)
    read, share = np.empty(len(texels), np.int32), np.empty(len(texels), np.float32)
    end = 0
    for n in range(len(texels)):
        # How much a ray reads is not known before: there is always room for one more.
        if end + 4 * len(t) > len(read):
            room = 2 * len(read) + 4 * len(t)
            read, share = _moved(read[:end], room), _moved(share[:end], room)
        from_row, from_column = texels[n] // w, texels[n] % w
        for k in range(len(t)):
            x = from_column + t[k] * (light[0] - from_column)
            y = from_row + t[k] * (light[1] - from_row)
            left, low = np.floor(x), np.floor(y)
            for corner in range(4):
                right, high = corner % 2, corner // 2
                i = min(max(int(left) + right, 0), w - 1)
                j = min(max(int(low) + high, 0), h - 1)
                at = j * w + i
                part_x = x - left if right else 1 - (x - left)
                part_y = y - low if high else 1 - (y - low)
                part = c[k] * part_x * part_y * lit[at]
                column = place[at]
                if column < 0:
                    known[n] += part * values[at]
                elif kept[column] < starts[n]:
                    kept[column] = end
                    read[end], share[end] = column, part
                    end += 1
                else:
                    share[kept[column]] += part
        starts[n + 1] = end
    return known, starts, read[:end].copy(), share[:end].copy()


@jit
def _moved(values, room):
    """``values`` (n,) where there is room for so many."""
    out = np.empty(room, values.dtype)
    for n in range(len(values)):
        out[n] = values[n]
    return out

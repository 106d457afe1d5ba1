"""The mask that a light pass was made of, texel by texel, given light and taps; compiled by numba.

A shader's taps lie between a texel and the light. In the order of their distance from the light,
each texel is therefore the only unknown of its own light pass: it is decided, and what is left over
is passed on to the next one farther out.
"""

from __future__ import annotations

import numpy as np

from godfit.runtime.numba_jit import fast_jit


@fast_jit
def decide(mask, light, sure, order, taps, levels):
    """Decide each texel of ``mask`` (h, w) in place, in the ``order`` (h w,) of row-major indices.

    ``light`` (h, w) is the light pass in units of a white texel, ``sure`` (h, w) is 1 where it is
    known, 0 where it is a lower bound, -1 where nothing is known. ``taps`` has the light's column
    and row, the own pixel's weight, positions t and weights c. ``levels`` (k,) are the values a
    texel may have, ascending; with a single one, every value up to it. A texel of which nothing is
    known stays, unless it is below what the bound requires. Returns the sum at each texel (h, w).
    """
    h, w = mask.shape
    (column, row), own, t, c = taps
    total = np.zeros((h, w))
    for index in order:
        i, j = index // w, index % w
        rest, itself = 0.0, own
        for k in range(len(t)):
            x, y = j + t[k] * (column - j), i + t[k] * (row - i)
            left, top = int(np.floor(x)), int(np.floor(y))
            s, z = x - left, y - top
            a, b = min(max(left, 0), w - 1), min(max(left + 1, 0), w - 1)
            p, q = min(max(top, 0), h - 1), min(max(top + 1, 0), h - 1)
            if p == i or q == i:
                near = 0.0
                if p == i:
                    near += (1 - z) * ((1 - s) * (a == j) + s * (b == j))
                if (q == i and q != p) or q == i:
                    near += z * ((1 - s) * (a == j) + s * (b == j))
                itself += c[k] * near
                rest -= c[k] * near * mask[i, j]
            rest += c[k] * (
                (1 - z) * ((1 - s) * mask[p, a] + s * mask[p, b])
                + z * ((1 - s) * mask[q, a] + s * mask[q, b])
            )
        value = mask[i, j]
        if sure[i, j] >= 0:
            wanted = (light[i, j] - rest) / itself
            if sure[i, j] == 0:
                wanted = max(wanted, value)
            if len(levels) == 1:
                value = min(max(wanted, 0.0), levels[0])
            else:
                value = levels[0]
                for k in range(1, len(levels)):
                    if abs(wanted - levels[k]) < abs(wanted - value):
                        value = levels[k]
        mask[i, j] = value
        total[i, j] = rest + itself * value
    return total

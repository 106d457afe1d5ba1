"""What discs of many radii add along rays, compiled by numba."""

from __future__ import annotations

import numpy as np

from godfit.native import compiled


@compiled
def is_clear(x, y, light, density, samples, blocked):
    """Whether (n,) none of the taps towards column and row ``light`` (2,) reads what is ``blocked``
    (h, w)."""
    h, w = blocked.shape
    clear = np.ones(len(x), np.bool_)
    for a in range(len(x)):
        for k in range(samples + 1):
            t = density * k / samples
            i = int(np.rint(x[a] + t * (light[0] - x[a])))
            j = int(np.rint(y[a] + t * (light[1] - y[a])))
            if blocked[min(max(j, 0), h - 1), min(max(i, 0), w - 1)]:
                clear[a] = False
                break
    return clear


@compiled
def disc_sums(x, y, size, light, t, c, radii, cut, power):
    """(n, r, power + 1) what discs of ``radii`` (r,), evenly apart, about column and row ``light``
    (2,) add under taps ``t``, ``c`` (k,), and that times powers of how far from the last one."""
    (h, w), count, parts = size, len(radii), cut * cut
    thin = radii[1] - radii[0] if count > 1 else 1.0
    # The first radius that has each part of a texel inside it, near the rim.
    reach = int(radii[-1]) + 3
    middle_x, middle_y = int(np.rint(light[0])), int(np.rint(light[1]))
    first = np.empty((2 * reach + 1, 2 * reach + 1, parts), np.int64)
    for j in range(2 * reach + 1):
        for i in range(2 * reach + 1):
            for part in range(parts):
                dx = middle_x + i - reach + (part % cut + 0.5) / cut - 0.5 - light[0]
                dy = middle_y + j - reach + (part // cut + 0.5) / cut - 0.5 - light[1]
                first[j, i, part] = max(int(np.ceil((np.hypot(dx, dy) - radii[0]) / thin)), 0)
    out = np.zeros((len(x), count, power + 1))
    for a in range(len(x)):
        sums = out[a]
        whole = np.hypot(light[0] - x[a], light[1] - y[a])
        for k in range(len(t)):
            away = whole * (1 - t[k])
            column, row = x[a] + t[k] * (light[0] - x[a]), y[a] + t[k] * (light[1] - y[a])
            within = 0 <= column <= w - 1 and 0 <= row <= h - 1
            if within and away > radii[-1] + 2:
                continue
            if within and away < radii[0] - 2:
                share = c[k]
                for p in range(power + 1):
                    sums[0, p] += share
                    share *= t[k] - t[-1]
                continue
            left, low = int(np.floor(column)), int(np.floor(row))
            for corner in range(4):
                right, high = corner % 2, corner // 2
                share = c[k] / parts * (column - left if right else 1 - column + left)
                share *= row - low if high else 1 - row + low
                i = min(max(left + right, 0), w - 1) - middle_x + reach
                j = min(max(low + high, 0), h - 1) - middle_y + reach
                if not (0 <= i <= 2 * reach and 0 <= j <= 2 * reach):
                    continue
                for part in range(parts):
                    at = first[j, i, part]
                    if at < count:
                        along = share
                        for p in range(power + 1):
                            sums[at, p] += along
                            along *= t[k] - t[-1]
        for r in range(1, count):
            for p in range(power + 1):
                sums[r, p] += sums[r - 1, p]
    return out

"""The radial sum at points, compiled, for any number of taps: see ``banding.py``."""

from __future__ import annotations

from numba import njit

from godfit.cache import numba_keeps


@njit(cache=numba_keeps(), nogil=True, error_model="numpy")
def ray_sums(mask, x, y, light_x, light_y, ratio, step, count, out):
    """out (m,): sum_k ratio^(k-1) M(x + k step (l - x)), bilinear and clamped, k = 1..count."""
    last_row, last_column = mask.shape[0] - 1.0, mask.shape[1] - 1.0
    for i in range(x.shape[0]):
        weight, total = 1.0, 0.0
        for k in range(1, count + 1):
            t = k * step
            u = min(max(x[i] + t * (light_x - x[i]), 0.0), last_column)
            v = min(max(y[i] + t * (light_y - y[i]), 0.0), last_row)
            a, b = int(u), int(v)
            c, d = min(a + 1, int(last_column)), min(b + 1, int(last_row))
            p, q = u - a, v - b
            top = (1 - p) * mask[b, a] + p * mask[b, c]
            total += weight * ((1 - q) * top + q * ((1 - p) * mask[d, a] + p * mask[d, c]))
            weight *= ratio
        out[i] = total

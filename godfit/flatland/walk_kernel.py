"""One ray's walk through a canvas, compiled by numba; what the other compiled modules share.

Arrays are those of ``godfit.flatland.rays.Prepared``: ``free`` (h + 2, w + 2), how far a ray may go
from anywhere in a cell without meeting anything, or FILLED or OUTSIDE; ``cells``
((h + 2) (w + 2), 4), what a cell adds to a ray and its opacity.
"""

from __future__ import annotations

import numpy as np

from godfit.runtime.numba_jit import fast_jit

FILLED, OUTSIDE = -1.0, -2.0
# Pixels of a row whose rays go side by side, in vector registers.
LANES = 32
# How a walk ends: nothing more to see, outside, at its limit.
SPENT, LEFT, ARRIVED = 0, 1, 2


@fast_jit
def inverse(component, real):
    """1 / component, large but finite for a ray along an axis."""
    return real(1) / component if abs(component) > 1e-9 else real(1e9)


@fast_jit
def first_step(free, x, y, dx, dy, step, little):
    """Where a ray has left its own cell, whatever that holds, and the steps that ended inside."""
    real = free.dtype.type
    column, row = np.int32(x), np.int32(y)
    used = np.int32(0)
    if step > 0:
        t = step
        while np.int32(x + t * dx) == column and np.int32(y + t * dy) == row:
            t += step
            used += np.int32(1)
        return t, used
    right, below = real(dx > -1e-9), real(dy > -1e-9)
    edge = min(
        (real(column) + right - x) * inverse(dx, real),
        (real(row) + below - y) * inverse(dy, real),
    )
    return max(max(free[row, column], real(0)), edge + little), used


@fast_jit
def walk(free, cells, x, y, dx, dy, t, last, limit, step, little, steps, opaque, hits):
    """Filled cells that a ray from (x, y) crosses from ``t`` to ``limit`` on, in ``hits``, until
    ``opaque`` of them let nothing through: their number and how the walk ended. ``last`` is a cell
    that does not count any more."""
    width = free.shape[1]
    real = free.dtype.type
    across, down = inverse(dx, real), inverse(dy, real)
    right, below = real(dx > -1e-9), real(dy > -1e-9)
    high, wide = real(free.shape[0] - 1), real(width - 1)
    found, blocked = 0, 0
    for _ in range(steps):
        if t >= limit:
            return found, ARRIVED
        column = np.int32(min(max(x + t * dx, real(0)), wide))
        row = np.int32(min(max(y + t * dy, real(0)), high))
        value = free[row, column]
        if value == OUTSIDE:
            return found, LEFT
        cell = row * width + column
        if value == FILLED and cell != last:
            hits[found] = cell
            found += 1
            if cells[cell, 3] >= 1:
                blocked += 1
                if blocked == opaque:
                    return found, SPENT
        last = cell
        if step > 0:
            t += step
        else:
            edge = min((real(column) + right - x) * across, (real(row) + below - y) * down) + little
            t = max(t + max(value, real(0)), edge)
    return found, SPENT


@fast_jit
def blend(cells, hits, found, ended, sky, light):
    """What the walk sees, in ``light`` (4,): radiance and what passes."""
    passing = light.dtype.type(1)
    light[:] = 0
    for n in range(found):
        cell = hits[n]
        for c in range(3):
            light[c] += passing * cells[cell, c]
        passing *= 1 - cells[cell, 3]
    light[3] = passing
    if ended == LEFT:
        for c in range(3):
            light[c] += passing * sky[c]

"""What the rays of every pixel see, compiled by numba; see ``godfit.flatland.rays``.

Arrays are those of ``godfit.flatland.walk_kernel``, and ``directions`` (rays kinds, 2), right and
down; ``sky`` (rays kinds, 3); ``turn`` (h, w), which of the kinds a pixel's rays take. ``numbers``
are the length of a step, 0 for one that goes by ``free``, and the little that takes a ray across a
cell's border; ``whole`` are the rays, kinds, steps and the first row.
"""

from __future__ import annotations

import numpy as np

from godfit.flatland.walk_kernel import (
    FILLED,
    LANES,
    LEFT,
    OUTSIDE,
    blend,
    first_step,
    inverse,
    walk,
)
from godfit.runtime.numba_jit import fast_jit
from godfit.runtime.xla_ffi import answers_version_query, matrix, result, vector


@fast_jit
def _leap(flat, size, x, y, t, ways, steps, used, little, place, edge, value):
    """Takes the rays of all lanes on through empty cells, from border to border or farther, until
    each has come to a cell that is not empty or has used up its steps.

    ``size`` are the columns, and the last row and column, of the padded canvas; ``ways`` (6, LANES)
    the directions, their inverses and whether they go right and down; ``place``, ``edge`` and
    ``value`` are room to work in. No lane has a branch, and the one loop that reads the canvas,
    which cannot be done by vectors, does nothing else.
    """
    real = x.dtype.type
    width, high, wide = np.int32(size[0]), real(size[1]), real(size[2])
    dx, dy, across, down, right, below = ways[0], ways[1], ways[2], ways[3], ways[4], ways[5]
    zero, one = np.int32(0), np.int32(1)
    for _ in range(steps):
        for p in range(LANES):
            u, v = x[p] + t[p] * dx[p], y + t[p] * dy[p]
            u = u if u > 0 else real(0)
            v = v if v > 0 else real(0)
            u = u if u < wide else wide
            v = v if v < high else high
            column, row = np.int32(u), np.int32(v)
            place[p] = row * width + column
            a = (real(column) + right[p] - x[p]) * across[p]
            b = (real(row) + below[p] - y) * down[p]
            edge[p] = (a if a < b else b) + little
        for p in range(LANES):
            value[p] = flat[np.uint32(place[p])]
        moving = zero
        for p in range(LANES):
            there = t[p] + value[p]
            there = there if there > edge[p] else edge[p]
            t[p] = there if value[p] >= 0 else t[p]
            goes = one if value[p] >= 0 else zero
            used[p] += goes
            moving += goes
        if moving == 0:
            break


@fast_jit
def _pace(flat, size, x, y, t, ways, step_limit, used, step):
    """As ``_leap``, by equal steps."""
    real = x.dtype.type
    width, high, wide = np.int32(size[0]), real(size[1]), real(size[2])
    dx, dy = ways[0], ways[1]
    zero, one = np.int32(0), np.int32(1)
    for _ in range(step_limit):
        moving = zero
        for p in range(LANES):
            u, v = x[p] + t[p] * dx[p], y + t[p] * dy[p]
            u = u if u > 0 else real(0)
            v = v if v > 0 else real(0)
            u = u if u < wide else wide
            v = v if v < high else high
            value = flat[np.uint32(np.int32(v) * width + np.int32(u))]
            goes = one if (value >= 0) & (used[p] < step_limit) else zero
            t[p] = t[p] + step if goes else t[p]
            used[p] += goes
            moving += goes
        if moving == 0:
            break


@fast_jit
def _picture(free, cells, directions, sky, turn, numbers, whole, out):
    """Rows of the mean over a pixel's rays, (rows, w, 3); or, (rows, w, 3 + rays), of that mean
    without a sky and what every ray lets through, divided by the number of rays."""
    real = free.dtype.type
    rays, kinds, steps, begin = whole[0], whole[1], whole[2], whole[3]
    step, little = numbers[0], numbers[1]
    rows, w = out.shape[0], out.shape[1]
    width = free.shape[1]
    flat = free.reshape(-1)
    size = np.array([width, free.shape[0] - 1, width - 1])
    high, wide = real(size[1]), real(size[2])
    apart = out.shape[2] > 3
    table = np.empty((6, len(directions)), free.dtype)
    for k in range(len(directions)):
        dx, dy = directions[k, 0], directions[k, 1]
        table[0, k], table[1, k] = dx, dy
        table[2, k], table[3, k] = inverse(dx, real), inverse(dy, real)
        table[4, k], table[5, k] = real(dx > -1e-9), real(dy > -1e-9)
    x, t = np.empty(LANES, free.dtype), np.empty(LANES, free.dtype)
    first, own = np.empty(LANES, free.dtype), np.empty(LANES, np.int64)
    ways = np.empty((6, LANES), free.dtype)
    kind, used = np.empty(LANES, np.int64), np.empty(LANES, np.int32)
    hits = np.empty(free.shape[0] * 2 + free.shape[1] * 2, np.int64)
    light, nothing = np.empty(4, free.dtype), np.zeros(3, free.dtype)
    total = np.empty((LANES, 3), free.dtype)
    place, edges = np.empty(LANES, np.int32), np.empty(LANES, free.dtype)
    value_at = np.empty(LANES, free.dtype)
    share, half, unlimited = real(1) / real(rays), real(0.5), real(np.inf)
    for i in range(rows):
        y = real(begin + i) + real(1.5)
        for left in range(0, w, LANES):
            within = min(LANES, w - left)
            for p in range(LANES):
                column = min(left + p, w - 1)
                x[p] = real(column) + real(1.5)
                own[p] = np.int64(y) * width + column + 1
                first[p] = max(flat[own[p]], real(0))
            total[:] = 0
            for r in range(rays):
                if kinds == 1:
                    for n in range(6):
                        ways[n] = table[n, r]
                    kind[:] = r
                else:
                    for p in range(LANES):
                        kind[p] = r * kinds + turn[begin + i, min(left + p, w - 1)]
                        for n in range(6):
                            ways[n, p] = table[n, kind[p]]
                used[:] = 0
                # Out of its own cell, whatever that holds; its middle is half a cell from a border.
                if step > 0:
                    for p in range(LANES):
                        t[p], used[p] = first_step(
                            free, x[p], y, ways[0, p], ways[1, p], step, little
                        )
                    _pace(flat, size, x, y, t, ways, steps, used, step)
                else:
                    for p in range(LANES):
                        a, b = abs(ways[2, p]), abs(ways[3, p])
                        edge = half * (a if a < b else b) + little
                        t[p] = first[p] if first[p] > edge else edge
                    _leap(flat, size, x, y, t, ways, steps, used, little, place, edges, value_at)
                for p in range(within):
                    dx, dy = ways[0, p], ways[1, p]
                    u = min(max(x[p] + t[p] * dx, real(0)), wide)
                    v = min(max(y + t[p] * dy, real(0)), high)
                    cell = np.int64(v) * width + np.int64(u)
                    value = flat[cell]
                    # Nearly all rays have met the sky or something opaque, and are done.
                    if used[p] < steps and value == OUTSIDE:
                        if apart:
                            out[i, left + p, 3 + r] = share
                        else:
                            for c in range(3):
                                total[p, c] += sky[kind[p], c]
                        continue
                    if apart:
                        out[i, left + p, 3 + r] = 0
                    if (
                        used[p] < steps
                        and value == FILLED
                        and cells[cell, 3] >= 1
                        and cell != own[p]
                    ):
                        for c in range(3):
                            total[p, c] += cells[cell, c]
                        continue
                    found, ended = walk(
                        free, cells, x[p], y, dx, dy, t[p], own[p], unlimited, step, little,
                        steps - used[p], 1, hits,
                    )  # fmt: skip
                    blend(cells, hits, found, ended, nothing if apart else sky[kind[p]], light)
                    for c in range(3):
                        total[p, c] += light[c]
                    if apart and ended == LEFT:
                        out[i, left + p, 3 + r] = light[3] * share
            for p in range(within):
                for c in range(3):
                    out[i, left + p, c] = total[p, c] * share


@fast_jit
def _render(frame, real):
    if not answers_version_query(frame):
        _picture(
            matrix(frame, 0, real), matrix(frame, 1, real), matrix(frame, 2, real),
            matrix(frame, 3, real), matrix(frame, 4, np.int32), vector(frame, 5, real),
            vector(frame, 6, np.int32), result(frame, real),
        )  # fmt: skip
    return 0


def _render_single(frame):
    return _render(frame, np.float32)


def _render_double(frame):
    return _render(frame, np.float64)


FUNCTIONS = {
    ("render", False): _render_single,
    ("render", True): _render_double,
}

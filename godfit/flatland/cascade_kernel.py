"""One radiance cascade, compiled by numba; see ``godfit.flatland.cascades``.

Arrays are those of ``godfit.flatland.walk_kernel``.
"""

from __future__ import annotations

import numpy as np

from godfit.flatland.walk_kernel import FILLED, LANES, SPENT, blend, walk
from godfit.runtime.numba_jit import fast_jit
from godfit.runtime.xla_ffi import answers_version_query, matrix, result, vector


@fast_jit
def _reach(flat, size, x, y, t, limit, ways, steps, little, place, edge, value):
    """As ``_leap``, every lane from its own place and no farther than ``limit``."""
    real = x.dtype.type
    width, high, wide = np.int32(size[0]), real(size[1]), real(size[2])
    dx, dy, across, down, right, below = ways[0], ways[1], ways[2], ways[3], ways[4], ways[5]
    zero, one = np.int32(0), np.int32(1)
    for _ in range(steps):
        for p in range(LANES):
            u, v = x[p] + t[p] * dx[p], y[p] + t[p] * dy[p]
            u = u if u > 0 else real(0)
            v = v if v > 0 else real(0)
            u = u if u < wide else wide
            v = v if v < high else high
            column, row = np.int32(u), np.int32(v)
            place[p] = row * width + column
            a = (real(column) + right[p] - x[p]) * across[p]
            b = (real(row) + below[p] - y[p]) * down[p]
            edge[p] = (a if a < b else b) + little
        for p in range(LANES):
            value[p] = flat[np.uint32(place[p])]
        moving = zero
        for p in range(LANES):
            there = t[p] + value[p]
            there = there if there > edge[p] else edge[p]
            goes = one if (value[p] >= 0) & (t[p] < limit[p]) else zero
            t[p] = there if goes else t[p]
            moving += goes
        if moving == 0:
            break


@fast_jit
def _cascade(free, cells, directions, upper, numbers, whole, out):
    """One cascade with the one above it merged, (rows, columns, 4 rays): radiance and what passes
    of every ray of the probes of some rows; see ``godfit.flatland.cascades``.

    ``directions`` (rays, 2); ``upper`` (upper rows columns, 4 branch rays); ``numbers`` are
    spacing, start and end of this cascade's interval, spacing of the next (0: there is none) and
    the little; ``whole`` the first row, the upper rows and columns, and how many of its rays one
    becomes.
    """
    real = free.dtype.type
    spacing, start, end = numbers[0], numbers[1], numbers[2]
    above, little = numbers[3], numbers[4]
    begin, up_rows, up_columns, branch = whole[0], whole[1], whole[2], whole[3]
    width = free.shape[1]
    flat = free.reshape(-1)
    size = np.array([width, free.shape[0] - 1, width - 1])
    steps = np.int64(4 * (free.shape[0] + free.shape[1]))
    hits = np.empty(free.shape[0] * 2 + free.shape[1] * 2, np.int64)
    light, nothing = np.empty(4, free.dtype), np.zeros(3, free.dtype)
    x, y = np.empty(LANES, free.dtype), np.empty(LANES, free.dtype)
    t, limit = np.empty(LANES, free.dtype), np.empty(LANES, free.dtype)
    ways = np.empty((6, LANES), free.dtype)
    edges, value_at = np.empty(LANES, free.dtype), np.empty(LANES, free.dtype)
    place, weights = np.empty(LANES, np.int32), np.empty(LANES, free.dtype)
    own, seen = np.empty(LANES, np.int64), np.empty(LANES, np.int64)
    ray, column_of = np.empty(LANES, np.int64), np.empty(LANES, np.int64)
    rays, last = directions.shape[0], above == 0
    corners = 1 if last else 4
    half, one = real(0.5), real(1)
    part = one / real(branch)
    for i in range(out.shape[0]):
        out[i] = 0
        from_y = (real(begin + i) + half) * spacing + one
        first_row, low = 0, real(0)
        if not last:
            low = (from_y - one) / above - half
            first_row = int(np.floor(low))
            low -= real(first_row)
        count = out.shape[1] * rays * corners
        j, r, corner = 0, 0, 0
        for group in range(0, count, LANES):
            within = min(LANES, count - group)
            for p in range(LANES):
                from_x = (real(j) + half) * spacing + one
                dx, dy = directions[r, 0], directions[r, 1]
                # To where the ray of the upper probe starts, not to where this one's ends, so that
                # no light is lost or counted twice between the two.
                way_x, way_y = dx * (end - start), dy * (end - start)
                weights[p], seen[p] = one, 0
                if not last:
                    side = (from_x - one) / above - half
                    first_column = int(np.floor(side))
                    side -= real(first_column)
                    lower, over = corner // 2, corner % 2
                    row = min(max(first_row + lower, 0), up_rows - 1)
                    column = min(max(first_column + over, 0), up_columns - 1)
                    weights[p] = (low if lower else one - low) * (side if over else one - side)
                    seen[p] = row * up_columns + column
                    way_x += (real(column) + half) * above + one - from_x
                    way_y += (real(row) + half) * above + one - from_y
                x[p], y[p] = from_x + dx * start, from_y + dy * start
                ways[0, p], ways[1, p] = way_x, way_y
                own[p] = np.int64(y[p]) * width + np.int64(x[p]) if start == 0 else -1
                ray[p], column_of[p], t[p] = r, j, real(0)
                # The next one; after the last, the last again, which no one reads.
                if group + p + 1 < count:
                    corner += 1
                    if corner == corners:
                        corner, r = 0, r + 1
                        if r == rays:
                            r, j = 0, j + 1
            for p in range(LANES):
                way_x, way_y = ways[0, p], ways[1, p]
                far = np.sqrt(way_x * way_x + way_y * way_y)
                limit[p] = far
                far = far if far > little else little
                dx, dy = way_x / far, way_y / far
                ways[0, p], ways[1, p] = dx, dy
                ways[2, p] = one / dx if abs(dx) > 1e-9 else real(1e9)
                ways[3, p] = one / dy if abs(dy) > 1e-9 else real(1e9)
                ways[4, p] = one if dx > -1e-9 else real(0)
                ways[5, p] = one if dy > -1e-9 else real(0)
            _reach(flat, size, x, y, t, limit, ways, steps, little, place, edges, value_at)
            for p in range(within):
                to = out[i, column_of[p], 4 * ray[p] : 4 * ray[p] + 4]
                weight, cell = weights[p], np.int64(place[p])
                passing = weight
                if t[p] < limit[p] and value_at[p] == FILLED:
                    if cells[cell, 3] >= 1 and cell != own[p]:
                        for c in range(3):
                            to[c] += weight * cells[cell, c]
                        continue
                    found, _ = walk(
                        free, cells, x[p], y[p], ways[0, p], ways[1, p], t[p], own[p], limit[p],
                        real(0), little, steps, 1, hits,
                    )  # fmt: skip
                    blend(cells, hits, found, SPENT, nothing, light)
                    for c in range(3):
                        to[c] += weight * light[c]
                    passing = weight * light[3]
                if last:
                    to[3] += passing
                elif passing > 0:
                    far_light = upper[seen[p]]
                    passing *= part
                    first = 4 * branch * ray[p]
                    for n in range(branch):
                        for c in range(4):
                            to[c] += passing * far_light[first + 4 * n + c]


@fast_jit
def _merge(frame, real):
    if not answers_version_query(frame):
        _cascade(
            matrix(frame, 0, real), matrix(frame, 1, real), matrix(frame, 2, real),
            matrix(frame, 3, real), vector(frame, 4, real), vector(frame, 5, np.int32),
            result(frame, real),
        )  # fmt: skip
    return 0


def _merge_single(frame):
    return _merge(frame, np.float32)


def _merge_double(frame):
    return _merge(frame, np.float64)


FUNCTIONS = {
    ("merge", False): _merge_single,
    ("merge", True): _merge_double,
}

"""The walk of rays through a canvas, compiled by numba, and its names as XLA custom calls.

Arrays are those of ``godfit.flatland.rays.Prepared``: ``free`` (h + 2, w + 2), how far a ray may go
from anywhere in a cell without meeting anything, or FILLED or OUTSIDE; ``cells``
((h + 2) (w + 2), 4), what a cell adds to a ray and its opacity; ``directions`` (rays kinds, 2),
right and down; ``sky`` (rays kinds, 3); ``turn`` (h, w), which of the kinds a pixel's rays take.
``numbers`` are the length of a step, 0 for one that goes by ``free``, and the little that takes a
ray across a cell's border; ``whole`` are the rays, kinds, steps and the first row.
"""

from __future__ import annotations

import functools

import numpy as np
from numba import njit

from godfit.cache import numba_keeps
from godfit.radial.foreign import asks_version, matrix, register, result, vector

FILLED, OUTSIDE = -1.0, -2.0
# Pixels of a row whose rays go side by side, in vector registers.
LANES = 32
# How a walk ends: nothing more to see, outside, at its limit.
SPENT, LEFT, ARRIVED = 0, 1, 2
_compiled = njit(
    cache=numba_keeps(), nogil=True, error_model="numpy", fastmath={"contract", "nsz", "arcp"}
)


@_compiled
def _inverse(component, real):
    """1 / component, large but finite for a ray along an axis."""
    return real(1) / component if abs(component) > 1e-9 else real(1e9)


@_compiled
def _first(free, x, y, dx, dy, step, little):
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
        (real(column) + right - x) * _inverse(dx, real),
        (real(row) + below - y) * _inverse(dy, real),
    )
    return max(max(free[row, column], real(0)), edge + little), used


@_compiled
def _walk(free, cells, x, y, dx, dy, t, last, limit, step, little, steps, opaque, hits):
    """Filled cells that a ray from (x, y) crosses from ``t`` to ``limit`` on, in ``hits``, until
    ``opaque`` of them let nothing through: their number and how the walk ended. ``last`` is a cell
    that does not count any more."""
    width = free.shape[1]
    real = free.dtype.type
    across, down = _inverse(dx, real), _inverse(dy, real)
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


@_compiled
def _blend(cells, hits, found, ended, sky, light):
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


@_compiled
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


@_compiled
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


@_compiled
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
        table[2, k], table[3, k] = _inverse(dx, real), _inverse(dy, real)
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
                        t[p], used[p] = _first(free, x[p], y, ways[0, p], ways[1, p], step, little)
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
                    found, ended = _walk(
                        free, cells, x[p], y, dx, dy, t[p], own[p], unlimited, step, little,
                        steps - used[p], 1, hits,
                    )  # fmt: skip
                    _blend(cells, hits, found, ended, nothing if apart else sky[kind[p]], light)
                    for c in range(3):
                        total[p, c] += light[c]
                    if apart and ended == LEFT:
                        out[i, left + p, 3 + r] = light[3] * share
            for p in range(within):
                for c in range(3):
                    out[i, left + p, c] = total[p, c] * share


@_compiled
def _moved(free, cells, directions, sky, turn, numbers, whole, d_cells, d_sky, out):
    """``_picture``'s derivative along d_cells and d_sky."""
    real = free.dtype.type
    rays, kinds, steps, begin = whole[0], whole[1], whole[2], whole[3]
    step, little = numbers[0], numbers[1]
    width = free.shape[1]
    hits = np.empty(free.shape[0] * 2 + free.shape[1] * 2, np.int64)
    share, unlimited = real(1) / real(rays), real(np.inf)
    for i in range(out.shape[0]):
        y = real(begin + i) + real(1.5)
        for j in range(out.shape[1]):
            x = real(j) + real(1.5)
            to = out[i, j]
            to[:] = 0
            own = np.int64(y) * width + np.int64(x)
            for r in range(rays):
                k = r * kinds + turn[begin + i, j]
                dx, dy = directions[k, 0], directions[k, 1]
                t, used = _first(free, x, y, dx, dy, step, little)
                found, ended = _walk(
                    free, cells, x, y, dx, dy, t, own, unlimited, step, little, steps - used, 2,
                    hits,
                )  # fmt: skip
                passing, d_passing = share, real(0)
                for n in range(found):
                    cell = hits[n]
                    for c in range(3):
                        to[c] += d_passing * cells[cell, c] + passing * d_cells[cell, c]
                    open_ = 1 - cells[cell, 3]
                    d_passing = d_passing * open_ - passing * d_cells[cell, 3]
                    passing *= open_
                if ended == LEFT:
                    for c in range(3):
                        to[c] += d_passing * sky[k, c] + passing * d_sky[k, c]


@_compiled
def _pulled(free, cells, directions, sky, turn, numbers, whole, pull, out):
    """``_moved``'s transpose: ``pull`` (h, 3 w), out (1, cells + rays kinds, 4)."""
    real = free.dtype.type
    rays, kinds, steps, begin, end = whole[0], whole[1], whole[2], whole[3], whole[4]
    step, little = numbers[0], numbers[1]
    width, count = free.shape[1], cells.shape[0]
    hits = np.empty(free.shape[0] * 2 + free.shape[1] * 2, np.int64)
    share, unlimited = real(1) / real(rays), real(np.inf)
    passings, behind = np.empty(len(hits) + 1, free.dtype), np.empty(3, free.dtype)
    to = out[0]
    to[:] = 0
    for i in range(begin, end):
        y = real(i) + real(1.5)
        for j in range(turn.shape[1]):
            x = real(j) + real(1.5)
            own = np.int64(y) * width + np.int64(x)
            g = pull[i, 3 * j : 3 * j + 3]
            if g[0] == 0 and g[1] == 0 and g[2] == 0:
                continue
            for r in range(rays):
                k = r * kinds + turn[i, j]
                dx, dy = directions[k, 0], directions[k, 1]
                t, used = _first(free, x, y, dx, dy, step, little)
                found, ended = _walk(
                    free, cells, x, y, dx, dy, t, own, unlimited, step, little, steps - used, 2,
                    hits,
                )  # fmt: skip
                passings[0] = share
                for n in range(found):
                    passings[n + 1] = passings[n] * (1 - cells[hits[n], 3])
                behind[:] = 0
                if ended == LEFT:
                    for c in range(3):
                        behind[c] = sky[k, c]
                        to[count + k, c] += g[c] * passings[found]
                for n in range(found - 1, -1, -1):
                    cell = hits[n]
                    lost = real(0)
                    for c in range(3):
                        to[cell, c] += g[c] * passings[n]
                        lost += g[c] * behind[c]
                        behind[c] = cells[cell, c] + (1 - cells[cell, 3]) * behind[c]
                    to[cell, 3] -= passings[n] * lost


@_compiled
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


@_compiled
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
                    found, _ = _walk(
                        free, cells, x[p], y[p], ways[0, p], ways[1, p], t[p], own[p], limit[p],
                        real(0), little, steps, 1, hits,
                    )  # fmt: skip
                    _blend(cells, hits, found, SPENT, nothing, light)
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


@_compiled
def _render(frame, real):
    if not asks_version(frame):
        _picture(
            matrix(frame, 0, real), matrix(frame, 1, real), matrix(frame, 2, real),
            matrix(frame, 3, real), matrix(frame, 4, np.int32), vector(frame, 5, real),
            vector(frame, 6, np.int32), result(frame, real),
        )  # fmt: skip
    return 0


@_compiled
def _tangent(frame, real):
    if not asks_version(frame):
        _moved(
            matrix(frame, 0, real), matrix(frame, 1, real), matrix(frame, 2, real),
            matrix(frame, 3, real), matrix(frame, 4, np.int32), vector(frame, 5, real),
            vector(frame, 6, np.int32), matrix(frame, 7, real), matrix(frame, 8, real),
            result(frame, real),
        )  # fmt: skip
    return 0


@_compiled
def _transpose(frame, real):
    if not asks_version(frame):
        _pulled(
            matrix(frame, 0, real), matrix(frame, 1, real), matrix(frame, 2, real),
            matrix(frame, 3, real), matrix(frame, 4, np.int32), vector(frame, 5, real),
            vector(frame, 6, np.int32), matrix(frame, 7, real), result(frame, real),
        )  # fmt: skip
    return 0


@_compiled
def _merge(frame, real):
    if not asks_version(frame):
        _cascade(
            matrix(frame, 0, real), matrix(frame, 1, real), matrix(frame, 2, real),
            matrix(frame, 3, real), vector(frame, 4, real), vector(frame, 5, np.int32),
            result(frame, real),
        )  # fmt: skip
    return 0


def _render_single(frame):
    return _render(frame, np.float32)


def _render_double(frame):
    return _render(frame, np.float64)


def _tangent_single(frame):
    return _tangent(frame, np.float32)


def _tangent_double(frame):
    return _tangent(frame, np.float64)


def _transpose_single(frame):
    return _transpose(frame, np.float32)


def _transpose_double(frame):
    return _transpose(frame, np.float64)


def _merge_single(frame):
    return _merge(frame, np.float32)


def _merge_double(frame):
    return _merge(frame, np.float64)


@functools.cache
def target(kind: str, double: bool) -> str:
    """The name of a compiled function, which is compiled or loaded when it is first asked for."""
    function = {
        ("render", False): _render_single,
        ("render", True): _render_double,
        ("tangent", False): _tangent_single,
        ("tangent", True): _tangent_double,
        ("transpose", False): _transpose_single,
        ("transpose", True): _transpose_double,
        ("merge", False): _merge_single,
        ("merge", True): _merge_double,
    }[kind, double]
    name = f"godfit_flatland{function.__name__}"
    register(name, function)
    return name

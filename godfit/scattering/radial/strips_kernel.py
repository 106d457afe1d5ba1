"""The loops of ``godfit.scattering.radial.strips``, compiled by numba, and their XLA custom calls.

``mask`` is the padded mask (h + 2, w + 3), whose border repeats the edge. ``flat`` holds the values
of its flat cells, NaN for others. ``ray`` (5,) holds the numbers of
``godfit.scattering.radial.derivatives.RayParameters``. Sums are S, or S, S_r, G_x and G_y (see
there).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from godfit.runtime.call_frame import (
    LINE_BYTES,
    allocate,
    answers_version_query,
    array_at,
    matrix,
    release,
    result,
    vector,
)
from godfit.runtime.numba_jit import fast_jit, inlined_jit
from godfit.scattering.radial.strips import FLAT_CELL, TILE_ROWS

TILE_COLUMNS = 64
"""Columns of a tile: the fixed length of the inner loops, which fills the vector registers."""
TILE_ROWS_OF_FOUR_SUMS = 12
"""Rows of a tile of all four sums: more do not stay in that cache."""
POINT_GROUP = 32
"""Points whose sums are computed side by side: an inner loop that fills the vector registers."""
MIN_TILE_RUN = 32
"""Fewest points in a row that are worth a tile: it has TILE_COLUMNS, however many are used."""
NUMBER_BYTES = 8
"""Bytes of a number in the memory of a call, at most."""


class Scratch(NamedTuple):
    """Arrays that the tiles of a call reuse.

    ``total`` (1 or 4, rows, TILE_COLUMNS) holds a tile's sums. ``level`` (2,) holds what flat taps
    add to S and S_r of every pixel. ``strip`` and ``slope`` (mask rows, TILE_COLUMNS) hold the mask
    rows resampled along the columns, and their slopes. ``column`` and ``row`` hold, for each column
    and row of the tile, the index of a texel and the fraction of the way to the next. ``point``
    (2, POINT_GROUP) holds positions, ``texel`` indices and ``part`` (2, POINT_GROUP) fractions of
    a group of points.
    """

    total: np.ndarray
    level: np.ndarray
    strip: np.ndarray
    slope: np.ndarray
    column: tuple[np.ndarray, np.ndarray]
    row: tuple[np.ndarray, np.ndarray]
    point: np.ndarray
    texel: np.ndarray
    part: np.ndarray


@fast_jit
def _lines(count):
    """Bytes of ``count`` numbers, a multiple of LINE_BYTES."""
    return (NUMBER_BYTES * count + LINE_BYTES - 1) // LINE_BYTES * LINE_BYTES


@fast_jit
def _scratch_bytes(sums, rows, mask_rows):
    """Bytes of ``_scratch``, and of the way to its first line."""
    tile, strip = _lines(sums * rows * TILE_COLUMNS), _lines(mask_rows * TILE_COLUMNS)
    ends = _lines(2) + 2 * _lines(TILE_COLUMNS) + 2 * _lines(rows)
    return LINE_BYTES + tile + 2 * strip + ends + 5 * _lines(POINT_GROUP)


@fast_jit
def _scratch(address, mask, sums, rows, mask_rows):
    """The arrays of a call, in the memory at ``address``."""
    real = mask.dtype.type
    total = (address + LINE_BYTES - 1) // LINE_BYTES * LINE_BYTES
    level = total + _lines(sums * rows * TILE_COLUMNS)
    strip = level + _lines(2)
    slope = strip + _lines(mask_rows * TILE_COLUMNS)
    column = slope + _lines(mask_rows * TILE_COLUMNS)
    row = column + 2 * _lines(TILE_COLUMNS)
    point = row + 2 * _lines(rows)
    texel = point + 2 * _lines(POINT_GROUP)
    part = texel + _lines(POINT_GROUP)
    return Scratch(
        array_at(total, real, (sums, rows, TILE_COLUMNS)),
        array_at(level, np.float64, (2,)),
        array_at(strip, real, (mask_rows, TILE_COLUMNS)),
        array_at(slope, real, (mask_rows, TILE_COLUMNS)),
        (
            array_at(column, np.uint64, (TILE_COLUMNS,)),
            array_at(column + _lines(TILE_COLUMNS), real, (TILE_COLUMNS,)),
        ),
        (array_at(row, np.uint64, (rows,)), array_at(row + _lines(rows), real, (rows,))),
        array_at(point, np.float64, (2, POINT_GROUP)),
        array_at(texel, np.uint64, (POINT_GROUP,)),
        array_at(part, real, (2, POINT_GROUP)),
    )


@fast_jit
def _is_finite(ray):
    finite = True
    for number in ray:
        finite &= np.isfinite(number)
    return finite


@fast_jit
def _clip(position, last):
    """Positions beyond the edge are clamped into the border, which repeats it."""
    return min(max(position, -1.0), last)


@fast_jit
def _doubles(ray):
    """The ray's parameters in float64, in which positions are computed."""
    a, b, c, d, e = ray[0], ray[1], ray[2], ray[3], ray[4]
    return float(a), float(b), float(c), float(d), float(e)


@fast_jit
def _flat_value(flat, top, bottom, left, right):
    """The value of the mask's rows top..bottom and columns left..right; NaN if it has several."""
    value = flat[top // FLAT_CELL, left // FLAT_CELL]
    for i in range(top // FLAT_CELL, bottom // FLAT_CELL + 1):
        for j in range(left // FLAT_CELL, right // FLAT_CELL + 1):
            # A cell with several values is NaN, which equals nothing.
            if flat[i, j] != value:
                return np.nan
    return value


@fast_jit
def _span(first, last, scale, shift, limit):
    """First and last index in the padded mask for reads at scale * (first..last) + shift."""
    a, b = scale * first + shift, scale * last + shift
    low, high = _clip(min(a, b), limit), _clip(max(a, b), limit)
    return math.floor(low) + 1, math.floor(high) + 2


@fast_jit
def _mask_rows(step, lag, count, size):
    """Mask rows that a tile may need, at most the mask's ``size``: more than the tile has where
    taps lie beyond the light."""
    scale = max(abs(1 - (1 - lag) * step), abs(1 - (count - lag) * step))
    return int(min(TILE_ROWS * scale + 4, size))


@fast_jit
def _tile(padded, ray, count, corner, rows, scratch):
    """Compute the sums of ``rows`` x TILE_COLUMNS pixels from ``corner`` (row, column) on.

    They are set in ``scratch.total``, without what flat taps add to S and S_r of every pixel, which
    is set in ``scratch.level``. ``padded`` is (mask, flat).
    """
    (mask, flat), (top, left) = padded, corner
    total, level, strip, slope = scratch.total, scratch.level, scratch.strip, scratch.slope
    column, row = scratch.column, scratch.row
    total[:] = 0
    level[:] = 0
    real = mask.dtype.type
    one = np.uint64(1)
    light_x, light_y, ratio, step, lag = _doubles(ray)
    last_row, last_column = mask.shape[0] - 3.0, mask.shape[1] - 4.0
    weight, before = 1.0, 0.0
    for k in range(1, count + 1):
        t = (k - lag) * step
        c, c_r = weight, (k - 1) * before
        before = weight
        weight *= ratio
        scale, shift_x, shift_y = 1 - t, t * light_x, t * light_y
        first, last = _span(top, top + rows - 1, scale, shift_y, last_row)
        a, b = _span(left, left + TILE_COLUMNS - 1, scale, shift_x, last_column)
        value = _flat_value(flat, first, last, a, b)
        if value == value:  # not NaN: one value
            level[0] += c * value
            level[1] += c_r * value
            continue
        for x in range(TILE_COLUMNS):
            position = _clip(scale * (left + x) + shift_x, last_column)
            whole = np.floor(position)
            column[0][x], column[1][x] = np.uint64(whole + 1), real(position - whole)
        for y in range(np.uint64(rows)):
            position = _clip(scale * (top + y) + shift_y, last_row)
            whole = np.floor(position)
            row[0][y], row[1][y] = np.uint64(max(whole + 1 - first, 0.0)), real(position - whole)
        begin, used = np.uint64(first), np.uint64(last - first + 1)
        if total.shape[0] == 1:
            for j in range(used):
                for x in range(TILE_COLUMNS):
                    i = column[0][x]
                    a, b = mask[begin + j, i], mask[begin + j, i + one]
                    strip[j, x] = a + column[1][x] * (b - a)
            for y in range(np.uint64(rows)):
                j = row[0][y]
                lower = real(c) * row[1][y]
                upper = real(c) - lower
                for x in range(TILE_COLUMNS):
                    total[0, y, x] += upper * strip[j, x] + lower * strip[j + one, x]
            continue
        for j in range(used):
            for x in range(TILE_COLUMNS):
                i = column[0][x]
                a, b = mask[begin + j, i], mask[begin + j, i + one]
                strip[j, x] = a + column[1][x] * (b - a)
                slope[j, x] = b - a
        c, c_r, c_t = real(c), real(c_r), real(c * (k - lag))
        for y in range(np.uint64(rows)):
            j, f = row[0][y], row[1][y]
            for x in range(TILE_COLUMNS):
                down = strip[j + one, x] - strip[j, x]
                value = strip[j, x] + f * down
                total[0, y, x] += c * value
                total[1, y, x] += c_r * value
                total[2, y, x] += c_t * (slope[j, x] + f * (slope[j + one, x] - slope[j, x]))
                total[3, y, x] += c_t * down


@fast_jit
def _picture_rows(mask, flat, ray, count, begin, out):
    """The sums of the picture's rows from ``begin`` on, set in ``out`` (1 or 4, rows, w)."""
    real = mask.dtype.type
    sums, rows, width = out.shape
    if not _is_finite(ray):
        out[:] = np.nan
        return
    tile_rows = TILE_ROWS if sums == 1 else TILE_ROWS_OF_FOUR_SUMS
    mask_rows = _mask_rows(float(ray[3]), float(ray[4]), count, mask.shape[0])
    memory = allocate(_scratch_bytes(sums, tile_rows, mask_rows))
    if memory == 0:
        out[:] = np.nan
        return
    scratch = _scratch(memory, mask, sums, tile_rows, mask_rows)
    for top in range(0, rows, tile_rows):
        high = min(tile_rows, rows - top)
        for left in range(0, width, TILE_COLUMNS):
            _tile((mask, flat), ray, count, (float(begin + top), float(left)), high, scratch)
            wide = min(TILE_COLUMNS, width - left)
            for s in range(sums):
                add = real(scratch.level[s]) if s < 2 else real(0)
                for y in range(high):
                    for x in range(wide):
                        out[s, top + y, left + x] = scratch.total[s, y, x] + add
    release(memory)


@fast_jit
def _run_length(at, begin):
    """How many points from ``begin`` on, at most TILE_COLUMNS, follow each other in a row."""
    length = 1
    while (
        length < min(TILE_COLUMNS, at.shape[1] - begin)
        and at[1, begin + length] == at[1, begin]
        and at[0, begin + length] == at[0, begin] + length
    ):
        length += 1
    return length


@fast_jit
def point_sums(mask, flat, at, ray, count, out):
    """The sums at columns and rows ``at`` (2, points), set in ``out`` (1 or 4, 1, points)."""
    real = mask.dtype.type
    sums, points = out.shape[0], out.shape[2]
    if not _is_finite(ray):
        out[:] = np.nan
        return
    tile_rows, mask_rows = np.int64(1), np.int64(2)
    size = _scratch_bytes(sums, tile_rows, mask_rows)
    memory = allocate(size + NUMBER_BYTES * points)
    if memory == 0:
        out[:] = np.nan
        return
    scratch = _scratch(memory, mask, sums, tile_rows, mask_rows)
    # Points that are in no long run are summed in groups, at the end.
    single, singles = array_at(memory + size, np.int64, (points,)), 0
    # Both have the types that ``_picture_rows`` passes to ``_tile``, so that it is compiled once.
    begin, height = np.int64(0), np.int64(1)
    while begin < points:
        run = _run_length(at, begin)
        if run >= MIN_TILE_RUN:
            corner = np.float64(at[1, begin]), np.float64(at[0, begin])
            _tile((mask, flat), ray, count, corner, height, scratch)
            for s in range(sums):
                add = real(scratch.level[s]) if s < 2 else real(0)
                for p in range(run):
                    out[s, 0, begin + p] = scratch.total[s, 0, p] + add
        else:
            for p in range(run):
                single[singles + p] = begin + p
            singles += run
        begin += run
    total = scratch.total
    for begin in range(0, singles, POINT_GROUP):
        group = single[begin : min(begin + POINT_GROUP, singles)]
        total[:] = 0
        _add_group(mask, at, ray, count, group, scratch)
        for s in range(sums):
            for p in range(len(group)):
                out[s, 0, group[p]] = total[s, 0, p]
    release(memory)


@fast_jit
def _add_group(mask, at, ray, count, group, scratch):
    """Add the sums of the points ``group`` (n,), at most POINT_GROUP, to ``scratch.total``."""
    real, total = mask.dtype.type, scratch.total
    texels = array_at(np.int64(mask.ctypes.data), real, (mask.size,))
    next_row, one = np.uint64(mask.shape[1]), np.uint64(1)
    light_x, light_y, ratio, step, lag = _doubles(ray)
    last_row, last_column = mask.shape[0] - 3.0, mask.shape[1] - 4.0
    x, y, texel = scratch.point[0], scratch.point[1], scratch.texel
    across, down = scratch.part[0], scratch.part[1]
    for p in range(POINT_GROUP):
        point = group[min(p, len(group) - 1)]
        x[p], y[p] = at[0, point], at[1, point]
    weight, before = 1.0, 0.0
    for k in range(1, count + 1):
        t = (k - lag) * step
        c, c_r, c_t = real(weight), real((k - 1) * before), real(weight * (k - lag))
        before = weight
        weight *= ratio
        for p in range(POINT_GROUP):
            column = _clip(x[p] + t * (light_x - x[p]), last_column)
            row = _clip(y[p] + t * (light_y - y[p]), last_row)
            i, j = np.floor(column), np.floor(row)
            texel[p] = np.uint64((j + 1) * mask.shape[1] + (i + 1))
            across[p], down[p] = real(column - i), real(row - j)
        if total.shape[0] == 1:
            for p in range(POINT_GROUP):
                n, f = texel[p], across[p]
                upper = texels[n] + f * (texels[n + one] - texels[n])
                n += next_row
                lower = texels[n] + f * (texels[n + one] - texels[n])
                total[0, 0, p] += c * (upper + down[p] * (lower - upper))
            continue
        for p in range(POINT_GROUP):
            n, f = texel[p], across[p]
            top, top_slope = texels[n], texels[n + one] - texels[n]
            n += next_row
            low, low_slope = texels[n], texels[n + one] - texels[n]
            upper, lower = top + f * top_slope, low + f * low_slope
            value = upper + down[p] * (lower - upper)
            total[0, 0, p] += c * value
            total[1, 0, p] += c_r * value
            total[2, 0, p] += c_t * (top_slope + down[p] * (low_slope - top_slope))
            total[3, 0, p] += c_t * (lower - upper)


@inlined_jit
def _picture(frame, real):
    if not answers_version_query(frame):
        mask, flat = matrix(frame, 0, real), matrix(frame, 1, real)
        ray, count_begin = vector(frame, 2, real), vector(frame, 3, np.int32)
        _picture_rows(mask, flat, ray, count_begin[0], count_begin[1], result(frame, real))
    return 0


@inlined_jit
def _points(frame, real):
    if not answers_version_query(frame):
        mask, flat = matrix(frame, 0, real), matrix(frame, 1, real)
        at, ray = matrix(frame, 2, real), vector(frame, 3, real)
        count = vector(frame, 4, np.int32)[0]
        point_sums(mask, flat, at, ray, count, result(frame, real))
    return 0


def _picture_single(frame):
    return _picture(frame, np.float32)


def _picture_double(frame):
    return _picture(frame, np.float64)


def _points_single(frame):
    return _points(frame, np.float32)


def _points_double(frame):
    return _points(frame, np.float64)

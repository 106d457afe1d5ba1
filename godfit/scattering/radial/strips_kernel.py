"""The loops of ``godfit.scattering.radial.strips``, compiled by numba, and their names as XLA custom calls.

Arrays are the padded mask (h + 2, w + 3), whose border is there twice, and ``numbers``, the five of
``godfit.scattering.radial.derivatives.Numbers``. Sums are S, or S, S_r, G_x and G_y (see there).
"""

from __future__ import annotations

import math

import numpy as np

from godfit.runtime.numba_jit import fast_jit, inlined_jit
from godfit.runtime.xla_ffi import answers_version_query, declare, matrix, register, result, vector

# Rows and columns of a tile: an inner loop of a fixed length that fills the vector registers.
HIGH, WIDE = 32, 64
# Rows of a tile of all four sums: more do not stay in the fastest cache.
HIGH_OF_FOUR = 12
# Side of the cells that are known to be flat or not.
CELL = 8
# Points that are summed side by side.
GROUP = 32


@fast_jit
def _clip(value, last):
    """Positions beyond the border read the border, which is there twice."""
    return min(max(value, -1.0), last)


@fast_jit
def _doubles(numbers):
    a, b, c, d, e = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    return float(a), float(b), float(c), float(d), float(e)


@fast_jit
def _flat_value(flat, top, bottom, left, right):
    """The one value of the mask's rows top..bottom, columns left..right; NaN if there are more."""
    value = flat[top // CELL, left // CELL]
    for i in range(top // CELL, bottom // CELL + 1):
        for j in range(left // CELL, right // CELL + 1):
            # A cell with several values is NaN, which equals nothing.
            if flat[i, j] != value:
                return np.nan
    return value


@fast_jit
def _span(first, last, scale, shift, limit):
    """First and last index that reads at scale * (first..last) + shift need, in a padded mask."""
    a, b = scale * first + shift, scale * last + shift
    low, high = _clip(min(a, b), limit), _clip(max(a, b), limit)
    return math.floor(low) + 1, math.floor(high) + 2


@fast_jit
def _reach(step, lag, count, size):
    """Mask rows that a tile may need: more than its own height where taps lie beyond the light."""
    scale = max(abs(1 - (1 - lag) * step), abs(1 - (count - lag) * step))
    return int(min(HIGH * scale + 4, size))


@fast_jit
def _tile(mask, flat, numbers, count, top, left, rows, total, level, strip, slope, column, row):
    """The sums of ``rows`` x WIDE pixels from (top, left) on, added to ``total``, but for what flat
    taps add to S and S_r everywhere, which is added to ``level``."""
    real = mask.dtype.type
    one = np.uint64(1)
    light_x, light_y, ratio, step, lag = _doubles(numbers)
    last_row, last_column = mask.shape[0] - 3.0, mask.shape[1] - 4.0
    weight, before = 1.0, 0.0
    for k in range(1, count + 1):
        t = (k - lag) * step
        c, c_r = weight, (k - 1) * before
        before = weight
        weight *= ratio
        scale, shift_x, shift_y = 1 - t, t * light_x, t * light_y
        first, last = _span(top, top + rows - 1, scale, shift_y, last_row)
        a, b = _span(left, left + WIDE - 1, scale, shift_x, last_column)
        value = _flat_value(flat, first, last, a, b)
        if value == value:
            level[0] += c * value
            level[1] += c_r * value
            continue
        for x in range(WIDE):
            place = _clip(scale * (left + x) + shift_x, last_column)
            whole = np.floor(place)
            column[0][x], column[1][x] = np.uint64(whole + 1), real(place - whole)
        for y in range(np.uint64(rows)):
            place = _clip(scale * (top + y) + shift_y, last_row)
            whole = np.floor(place)
            row[0][y], row[1][y] = np.uint64(max(whole + 1 - first, 0.0)), real(place - whole)
        begin, used = np.uint64(first), np.uint64(last - first + 1)
        if total.shape[0] == 1:
            for j in range(used):
                for x in range(WIDE):
                    i = column[0][x]
                    a, b = mask[begin + j, i], mask[begin + j, i + one]
                    strip[j, x] = a + column[1][x] * (b - a)
            for y in range(np.uint64(rows)):
                j = row[0][y]
                lower = real(c) * row[1][y]
                upper = real(c) - lower
                for x in range(WIDE):
                    total[0, y, x] += upper * strip[j, x] + lower * strip[j + one, x]
            continue
        for j in range(used):
            for x in range(WIDE):
                i = column[0][x]
                a, b = mask[begin + j, i], mask[begin + j, i + one]
                strip[j, x] = a + column[1][x] * (b - a)
                slope[j, x] = b - a
        c, c_r, c_t = real(c), real(c_r), real(c * (k - lag))
        for y in range(np.uint64(rows)):
            j, f = row[0][y], row[1][y]
            for x in range(WIDE):
                down = strip[j + one, x] - strip[j, x]
                value = strip[j, x] + f * down
                total[0, y, x] += c * value
                total[1, y, x] += c_r * value
                total[2, y, x] += c_t * (slope[j, x] + f * (slope[j + one, x] - slope[j, x]))
                total[3, y, x] += c_t * down


@fast_jit
def _rows(mask, flat, numbers, count, begin, out):
    """Rows from ``begin`` on of the sums, ``out`` (1 or 4, rows, w); the mask is padded."""
    real = mask.dtype.type
    sums, rows, width = out.shape
    if not np.isfinite(numbers).all():
        out[:] = np.nan
        return
    reach = _reach(float(numbers[3]), float(numbers[4]), count, mask.shape[0])
    strip, slope = np.empty((reach, WIDE), mask.dtype), np.empty((reach, WIDE), mask.dtype)
    column = np.empty(WIDE, np.uint64), np.empty(WIDE, mask.dtype)
    most = HIGH if sums == 1 else HIGH_OF_FOUR
    row = np.empty(most, np.uint64), np.empty(most, mask.dtype)
    total = np.empty((sums, most, WIDE), mask.dtype)
    level = np.empty(2)
    for top in range(0, rows, most):
        high = min(most, rows - top)
        for left in range(0, width, WIDE):
            total[:] = 0
            level[:] = 0
            _tile(
                mask, flat, numbers, count, float(begin + top), float(left), high,
                total, level, strip, slope, column, row,
            )  # fmt: skip
            wide = min(WIDE, width - left)
            for s in range(sums):
                add = real(level[s]) if s < 2 else real(0)
                for y in range(high):
                    for x in range(wide):
                        out[s, top + y, left + x] = total[s, y, x] + add


@fast_jit
def _run(at, begin):
    """How many points from ``begin`` on, at most WIDE, follow each other in a row."""
    length = 1
    while (
        length < min(WIDE, at.shape[1] - begin)
        and at[1, begin + length] == at[1, begin]
        and at[0, begin + length] == at[0, begin] + length
    ):
        length += 1
    return length


@fast_jit
def scattered(mask, flat, at, numbers, count, out):
    """``out`` (1 or 4, 1, points) at columns and rows ``at`` (2, points)."""
    real = mask.dtype.type
    sums, points = out.shape[0], out.shape[2]
    if not np.isfinite(numbers).all():
        out[:] = np.nan
        return
    strip, slope = np.empty((2, WIDE), mask.dtype), np.empty((2, WIDE), mask.dtype)
    column = np.empty(WIDE, np.uint64), np.empty(WIDE, mask.dtype)
    row = np.empty(1, np.uint64), np.empty(1, mask.dtype)
    total = np.empty((sums, 1, WIDE), mask.dtype)
    level = np.empty(2)
    single, alone = np.empty(points, np.int64), 0
    # Of one type from the start, and as ``_rows`` has them: nothing is compiled twice.
    begin, height = np.int64(0), np.int64(1)
    while begin < points:
        run = _run(at, begin)
        if run >= GROUP:
            total[:] = 0
            level[:] = 0
            top, left = np.float64(at[1, begin]), np.float64(at[0, begin])
            _tile(
                mask, flat, numbers, count, top, left, height,
                total, level, strip, slope, column, row,
            )  # fmt: skip
            for s in range(sums):
                add = real(level[s]) if s < 2 else real(0)
                for p in range(run):
                    out[s, 0, begin + p] = total[s, 0, p] + add
        else:
            for p in range(run):
                single[alone + p] = begin + p
            alone += run
        begin += run
    for begin in range(0, alone, GROUP):
        some = single[begin : min(begin + GROUP, alone)]
        total[:] = 0
        _group(mask, at, numbers, count, some, total)
        for s in range(sums):
            for p in range(len(some)):
                out[s, 0, some[p]] = total[s, 0, p]


@fast_jit
def _group(mask, at, numbers, count, some, total):
    """The sums of at most GROUP points ``some`` (n,), wherever they lie, added to ``total``."""
    real = mask.dtype.type
    texels, next_row, one = mask.reshape(-1), np.uint64(mask.shape[1]), np.uint64(1)
    light_x, light_y, ratio, step, lag = _doubles(numbers)
    last_row, last_column = mask.shape[0] - 3.0, mask.shape[1] - 4.0
    x, y = np.empty(GROUP), np.empty(GROUP)
    texel = np.empty(GROUP, np.uint64)
    across, down = np.empty(GROUP, mask.dtype), np.empty(GROUP, mask.dtype)
    for p in range(GROUP):
        point = some[min(p, len(some) - 1)]
        x[p], y[p] = at[0, point], at[1, point]
    weight, before = 1.0, 0.0
    for k in range(1, count + 1):
        t = (k - lag) * step
        c, c_r, c_t = real(weight), real((k - 1) * before), real(weight * (k - lag))
        before = weight
        weight *= ratio
        for p in range(GROUP):
            column = _clip(x[p] + t * (light_x - x[p]), last_column)
            row = _clip(y[p] + t * (light_y - y[p]), last_row)
            i, j = np.floor(column), np.floor(row)
            texel[p] = np.uint64((j + 1) * mask.shape[1] + (i + 1))
            across[p], down[p] = real(column - i), real(row - j)
        if total.shape[0] == 1:
            for p in range(GROUP):
                n, f = texel[p], across[p]
                upper = texels[n] + f * (texels[n + one] - texels[n])
                n += next_row
                lower = texels[n] + f * (texels[n + one] - texels[n])
                total[0, 0, p] += c * (upper + down[p] * (lower - upper))
            continue
        for p in range(GROUP):
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
        whole = vector(frame, 3, np.int32)
        _rows(mask, flat, vector(frame, 2, real), whole[0], whole[1], result(frame, real))
    return 0


@inlined_jit
def _points(frame, real):
    if not answers_version_query(frame):
        mask, flat = matrix(frame, 0, real), matrix(frame, 1, real)
        at, numbers = matrix(frame, 2, real), vector(frame, 3, real)
        count = vector(frame, 4, np.int32)[0]
        scattered(mask, flat, at, numbers, count, result(frame, real))
    return 0


def _picture_single(frame):
    return _picture(frame, np.float32)


def _picture_double(frame):
    return _picture(frame, np.float64)


def _points_single(frame):
    return _points(frame, np.float32)


def _points_double(frame):
    return _points(frame, np.float64)


NAMES = declare(
    "godfit",
    {
        ("picture", False): _picture_single,
        ("picture", True): _picture_double,
        ("points", False): _points_single,
        ("points", True): _points_double,
    },
)


def target(kind: str, double: bool) -> str:
    """The name of a compiled function, which XLA knows from now on."""
    name = NAMES[kind, double]
    register(name)
    return name

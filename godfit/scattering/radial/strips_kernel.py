"""The loops of ``godfit.scattering.radial.strips``, compiled by numba, and their XLA custom calls.

Arguments of a call are the padded mask (h + 2, w + 3), whose border repeats the edge; ``flat``, the
values of its flat cells, NaN for others; ``at`` (2, points), columns and rows; the numbers of
``godfit.scattering.radial.derivatives.RayParameters``, five for each of n rays; and, two for each,
the number of taps and the first row. The result is (1 or 4, n, points): S, or S, S_r, G_x and G_y
(see there). Without points, (2, 0), it is (1 or 4, rows, w): so many rows of the picture.

A first command waits for numba, which compiles numbers behind pointers in half the time of arrays,
and one function for all calls in half the time of two.
"""

from __future__ import annotations

import math

import numpy as np

from godfit.runtime.call_frame import (
    allocate,
    answers_version_query,
    argument,
    data,
    first_result,
    length,
    pointer,
    release,
)
from godfit.runtime.numba_jit import fast_jit, inlined_jit
from godfit.scattering.radial.strip_sizes import FLAT_CELL, TILE_ROWS

TILE_COLUMNS = 128
"""Columns of a tile: the fixed length of the inner loops, which fills the vector registers."""
TILE_ROWS_OF_FOUR_SUMS = 12
"""Rows of a tile of all four sums: more do not stay in that cache."""
POINT_GROUP = 32
"""Points whose sums are computed side by side: an inner loop that fills the vector registers."""
MIN_TILE_RUN = 64
"""Fewest points in a row that are worth a tile: it has TILE_COLUMNS, however many are used."""
NUMBER_BYTES = 8
"""Bytes of a number in the memory of a call, at most."""

# The memory of a call, in numbers from its beginning. Of each column and row of a tile, or of each
# point of a group: the index of a texel, and the fraction of the way to the next.
COLUMN_TEXEL = 0
COLUMN_PART = COLUMN_TEXEL + TILE_COLUMNS
ROW_TEXEL = COLUMN_PART + TILE_COLUMNS
ROW_PART = ROW_TEXEL + TILE_COLUMNS
# Columns, rows and indices of the points of a group.
POINT_X = ROW_PART + TILE_COLUMNS
POINT_Y = POINT_X + POINT_GROUP
POINT_INDEX = POINT_Y + POINT_GROUP
# A tile's sums (1 or 4, rows, TILE_COLUMNS). The mask rows that it reads follow, resampled along
# the columns, (mask rows, TILE_COLUMNS), and their slopes.
TOTAL = POINT_INDEX + POINT_GROUP
STRIPS = TOTAL + max(TILE_ROWS, 4 * TILE_ROWS_OF_FOUR_SUMS) * TILE_COLUMNS


@inlined_jit
def _clip(position, last):
    """Positions beyond the edge are clamped into the border, which repeats it."""
    return min(max(position, -1.0), last)


@fast_jit
def _tile(real, padded, size, ray, count, corner, rows, scratch):
    """Compute the sums of ``rows`` x TILE_COLUMNS pixels from ``corner`` (column, row) on.

    They are set in the memory at ``scratch``, without what flat taps add to S and S_r of every
    pixel, which is returned. ``padded`` holds the addresses of the mask and its flat cells, and
    ``size`` the mask's rows and columns, the flat cells in a row, the number of sums and the rows
    of the strips. Positions are computed in float64.
    """
    mask, flat = pointer(padded[0], real), pointer(padded[1], real)
    height, width, cells, sums, strip_rows = size
    column, across = pointer(scratch, np.int32), pointer(scratch + NUMBER_BYTES * COLUMN_PART, real)
    row = pointer(scratch + NUMBER_BYTES * ROW_TEXEL, np.int64)
    down = pointer(scratch + NUMBER_BYTES * ROW_PART, real)
    total = pointer(scratch + NUMBER_BYTES * TOTAL, real)
    strip = pointer(scratch + NUMBER_BYTES * STRIPS, real)
    slope = pointer(scratch + NUMBER_BYTES * (STRIPS + strip_rows * TILE_COLUMNS), real)
    light_x, light_y, ratio, step, lag = ray
    left, top = corner
    # Positions beyond the edge are clamped into the border, which repeats it.
    last_column, last_row = width - 4.0, height - 3.0
    part = rows * TILE_COLUMNS
    for x in range(sums * part):
        total[x] = real(0)
    level = level_r = before = 0.0
    weight = 1.0
    for k in range(1, count + 1):
        t = (k - lag) * step
        c, c_r, c_t = weight, (k - 1) * before, weight * (k - lag)
        before = weight
        weight *= ratio
        scale, shift_x, shift_y = 1 - t, t * light_x, t * light_y
        # First and last index in the padded mask of what the tile reads.
        a, b = scale * left + shift_x, scale * (left + (TILE_COLUMNS - 1)) + shift_x
        low, high = _clip(a if a < b else b, last_column), _clip(b if a < b else a, last_column)
        begin, end = np.int64(low + 1), np.int64(high + 1) + 1
        a, b = scale * top + shift_y, scale * (top + (rows - 1)) + shift_y
        low, high = _clip(a if a < b else b, last_row), _clip(b if a < b else a, last_row)
        first, last = np.int64(low + 1), np.int64(high + 1) + 1
        # The value of these texels where they have one. A cell with several is NaN, which equals
        # nothing.
        value = flat[first // FLAT_CELL * cells + begin // FLAT_CELL]
        one_value = True
        for i in range(first // FLAT_CELL, last // FLAT_CELL + 1):
            for j in range(begin // FLAT_CELL, end // FLAT_CELL + 1):
                if flat[i * cells + j] != value:
                    one_value = False
        if one_value:
            level += c * value
            level_r += c_r * value
            continue
        for x in range(TILE_COLUMNS):
            a = _clip(scale * (left + x) + shift_x, last_column) + 1
            i = np.int32(a)
            column[x], across[x] = i, real(a - i)
        for y in range(rows):
            a = _clip(scale * (top + y) + shift_y, last_row) + 1
            i = np.int64(a)
            down[y] = real(a - i)
            # A position that was rounded differently above lies between the same rows.
            i = i if i > first else first
            row[y] = ((i if i < last else last - 1) - first) * TILE_COLUMNS
        used = last - first + 1
        if sums == 1:
            for j in range(used):
                texel = (first + j) * width
                for x in range(TILE_COLUMNS):
                    i = texel + column[x]
                    strip[j * TILE_COLUMNS + x] = mask[i] + across[x] * (mask[i + 1] - mask[i])
            for y in range(rows):
                lower = real(c) * down[y]
                upper, j = real(c) - lower, row[y]
                for x in range(TILE_COLUMNS):
                    total[y * TILE_COLUMNS + x] += (
                        upper * strip[j + x] + lower * strip[j + TILE_COLUMNS + x]
                    )
            continue
        for j in range(used):
            texel = (first + j) * width
            for x in range(TILE_COLUMNS):
                i = texel + column[x]
                difference = mask[i + 1] - mask[i]
                strip[j * TILE_COLUMNS + x] = mask[i] + across[x] * difference
                slope[j * TILE_COLUMNS + x] = difference
        d, d_r, d_t = real(c), real(c_r), real(c_t)
        for y in range(rows):
            j, f, n = row[y], down[y], y * TILE_COLUMNS
            for x in range(TILE_COLUMNS):
                difference = strip[j + TILE_COLUMNS + x] - strip[j + x]
                read = strip[j + x] + f * difference
                turned = slope[j + x] + f * (slope[j + TILE_COLUMNS + x] - slope[j + x])
                total[n + x] += d * read
                total[part + n + x] += d_r * read
                total[2 * part + n + x] += d_t * turned
                total[3 * part + n + x] += d_t * difference
    return level, level_r


@fast_jit
def _group(real, padded, size, ray, count, used, scratch, out, stride):
    """Set the sums of ``used`` points, at most POINT_GROUP, in ``out``, where they are ``stride``
    apart. The points' places, and their indices in ``out``, are in the memory at ``scratch``;
    otherwise as ``_tile``."""
    mask = pointer(padded[0], real)
    height, width, _, sums, _ = size
    texel, across = pointer(scratch, np.int64), pointer(scratch + NUMBER_BYTES * COLUMN_PART, real)
    down = pointer(scratch + NUMBER_BYTES * ROW_PART, real)
    at_x = pointer(scratch + NUMBER_BYTES * POINT_X, np.float64)
    at_y = pointer(scratch + NUMBER_BYTES * POINT_Y, np.float64)
    index = pointer(scratch + NUMBER_BYTES * POINT_INDEX, np.int64)
    total = pointer(scratch + NUMBER_BYTES * TOTAL, real)
    light_x, light_y, ratio, step, lag = ray
    last_column, last_row = width - 4.0, height - 3.0
    for p in range(used, POINT_GROUP):
        at_x[p], at_y[p] = light_x, light_y
    for p in range(sums * POINT_GROUP):
        total[p] = real(0)
    weight, before = 1.0, 0.0
    for k in range(1, count + 1):
        t = (k - lag) * step
        c, c_r, c_t = real(weight), real((k - 1) * before), real(weight * (k - lag))
        before = weight
        weight *= ratio
        for p in range(POINT_GROUP):
            a = _clip(at_x[p] + t * (light_x - at_x[p]), last_column) + 1
            b = _clip(at_y[p] + t * (light_y - at_y[p]), last_row) + 1
            i, j = np.int32(a), np.int32(b)
            texel[p] = np.int64(j) * width + i
            across[p], down[p] = real(a - i), real(b - j)
        if sums == 1:
            for p in range(POINT_GROUP):
                i, f = texel[p], across[p]
                upper = mask[i] + f * (mask[i + 1] - mask[i])
                i += width
                lower = mask[i] + f * (mask[i + 1] - mask[i])
                total[p] += c * (upper + down[p] * (lower - upper))
            continue
        for p in range(POINT_GROUP):
            i, f = texel[p], across[p]
            top, top_slope = mask[i], mask[i + 1] - mask[i]
            i += width
            low, low_slope = mask[i], mask[i + 1] - mask[i]
            upper, lower = top + f * top_slope, low + f * low_slope
            value = upper + down[p] * (lower - upper)
            total[p] += c * value
            total[POINT_GROUP + p] += c_r * value
            total[2 * POINT_GROUP + p] += c_t * (top_slope + down[p] * (low_slope - top_slope))
            total[3 * POINT_GROUP + p] += c_t * (lower - upper)
    for s in range(sums):
        for p in range(used):
            out[s * stride + index[p]] = total[s * POINT_GROUP + p]


@fast_jit
def _copy_tile(real, out, at, strides, sizes, levels, scratch):
    """Copy ``sizes`` (sums, tile rows, rows, columns) of a tile's sums to ``out`` from index ``at``
    on, whose sums and rows are ``strides`` apart, with what flat taps add, ``levels``."""
    total = pointer(scratch + NUMBER_BYTES * TOTAL, real)
    sums, rows, columns = sizes
    for s in range(sums):
        level = real(levels[0] if s == 0 else levels[1] if s == 1 else 0.0)
        for y in range(rows):
            i, j = at + s * strides[0] + y * strides[1], (s * rows + y) * TILE_COLUMNS
            for x in range(columns):
                out[i + x] = total[j + x] + level


@fast_jit
def _set_sums(real, frame):
    """Serve a call whose numbers are of the kind ``real``, as in np.float32."""
    mask, flat, points_at = argument(frame, 0), argument(frame, 1), argument(frame, 2)
    padded = data(mask), data(flat)
    height, width, points = length(mask, 0), length(mask, 1), length(points_at, 1)
    at, rays = pointer(data(points_at), real), pointer(data(argument(frame, 3)), real)
    setup, buffer = pointer(data(argument(frame, 4)), np.int32), first_result(frame)
    sums, rows, columns = length(buffer, 0), length(buffer, 1), length(buffer, 2)
    out = pointer(data(buffer), real)
    # Every call below has the same types, or numba would compile the function again.
    real64, integer = np.float64, np.int64
    strides = rows * columns, columns
    for turn in range(rows if points > 0 else integer(1)):
        n = 5 * turn
        light_x, light_y, ratio = real64(rays[n]), real64(rays[n + 1]), real64(rays[n + 2])
        step, lag = real64(rays[n + 3]), real64(rays[n + 4])
        ray = light_x, light_y, ratio, step, lag
        count, begin = integer(setup[2 * turn]), integer(setup[2 * turn + 1])
        # Tiles need more rows of the mask than they have where taps lie beyond the light.
        reach = TILE_ROWS * max(abs(1 - (1 - lag) * step), abs(1 - (count - lag) * step)) + 4
        strip_rows = integer(min(reach, real64(height)))
        # Numbers that are not finite have no place in the mask.
        memory = integer(0)
        if math.isfinite(light_x + light_y + ratio + step + lag):
            memory = allocate(NUMBER_BYTES * (STRIPS + 2 * strip_rows * TILE_COLUMNS))
        if memory == 0:
            for n in range(sums * rows * columns):
                out[n] = real(np.nan)
            return
        size = height, width, length(flat, 1), sums, strip_rows
        if points == 0:
            tile_rows = TILE_ROWS if sums == 1 else TILE_ROWS_OF_FOUR_SUMS
            for top in range(integer(0), rows, tile_rows):
                high = min(tile_rows, rows - top)
                for left in range(integer(0), columns, TILE_COLUMNS):
                    corner = real64(left), real64(begin + top)
                    levels = _tile(real, padded, size, ray, count, corner, high, memory)
                    sizes = sums, high, min(TILE_COLUMNS, columns - left)
                    place = top * columns + left
                    _copy_tile(real, out, place, strides, sizes, levels, memory)
        at_x = pointer(memory + NUMBER_BYTES * POINT_X, np.float64)
        at_y = pointer(memory + NUMBER_BYTES * POINT_Y, np.float64)
        index = pointer(memory + NUMBER_BYTES * POINT_INDEX, np.int64)
        place, p, used, one = turn * columns, integer(0), integer(0), integer(1)
        while p < points:
            # Points that follow each other in a row form a tile. Others are summed in groups.
            x, y, run = at[p], at[points + p], integer(1)
            most = min(TILE_COLUMNS, points - p)
            while run < most and at[points + p + run] == y and at[p + run] == x + run:
                run += 1
            if run >= MIN_TILE_RUN:
                corner = real64(x), real64(y)
                levels = _tile(real, padded, size, ray, count, corner, one, memory)
                _copy_tile(real, out, place + p, strides, (sums, one, run), levels, memory)
                p += run
                continue
            for _ in range(run):
                at_x[used], at_y[used] = real64(at[p]), real64(at[points + p])
                index[used] = place + p
                p, used = p + 1, used + 1
                if used == POINT_GROUP:
                    _group(real, padded, size, ray, count, used, memory, out, strides[0])
                    used = integer(0)
        if used:
            _group(real, padded, size, ray, count, used, memory, out, strides[0])
        release(memory)


def _sums_single(frame):
    if not answers_version_query(frame):
        _set_sums(np.float32, frame)
    return 0


def _sums_double(frame):
    if not answers_version_query(frame):
        _set_sums(np.float64, frame)
    return 0

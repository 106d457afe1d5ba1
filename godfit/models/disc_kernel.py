"""The sums over taps of a disc light's mask, compiled by numba as an XLA call for CPUs.

The mask is open (veil + (1 - veil) disc): far from the light it is open times the veil, inside the
disc it is open. A ray crosses the disc's rim once, so only a few of its taps are changed by the
disc. The kernel sums the open mask over all taps, and adds the disc's part from a box around the
light (``disc_box.py``), which also holds the derivatives by the disc's place and shape.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from godfit.models.disc_box import (
    BOX_MARGIN,
    TEXEL_NUMBERS,
    DiscNumbers,
    disc_box,
    edge_distances,
)
from godfit.runtime.call_frame import answers_version_query, matrix, result, vector
from godfit.runtime.numba_jit import fast_jit, inlined_jit

POINT_GROUP = 32
"""Points that are summed side by side, in vector registers."""
VALUE_ROWS = 2
"""Rows of the result without slopes: the mask at the point, and its sum."""
SLOPE_ROWS = 15
"""Rows of the result with slopes: the mask, four sums, and five derivatives of the mask and of the
first sum (see ``disc_pass.Lit``)."""
OPEN_SUMS = 5
"""Sums over the open mask: four over all taps, and the first over the taps before the disc."""
EDGE_TAIL_SINGLE = 12.0
"""Edge widths from the rim at which the disc's edge ends, in float32: exp(-12) is a thousandth of
a level."""
EDGE_TAIL_DOUBLE = 37.0
"""The same in float64: exp(-37) is below rounding."""


class _Taps(NamedTuple):
    """Places of the taps along the ray (count,), and their weights (count, 3) in S, in S_r and in
    the two slopes."""

    place: np.ndarray
    weights: np.ndarray


class _Points(NamedTuple):
    """Columns and rows of POINT_GROUP points, and the number of each point's taps before the one
    that is the first inside the disc."""

    x: np.ndarray
    y: np.ndarray
    inside: np.ndarray


class _Ray(NamedTuple):
    """A ray from (x, y), a column and a row of the mask, to the light."""

    x: float
    y: float
    light_x: float
    light_y: float


@fast_jit
def _tap_table(disc, count, real):
    ratio, step, lag = float(disc.ratio), float(disc.step), float(disc.lag)
    place, weights = np.empty(count), np.empty((count, 3), real)
    weight, before = 1.0, 0.0
    for k in range(1, count + 1):
        place[k - 1] = (k - lag) * step
        weights[k - 1, 0], weights[k - 1, 1] = real(weight), real((k - 1) * before)
        weights[k - 1, 2] = real(weight * (k - lag))
        before = weight
        weight *= ratio
    return _Taps(place, weights)


@fast_jit
def _sum_open(open_, points, disc, taps, slopes, total):
    """Fill ``total`` (OPEN_SUMS, POINT_GROUP) with the sums over the open mask at a group of
    points: times the veil before tap ``inside``, as it is from that tap on. The last sum is the
    first one without the veil, over the taps before ``inside`` alone."""
    h, w = open_.shape
    real = open_.dtype.type
    x, y, inside = points.x, points.y, points.inside
    texels, place, weights = open_.reshape(-1), taps.place, taps.weights
    light_x, light_y, veil = float(disc.light_x), float(disc.light_y), disc.veil
    last_column, last_row, stride = w - 1.0, h - 1.0, np.int32(w)
    right, below = np.uint64(1), np.uint64(w)
    texel = np.empty(POINT_GROUP, np.int32)
    f, g = np.empty(POINT_GROUP, open_.dtype), np.empty(POINT_GROUP, open_.dtype)
    moves_x, moves_y = np.empty(POINT_GROUP, open_.dtype), np.empty(POINT_GROUP, open_.dtype)
    value, rise = np.empty(POINT_GROUP, open_.dtype), np.empty(POINT_GROUP, open_.dtype)
    fall = np.empty(POINT_GROUP, open_.dtype)
    total.fill(0)
    for k in range(len(place)):
        t = place[k]
        for p in range(POINT_GROUP):
            to_x, to_y = x[p] + t * (light_x - x[p]), y[p] + t * (light_y - y[p])
            column, row = min(max(to_x, 0.0), last_column), min(max(to_y, 0.0), last_row)
            i, j = min(np.int32(column), np.int32(w - 2)), min(np.int32(row), np.int32(h - 2))
            f[p], g[p] = real(column - i), real(row - j)
            # Beyond the border the mask has no slope.
            moves_x[p] = real((to_x >= 0) & (to_x < last_column))
            moves_y[p] = real((to_y >= 0) & (to_y < last_row))
            texel[p] = j * stride + i
        for p in range(POINT_GROUP):
            n = np.uint64(texel[p])
            high, high_slope = texels[n], texels[n + right] - texels[n]
            n += below
            low, low_slope = texels[n], texels[n + right] - texels[n]
            high += f[p] * high_slope
            fall[p] = low + f[p] * low_slope - high
            value[p] = high + g[p] * fall[p]
            rise[p] = high_slope + g[p] * (low_slope - high_slope)
        # One sum at a time: a loop that adds to all of them is not vectorised.
        c = weights[k, 0]
        under = c * veil
        for p in range(POINT_GROUP):
            total[0, p] += (c if k >= inside[p] else under) * value[p]
        if not slopes:
            continue
        for p in range(POINT_GROUP):
            total[4, p] += (real(0) if k >= inside[p] else c) * value[p]
        c = weights[k, 1]
        under = c * veil
        for p in range(POINT_GROUP):
            total[1, p] += (c if k >= inside[p] else under) * value[p]
        c = weights[k, 2]
        under = c * veil
        for p in range(POINT_GROUP):
            total[2, p] += (c if k >= inside[p] else under) * moves_x[p] * rise[p]
        for p in range(POINT_GROUP):
            total[3, p] += (c if k >= inside[p] else under) * moves_y[p] * fall[p]


@fast_jit
def _taps_between(ray, disc, count, low, high):
    """The first and last tap, of 1 to ``count``, that may lie between ``low`` and ``high`` (2,), a
    column and a row each. The first is larger than the last if there is none."""
    step, lag = float(disc.step), float(disc.lag)
    if not step > 0:
        return 1, count
    enters, leaves = 0.0, np.inf
    for axis in range(2):
        place = ray.x if axis == 0 else ray.y
        along = (ray.light_x if axis == 0 else ray.light_y) - place
        if along == 0:
            if place < low[axis] or place > high[axis]:
                return 1, 0
            continue
        a, b = (low[axis] - place) / along, (high[axis] - place) / along
        enters, leaves = max(enters, min(a, b)), min(leaves, max(a, b))
    if leaves < enters:
        return 1, 0
    # One more tap at either end, for rounding.
    first = max(1, math.floor(min(enters / step + lag, count + 1.0)))
    return first, min(count, math.ceil(min(leaves / step + lag, count + 1.0)))


@fast_jit
def _sum_box(box, ray, taps, first, last, sums):
    """Add to ``sums`` (TEXEL_NUMBERS + 3,) what taps first to before last of a ray contribute from
    the box: every number of a texel, then the first number weighted as in S_r, then its slopes to
    the right and down."""
    real = sums.dtype.type
    texels, place, weights = box.texels, taps.place, taps.weights
    rows, columns = box.rows, box.columns
    each = np.uint64(len(texels) // max(rows * columns, 1))
    below = np.uint64(columns) * each
    for k in range(first, last):
        t = place[k]
        column = min(max(ray.x + t * (ray.light_x - ray.x), -1.0), box.last_column)
        row = min(max(ray.y + t * (ray.light_y - ray.y), -1.0), box.last_row)
        i, j = math.floor(column), math.floor(row)
        a, b = i - box.left + 1, j - box.top + 1
        if a < 0 or b < 0 or a + 1 >= columns or b + 1 >= rows:
            continue
        f, g = real(column - i), real(row - j)
        c, c_r, c_t = weights[k, 0], weights[k, 1], weights[k, 2]
        n = np.uint64(b * columns + a) * each
        m = n + below
        high, low = texels[n], texels[m]
        high_slope, low_slope = texels[n + each] - high, texels[m + each] - low
        high += f * high_slope
        fall = low + f * low_slope - high
        value = high + g * fall
        if each == 1:
            sums[0] += c * value
            continue
        sums[TEXEL_NUMBERS] += c_r * value
        sums[TEXEL_NUMBERS + 1] += c_t * (high_slope + g * (low_slope - high_slope))
        sums[TEXEL_NUMBERS + 2] += c_t * fall
        # Bilinear shares of the four texels.
        d = c * f * g
        shares = c - c * f - c * g + d, c * f - d, c * g - d, d
        for s in range(np.uint64(TEXEL_NUMBERS)):
            sums[s] += (
                shares[0] * texels[n + s] + shares[1] * texels[n + each + s]
                + shares[2] * texels[m + s] + shares[3] * texels[m + each + s]
            )  # fmt: skip


@fast_jit
def _bilinear(texels, x, y):
    """The value of ``texels`` (h, w) at a column and row, bilinear, clamped to the border."""
    h, w = texels.shape
    column, row = min(max(x, 0.0), w - 1.0), min(max(y, 0.0), h - 1.0)
    i, j = min(int(column), w - 2), min(int(row), h - 2)
    f, g = column - i, row - j
    upper = (1 - f) * texels[j, i] + f * texels[j, i + 1]
    return (1 - g) * upper + g * ((1 - f) * texels[j + 1, i] + f * texels[j + 1, i + 1])


@fast_jit
def lit(open_, at, numbers, count, cut, out):
    """Fill ``out`` (VALUE_ROWS or SLOPE_ROWS, 1, points): see ``disc_pass.disc_pass``. ``numbers``
    (9,) are those of ``DiscNumbers`` without the cut."""
    real = open_.dtype.type
    for number in numbers:
        if not math.isfinite(number):
            out.fill(np.nan)
            return
    disc = DiscNumbers(
        numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], numbers[5], numbers[6],
        numbers[7], numbers[8], cut,
    )  # fmt: skip
    slopes, points = out.shape[0] > VALUE_ROWS, out.shape[2]
    light_x, light_y, veil = float(disc.light_x), float(disc.light_y), disc.veil
    step, lag = float(disc.step), float(disc.lag)
    taps = _tap_table(disc, count, real)
    place = taps.place
    h, w = open_.shape
    tail = EDGE_TAIL_SINGLE if open_.itemsize == 4 else EDGE_TAIL_DOUBLE
    near, far = edge_distances(disc, float(h), float(disc.soft) if slopes else 0.0, tail)
    # On the way to a light in the picture every tap lies nearer to it than the one before. The taps
    # of a light outside end at the border.
    straight = 0 <= light_x <= w - 1 and 0 <= light_y <= h - 1
    straight &= disc.step > 0 and place[0] >= 0 and place[-1] <= 1
    near = max(near, 0.0) if straight else 0.0
    box, over = disc_box(open_, disc, (near, far, tail), slopes)
    if over:
        near = 0.0
        box, over = disc_box(open_, disc, (near, far, tail), slopes)
    near -= BOX_MARGIN
    rows, columns = box.rows - 2, box.columns - 2
    # The pixel itself is a tap of weight 1.
    alone = _Taps(np.zeros(1), np.ones((1, 3), open_.dtype))
    low = (box.left - 1.0 if box.left > 0 else -np.inf), (box.top - 1.0 if box.top > 0 else -np.inf)
    high = (
        box.left + columns + 0.0 if box.left + columns < w else np.inf,
        box.top + rows + 0.0 if box.top + rows < h else np.inf,
    )
    group = _Points(np.empty(POINT_GROUP), np.empty(POINT_GROUP), np.empty(POINT_GROUP, np.int32))
    total = np.empty((OPEN_SUMS, POINT_GROUP), open_.dtype)
    sums = np.empty(TEXEL_NUMBERS + 3, open_.dtype)
    itself = np.empty(TEXEL_NUMBERS + 3, open_.dtype)
    for begin in range(0, points, POINT_GROUP):
        for p in range(POINT_GROUP):
            group.inside[p] = count
            point = min(begin + p, points - 1)
            group.x[p], group.y[p] = at[0, point], at[1, point]
            away = math.hypot(at[0, point] - light_x, at[1, point] - light_y)
            if near > 0:
                first = math.ceil((1 - near / max(away, near)) / step + lag)
                group.inside[p] = min(max(first - 1, 0), count)
        _sum_open(open_, group, disc, taps, slopes, total)
        for p in range(min(POINT_GROUP, points - begin)):
            x, y = float(at[0, begin + p]), float(at[1, begin + p])
            ray = _Ray(x, y, light_x, light_y)
            first, last = 1, 0
            if rows > 0:
                first, last = _taps_between(ray, disc, count, low, high)
            sums.fill(0)
            itself.fill(0)
            last = min(last, group.inside[p])
            _sum_box(box, ray, taps, first - 1, last, sums)
            here = real(_bilinear(open_, x, y))
            inside_disc = near > 0 and math.hypot(x - light_x, y - light_y) <= near
            if inside_disc:
                out[0, 0, begin + p] = here
            else:
                _sum_box(box, ray, alone, 0, 1, itself)
                out[0, 0, begin + p] = veil * here + itself[0]
            out[1, 0, begin + p] = total[0, p] + sums[0]
            if not slopes:
                continue
            for s in range(3):
                out[2 + s, 0, begin + p] = total[1 + s, p] + sums[TEXEL_NUMBERS + s]
            for s in range(5):
                out[5 + s, 0, begin + p] = itself[1 + s]
                out[10 + s, 0, begin + p] = sums[1 + s]
            if not inside_disc:
                out[9, 0, begin + p] += here
            out[14, 0, begin + p] += total[4, p]


@inlined_jit
def _points(frame, real):
    if not answers_version_query(frame):
        open_, at = matrix(frame, 0, real), matrix(frame, 1, real)
        whole = vector(frame, 3, np.int32)
        lit(open_, at, vector(frame, 2, real), whole[0], whole[1], result(frame, real))
    return 0


def _single(frame):
    return _points(frame, np.float32)


def _double(frame):
    return _points(frame, np.float64)

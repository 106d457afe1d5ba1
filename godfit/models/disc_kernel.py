"""The light pass of a disc at points of its mask, with its derivatives, in one call: compiled by
numba, for CPUs.

The mask is open (veil + (1 - veil) disc): far from the light what is open under the veil, inside
the disc what is open. Rays cross its rim once, so that of their taps a few at most read what the
disc adds there, and what its place and shape change, from a box around the light that is as large
as the disc is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.runtime.numba_jit import fast_jit, inlined_jit
from godfit.runtime.xla_ffi import answers_version_query, declare, matrix, register, result, vector
from godfit.scattering.radial.derivatives import RayParameters
from godfit.scattering.taps import Count

# Points that are summed side by side; of how many more calls are made than one, and how many: XLA
# shares them out among its threads if they are many.
GROUP, ENOUGH, CALLS = 32, 4096, 8
# Rows of what is worked out: the pixel itself and the sum; with slopes of both (see ``Lit``).
VALUES, SLOPES = 2, 15
# Widths of an edge from where it ends: by a thousandth of a level in single precision, by rounding
# in double.
SINGLE, DOUBLE = 12.0, 37.0


class Lit(NamedTuple):
    """The mask at n points, itself, and its four sums over taps (``godfit.scattering.radial.derivatives``; the
    first alone without slopes); and what the light's place (u, v), radius, edge and veil change of
    the mask itself, and of the first sum."""

    itself: Float[Array, " n"]
    sums: Float[Array, "sums n"]
    itself_by: Float[Array, "5 n"]
    sum_by: Float[Array, "5 n"]


def disc_pass(
    open_: Float[Array, "h w"],
    at: Float[Array, "2 n"],
    numbers: RayParameters,
    shape: Float[Array, " 3"],
    count: Count,
    cut: int,
    soft: float,
    slopes: bool,
) -> Lit:
    """At columns and rows ``at``, under ``count`` taps along the ray, of a mask of at least two
    rows and columns, in its precision. ``shape`` is radius and edge, in heights of the mask, and
    veil; texels are ``cut`` into so many parts a side; in derivatives the edge is ``soft`` texels
    wide, at least. NaN where a number is not finite."""
    dtype, double = open_.dtype, open_.dtype == jnp.float64
    packed = jnp.concatenate([jnp.stack([jnp.asarray(z, dtype) for z in numbers]), shape])
    packed = jnp.append(packed.astype(dtype), jnp.asarray(soft, dtype))
    whole = jnp.asarray([count, cut], jnp.int32)
    rows = SLOPES if slopes else VALUES

    def call(part):
        made = jax.ffi.ffi_call(
            target(double),
            jax.ShapeDtypeStruct((rows, 1, part.shape[1]), dtype),
            vmap_method="sequential",
        )
        return made(open_, part, packed, whole)[:, 0]

    n = at.shape[1]
    each = n if n <= ENOUGH else -(-n // CALLS)
    parts = [call(at[:, begin : begin + each]) for begin in range(0, n, each)]
    out = jnp.concatenate(parts, -1) if len(parts) > 1 else parts[0]
    return Lit(out[0], out[1 : 5 if slopes else 2], out[5:10], out[10:])


@fast_jit
def _of_the_open(open_, at, numbers, taps, begin, inside, slopes, total):
    """The sums at GROUP points from ``begin`` on, in ``total`` (5, GROUP), of what is open: as it
    is from tap ``inside`` (GROUP,) on, under the veil before; and, last, the first of them under no
    veil and before that tap alone."""
    h, w = open_.shape
    real = open_.dtype.type
    texels, place, weights = open_.reshape(-1), taps[0], taps[1]
    light_x, light_y, veil = float(numbers[0]), float(numbers[1]), numbers[7]
    last_column, last_row, stride = w - 1.0, h - 1.0, np.int32(w)
    right, below = np.uint64(1), np.uint64(w)
    x, y = np.empty(GROUP), np.empty(GROUP)
    for p in range(GROUP):
        point = min(begin + p, at.shape[1] - 1)
        x[p], y[p] = at[0, point], at[1, point]
    texel = np.empty(GROUP, np.int32)
    f, g = np.empty(GROUP, open_.dtype), np.empty(GROUP, open_.dtype)
    moves_x, moves_y = np.empty(GROUP, open_.dtype), np.empty(GROUP, open_.dtype)
    value, rise = np.empty(GROUP, open_.dtype), np.empty(GROUP, open_.dtype)
    fall = np.empty(GROUP, open_.dtype)
    total.fill(0)
    for k in range(len(place)):
        t = place[k]
        for p in range(GROUP):
            to_x, to_y = x[p] + t * (light_x - x[p]), y[p] + t * (light_y - y[p])
            column, row = min(max(to_x, 0.0), last_column), min(max(to_y, 0.0), last_row)
            i, j = min(np.int32(column), np.int32(w - 2)), min(np.int32(row), np.int32(h - 2))
            f[p], g[p] = real(column - i), real(row - j)
            # Beyond the border nothing changes.
            moves_x[p] = real((to_x >= 0) & (to_x < last_column))
            moves_y[p] = real((to_y >= 0) & (to_y < last_row))
            texel[p] = j * stride + i
        for p in range(GROUP):
            n = np.uint64(texel[p])
            high, high_slope = texels[n], texels[n + right] - texels[n]
            n += below
            low, low_slope = texels[n], texels[n + right] - texels[n]
            high += f[p] * high_slope
            fall[p] = low + f[p] * low_slope - high
            value[p] = high + g[p] * fall[p]
            rise[p] = high_slope + g[p] * (low_slope - high_slope)
        # One sum at a time: loops that write to all of them are not vectorised.
        c = weights[k, 0]
        under = c * veil
        for p in range(GROUP):
            total[0, p] += (c if k >= inside[p] else under) * value[p]
        if not slopes:
            continue
        for p in range(GROUP):
            total[4, p] += (real(0) if k >= inside[p] else c) * value[p]
        c = weights[k, 1]
        under = c * veil
        for p in range(GROUP):
            total[1, p] += (c if k >= inside[p] else under) * value[p]
        c = weights[k, 2]
        under = c * veil
        for p in range(GROUP):
            total[2, p] += (c if k >= inside[p] else under) * moves_x[p] * rise[p]
        for p in range(GROUP):
            total[3, p] += (c if k >= inside[p] else under) * moves_y[p] * fall[p]


@fast_jit
def _first_and_last(x, y, numbers, count, low, high):
    """The taps, of 1 to ``count``, that may lie between ``low`` and ``high`` (2,), a column and a
    row each; none where the first is more than the last."""
    step, lag = float(numbers[3]), float(numbers[4])
    if not step > 0:
        return 1, count
    enters, leaves = 0.0, np.inf
    for axis in range(2):
        place = x if axis == 0 else y
        along = numbers[axis] - place
        if along == 0:
            if place < low[axis] or place > high[axis]:
                return 1, 0
            continue
        a, b = (low[axis] - place) / along, (high[axis] - place) / along
        enters, leaves = max(enters, min(a, b)), min(leaves, max(a, b))
    if leaves < enters:
        return 1, 0
    # One more at either end, for what rounding does.
    first = max(1, math.floor(min(enters / step + lag, count + 1.0)))
    return first, min(count, math.ceil(min(leaves / step + lag, count + 1.0)))


@fast_jit
def _of_the_rim(box, shape, first, last, x, y, numbers, size, taps, sums):
    """Add to ``sums`` (EACH + 3,) what the box, ``shape`` of it (first row, first column, rows,
    columns), has at taps ``first`` to before ``last`` of a column and row: every number of it, the
    first as S_r counts it, and its slopes to the right and down."""
    real = sums.dtype.type
    place, weights = taps[0], taps[1]
    top, left, rows, columns = shape
    light_x, light_y = float(numbers[0]), float(numbers[1])
    last_column, last_row = size[1] - 1.0, size[0] - 1.0
    each = np.uint64(len(box) // max(rows * columns, 1))
    below = np.uint64(columns) * each
    for k in range(first, last):
        t = place[k]
        column = min(max(x + t * (light_x - x), -1.0), last_column)
        row = min(max(y + t * (light_y - y), -1.0), last_row)
        i, j = math.floor(column), math.floor(row)
        a, b = i - left + 1, j - top + 1
        if a < 0 or b < 0 or a + 1 >= columns or b + 1 >= rows:
            continue
        f, g = real(column - i), real(row - j)
        c, c_r, c_t = weights[k, 0], weights[k, 1], weights[k, 2]
        n = np.uint64(b * columns + a) * each
        m = n + below
        high, low = box[n], box[m]
        high_slope, low_slope = box[n + each] - high, box[m + each] - low
        high += f * high_slope
        fall = low + f * low_slope - high
        value = high + g * fall
        if each == 1:
            sums[0] += c * value
            continue
        sums[EACH] += c_r * value
        sums[EACH + 1] += c_t * (high_slope + g * (low_slope - high_slope))
        sums[EACH + 2] += c_t * fall
        # The shares of the four texels.
        d = c * f * g
        shares = c - c * f - c * g + d, c * f - d, c * g - d, d
        for s in range(np.uint64(EACH)):
            sums[s] += (
                shares[0] * box[n + s] + shares[1] * box[n + each + s]
                + shares[2] * box[m + s] + shares[3] * box[m + each + s]
            )  # fmt: skip


@fast_jit
def _read(texels, x, y):
    """What (h, w) ``texels`` are at a column and row, bilinearly."""
    h, w = texels.shape
    column, row = min(max(x, 0.0), w - 1.0), min(max(y, 0.0), h - 1.0)
    i, j = min(int(column), w - 2), min(int(row), h - 2)
    f, g = column - i, row - j
    upper = (1 - f) * texels[j, i] + f * texels[j, i + 1]
    return (1 - g) * upper + g * ((1 - f) * texels[j + 1, i] + f * texels[j + 1, i + 1])


@fast_jit
def _weighed(numbers, count, real):
    """Where taps are (count,), and what they count (count, 3) in S, S_r and the two slopes."""
    ratio, step, lag = float(numbers[2]), float(numbers[3]), float(numbers[4])
    place, weights = np.empty(count), np.empty((count, 3), numbers.dtype)
    weight, before = 1.0, 0.0
    for k in range(1, count + 1):
        place[k - 1] = (k - lag) * step
        weights[k - 1, 0], weights[k - 1, 1] = real(weight), real((k - 1) * before)
        weights[k - 1, 2] = real(weight * (k - lag))
        before = weight
        weight *= ratio
    return place, weights


@fast_jit
def lit(open_, at, numbers, count, cut, out):
    """``out`` (VALUES or SLOPES, 1, points), see ``disc_pass``; ``numbers`` are the five of the
    sums, the disc's three, and how soft its edge is in derivatives."""
    real = open_.dtype.type
    for number in numbers:
        if not math.isfinite(number):
            out.fill(np.nan)
            return
    slopes, points = out.shape[0] > VALUES, out.shape[2]
    light_x, light_y, veil = float(numbers[0]), float(numbers[1]), numbers[7]
    step, lag = float(numbers[3]), float(numbers[4])
    taps = _weighed(numbers, count, real)
    place = taps[0]
    h, w = open_.shape
    tail = SINGLE if open_.itemsize == 4 else DOUBLE
    near, far = rim(numbers, float(h), float(numbers[8]) if slopes else 0.0, tail)
    # Rays to a light in the picture come nearer to it with every tap; elsewhere taps read what is
    # at the border.
    straight = 0 <= light_x <= w - 1 and 0 <= light_y <= h - 1
    straight &= numbers[3] > 0 and place[0] >= 0 and place[-1] <= 1
    near = max(near, 0.0) if straight else 0.0
    top, left, box, over = box_of(open_, numbers, cut, slopes, near, far, tail)
    if over:
        near = 0.0
        top, left, box, over = box_of(open_, numbers, cut, slopes, near, far, tail)
    near -= AROUND
    rows, columns = box.shape[0] - 2, box.shape[1] - 2
    texels, shape = box.reshape(-1), (top, left, box.shape[0], box.shape[1])
    # The pixel itself is a tap that counts 1.
    alone = np.zeros(1), np.ones((1, 3), open_.dtype)
    low = (left - 1.0 if left > 0 else -np.inf), (top - 1.0 if top > 0 else -np.inf)
    high = (
        left + columns + 0.0 if left + columns < w else np.inf,
        top + rows + 0.0 if top + rows < h else np.inf,
    )
    total, inside = np.empty((5, GROUP), open_.dtype), np.empty(GROUP, np.int32)
    sums, itself = np.empty(EACH + 3, open_.dtype), np.empty(EACH + 3, open_.dtype)
    for begin in range(0, points, GROUP):
        for p in range(GROUP):
            inside[p] = count
            point = min(begin + p, points - 1)
            away = math.hypot(at[0, point] - light_x, at[1, point] - light_y)
            if near > 0:
                first = math.ceil((1 - near / max(away, near)) / step + lag)
                inside[p] = min(max(first - 1, 0), count)
        _of_the_open(open_, at, numbers, taps, begin, inside, slopes, total)
        for p in range(min(GROUP, points - begin)):
            x, y = float(at[0, begin + p]), float(at[1, begin + p])
            first, last = 1, 0
            if rows > 0:
                first, last = _first_and_last(x, y, numbers, count, low, high)
            sums.fill(0)
            itself.fill(0)
            last = min(last, inside[p])
            _of_the_rim(texels, shape, first - 1, last, x, y, numbers, open_.shape, taps, sums)
            here = real(_read(open_, x, y))
            lit_all = near > 0 and math.hypot(x - light_x, y - light_y) <= near
            if not lit_all:
                _of_the_rim(texels, shape, 0, 1, x, y, numbers, open_.shape, alone, itself)
            out[0, 0, begin + p] = (real(1) if lit_all else veil) * here + itself[0]
            out[1, 0, begin + p] = total[0, p] + sums[0]
            if not slopes:
                continue
            for s in range(3):
                out[2 + s, 0, begin + p] = total[1 + s, p] + sums[EACH + s]
            for s in range(5):
                out[5 + s, 0, begin + p] = itself[1 + s]
                out[10 + s, 0, begin + p] = sums[1 + s]
            if not lit_all:
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


NAMES = declare("godfit_disc", {False: _single, True: _double})


def target(double: bool) -> str:
    """The name of the compiled function, which XLA knows from now on."""
    register(NAMES[double])
    return NAMES[double]


# Numbers of a texel: what the disc adds and what place (u, v), radius, edge and veil change of it,
# in whole vectors.
EACH = 8
# Texels, more than the four lie away that a tap mixes.
AROUND = 1.5


@fast_jit
def _disc(x, y, least, radius, wide, cut, tail):
    """How much of a texel ``x``, ``y`` from the light the disc covers; ``least`` is added to the
    square of a distance. Lengths are in texels."""
    total = 0.0
    for part in range(cut * cut):
        dx = x + (part % cut + 0.5) / cut - 0.5
        dy = y + (part // cut + 0.5) / cut - 0.5
        inside = (radius - math.sqrt(dx * dx + dy * dy + least)) / wide
        if inside >= tail:
            total += 1.0
        elif inside > -tail:
            total += 1 / (1 + math.exp(-inside))
    return total / (cut * cut)


@fast_jit
def rim(numbers, height, soft, tail):
    """Distances from the light, in texels: nothing of the disc's edge, which ends ``tail`` of its
    widths away, lies nearer than the first or farther than the second; ``soft`` is how wide it is,
    at least."""
    radius, wide = numbers[5] * height, max(numbers[6] * height, soft)
    # And a texel is wide.
    return radius - tail * wide - 1, radius + tail * wide + 1


@fast_jit
def box_of(open_, numbers, cut, slopes, near, far, tail):
    """The first row and column of what the disc reaches, and what it adds there but nearer to the
    light than ``near`` (rows + 2, columns + 2, 1 or EACH), in a border as it is beyond: 0, or where
    the picture ends what is there; and whether anything that is nearer is more than open."""
    h, w = open_.shape
    real = open_.dtype.type
    light_x, light_y = float(numbers[0]), float(numbers[1])
    veil, soft = float(numbers[7]), float(numbers[8])
    radius, edge = numbers[5] * float(h), numbers[6] * float(h)
    wide = max(edge, soft)
    # As ``disc_mask.from_light`` has it, whose square root has a slope everywhere.
    least = 1e-12 * float(h) * float(h)
    top, bottom = max(math.floor(light_y - far), 0), min(math.ceil(light_y + far), h - 1)
    left, right = max(math.floor(light_x - far), 0), min(math.ceil(light_x + far), w - 1)
    rows, columns = max(bottom - top + 1, 0), max(right - left + 1, 0)
    box = np.zeros((rows + 2, columns + 2, EACH if slopes else 1), open_.dtype)
    # What no tap reads that is not in all of the disc.
    unread, over = max(near - 2 * AROUND, 0.0), False
    for j in range(rows):
        y = top + j - light_y
        for i in range(columns):
            x = left + i - light_x
            square = x * x + y * y
            here = float(open_[top + j, left + i])
            over |= square < near * near and here > 1
            if square < unread * unread:
                continue
            if here == 0 or square > far * far:
                continue
            lit = here * (veil + (1 - veil) * _disc(x, y, least, radius, edge, cut, tail))
            texel = box[j + 1, i + 1]
            texel[0] = real(min(lit, 1.0) - veil * here)
            if not slopes:
                continue
            disc = _disc(x, y, least, radius, wide, 1, tail)
            if here * (veil + (1 - veil) * disc) > 1:
                texel[5] = real(-here)
                continue
            texel[5] = real(-here * disc)
            if disc == 0 or disc == 1:
                continue
            # By the radius and the rest in heights; rows run down, v runs up.
            by = here * (1 - veil) * disc * (1 - disc) / wide * h
            away = math.sqrt(square + least)
            texel[1], texel[2] = real(by * x / away * w / h), real(-by * y / away)
            texel[3] = real(by)
            if edge >= soft:
                texel[4] = real(-by * (radius - away) / wide)
    for s in range(box.shape[2]):
        for i in range(1, columns + 1):
            if top == 0:
                box[0, i, s] = box[1, i, s]
            if bottom == h - 1:
                box[rows + 1, i, s] = box[rows, i, s]
        for j in range(rows + 2):
            if left == 0:
                box[j, 0, s] = box[j, 1, s]
            if right == w - 1:
                box[j, columns + 1, s] = box[j, columns, s]
    return top, left, box, over

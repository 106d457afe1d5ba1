"""Bounded deconvolution along rays, compiled by numba.

On radii evenly spaced in their logarithm, the sum of a shader along a ray is a convolution: the
light pass at bin i is the sum over j of K(i - j) x_j. K has the weights of the taps whose share of
the way from the light falls into a bin, and x is the mask times the light pass of a white mask.
Given K and bounds on x, x is a least-squares problem of each ray alone.
"""

from __future__ import annotations

import math

import numpy as np

from godfit.runtime.numba_jit import fast_jit, jit

TINY = 1e-12
"""Curvature of the cost by an x below which the picture does not depend on it."""
QUIET = 1e-9
"""Change of the cost of a ray in a sweep, levels squared, from which it is solved: a millionth of
what decides between candidates."""
RIDGE = 1e-9
"""Share by which curvatures are raised: those of neighbouring bins are all but alike."""
DAMPED = 1e-4
"""The same where it is only known roughly how x follows."""
SWEEPS = 3
"""Sweeps of coordinate descent between two solutions of all that is between its bounds."""
BIN_PARTS = 4
"""Points of a bin over which a weight is averaged, as the light pass is."""
PARTLY_KNOWN = 0.9
"""Share of a cell that is known from which it begins to count, so that its weight is continuous."""
SPACING = 1.5
"""Pixels between the points that the mean of a cell is taken over, at most: no light is missed."""
MOST_PARTS = 24
"""Points of a cell along a ray and across, at most."""


@jit
def kernel_weights(kappa, rho, own, step, bins):
    """Weights of the bins at 0, 1, ... steps towards the light, up to the last that is not 0, and
    (bins,) the sum from each on: what the innermost bin weighs. Both are over their total.

    ``kappa`` is the attenuation along a ray, ``rho`` the share of it that the taps reach, ``own``
    the weight of the pixel itself against all taps without attenuation.
    """

    rate = max(kappa, 1e-6)
    total = (1 - math.exp(-rate)) / rate + own
    weights, inner = np.zeros(bins), np.zeros(bins)
    for part in range(BIN_PARTS):
        offset = (part + 0.5) / BIN_PARTS - 0.5
        last = 0.0
        for i in range(bins):
            # The share of the way at which the bin ends, as a pixel of another bin has it. Taps
            # lie between 0, the pixel, and rho.
            gone = min(1 - math.exp(-(i + offset + 0.5) * step), rho)
            value = (1 - math.exp(-rate / rho * gone)) / rate
            weights[i] += (value - last) / (total * BIN_PARTS)
            last = value
    weights[0] += own / total
    rest = 1.0
    count = bins
    for i in range(bins):
        inner[i] = max(rest, 0.0)
        rest -= weights[i]
        if count == bins and 1 - math.exp(-(i - 0.5) * step) >= rho:
            count = i + 1
    return weights[:count], inner


@fast_jit
def solve_rays(light, weight, design, bounds, x, rounds):
    """Solve x (rays, bins) in place, from where it is, and return the residuals (rays, bins), light
    minus its prediction.

    Least squares of ``light`` with ``weight`` (rays, bins); ``bounds`` (2, bins) are the upper
    bounds of x, whose lower one is 0, and slopes towards them; ``design`` (bins, bins) maps x to
    the light pass. In each of at most so many ``rounds`` sweeps
    of coordinate descent find which x are at a bound, and the others are solved for together.
    """
    rays, bins = light.shape
    residual = np.zeros_like(light)
    gram, slope = np.empty((bins, bins)), np.empty(bins)
    for a in range(rays):
        # Beyond the last bin that is observed nothing has an effect.
        end = 0
        for i in range(bins):
            if weight[a, i] > 0:
                end = i + 1
        for j in range(end):
            slope[j] = bounds[1, j]
            for m in range(j, end):
                gram[j, m] = 0.0
            for i in range(j, end):
                scaled = weight[a, i] * design[i, j]
                if scaled == 0.0:
                    continue
                slope[j] += scaled * light[a, i]
                for m in range(j, i + 1):
                    gram[j, m] += scaled * design[i, m]
        for j in range(end):
            for m in range(j + 1, end):
                gram[m, j] = gram[j, m]
        _solve_bounded(gram, slope, bounds[0], x[a], end, rounds)
        for i in range(end):
            total = 0.0
            for j in range(i + 1):
                total += design[i, j] * x[a, j]
            residual[a, i] = light[a, i] - total
    return residual


@fast_jit
def _solve_bounded(gram, slope, upper, x, end, rounds):
    """Least x gram x / 2 - slope x with 0 <= x <= ``upper`` over the first ``end`` numbers, in
    place."""
    left = np.empty(end)
    for j in range(end):
        total = slope[j]
        for m in range(end):
            total -= gram[j, m] * x[m]
        left[j] = total
    free, factor, step = np.empty(end, np.int64), np.empty((end, end)), np.empty(end)
    for _ in range(rounds):
        moved = 0.0
        for _ in range(SWEEPS):
            moved = 0.0
            for j in range(end):
                if gram[j, j] <= TINY:
                    continue
                new = min(max(x[j] + left[j] / gram[j, j], 0.0), upper[j])
                change = new - x[j]
                if change != 0.0:
                    x[j] = new
                    moved += gram[j, j] * change * change
                    for m in range(end):
                        left[m] -= change * gram[j, m]
        if moved < QUIET:
            break
        count = 0
        for j in range(end):
            if gram[j, j] > TINY and 0.0 < x[j] < upper[j]:
                free[count] = j
                count += 1
        # Cholesky's factor of the free part, and its solution.
        for p in range(count):
            for q in range(p + 1):
                total = gram[free[p], free[q]]
                if p == q:
                    total *= 1 + RIDGE
                for k in range(q):
                    total -= factor[p, k] * factor[q, k]
                if p == q:
                    factor[p, p] = math.sqrt(max(total, RIDGE * gram[free[p], free[p]]))
                else:
                    factor[p, q] = total / factor[q, q]
        for p in range(count):
            total = left[free[p]]
            for k in range(p):
                total -= factor[p, k] * step[k]
            step[p] = total / factor[p, p]
        for p in range(count - 1, -1, -1):
            total = step[p]
            for k in range(p + 1, count):
                total -= factor[k, p] * step[k]
            step[p] = total / factor[p, p]
        # As far as the first bound.
        share = 1.0
        for p in range(count):
            j = free[p]
            if x[j] + share * step[p] < 0:
                share = -x[j] / step[p]
            elif x[j] + share * step[p] > upper[j]:
                share = (upper[j] - x[j]) / step[p]
        for p in range(count):
            j = free[p]
            new = min(max(x[j] + share * step[p], 0.0), upper[j])
            change = new - x[j]
            x[j] = new
            for m in range(end):
                left[m] -= change * gram[j, m]


@fast_jit
def curvature(x, weight, design, upper, moved):
    """(p, p) curvature of the cost by p numbers of a candidate, in which each x that is between its
    bounds follows.

    ``moved`` (p, rays, bins) is how the residuals change with each number while those x stay. The
    part of it that these x take up, by least squares with ``weight``, is left out (variable
    projection: Golub and Pereyra, Inverse Problems 19, 2003, with Kaufman's simplification).
    """
    numbers, rays, bins = moved.shape
    out = np.zeros((numbers, numbers))
    factor, part = np.empty((bins, bins)), np.empty(bins)
    free = np.empty(bins, np.int64)
    change = np.empty((numbers, bins))
    for a in range(rays):
        count = 0
        for j in range(bins):
            if 0.0 < x[a, j] < upper[j]:
                total = 0.0
                for i in range(j, bins):
                    total += weight[a, i] * design[i, j] * design[i, j]
                if total > TINY:
                    free[count] = j
                    factor[count, count] = total
                    count += 1
        for p in range(count):
            for q in range(p + 1):
                total = factor[p, p] * (1 + DAMPED) if p == q else 0.0
                if p != q:
                    for i in range(free[p], bins):
                        total += weight[a, i] * design[i, free[p]] * design[i, free[q]]
                for k in range(q):
                    total -= factor[p, k] * factor[q, k]
                if p == q:
                    factor[p, p] = math.sqrt(max(total, TINY))
                else:
                    factor[p, q] = total / factor[q, q]
        for number in range(numbers):
            for i in range(bins):
                change[number, i] = moved[number, a, i]
            for p in range(count):
                total = 0.0
                for i in range(free[p], bins):
                    total += weight[a, i] * design[i, free[p]] * change[number, i]
                for k in range(p):
                    total -= factor[p, k] * part[k]
                part[p] = total / factor[p, p]
            for p in range(count - 1, -1, -1):
                total = part[p]
                for k in range(p + 1, count):
                    total -= factor[k, p] * part[k]
                part[p] = total / factor[p, p]
            for p in range(count):
                for i in range(free[p], bins):
                    change[number, i] -= design[i, free[p]] * part[p]
        for m in range(numbers):
            for n in range(m + 1):
                total = 0.0
                for i in range(bins):
                    total += weight[a, i] * change[m, i] * change[n, i]
                out[m, n] += total
                if m != n:
                    out[n, m] += total
    return out


@jit
def cell_means(image, known, at, first_angle, turn, radii, grid):
    """Means of an image (h, w) over the cells of rays and bins about ``at`` (column, row).

    ``first_angle`` and ``turn`` are the first ray's angle and the angle of all, in radians from the
    columns towards the rows; ``radii`` (bins,) the middles of the bins in pixels; ``grid`` is the
    number of rays and the logarithm by which bins are apart. A mean over angles and logarithms of
    radii commutes with the sum along rays. Returns (rays, bins) means, their derivatives by column
    and row, and the share of the cell that is known and in the picture.
    """
    h, w = image.shape
    rays, step = int(grid[0]), grid[1]
    shape = (rays, len(radii))
    value, by_x, by_y, sure = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape)
    apart = turn / rays
    for b in range(len(radii)):
        parts = min(max(math.ceil(radii[b] * step / SPACING), 1), MOST_PARTS)
        arcs = min(max(math.ceil(radii[b] * apart / SPACING), 1), MOST_PARTS)
        share = 1.0 / (parts * arcs)
        for a in range(rays):
            total, total_x, total_y, count = 0.0, 0.0, 0.0, 0.0
            for arc in range(arcs):
                angle = first_angle + (a + (arc + 0.5) / arcs) * apart
                dx, dy = math.cos(angle), math.sin(angle)
                for part in range(parts):
                    radius = radii[b] * math.exp(step * ((part + 0.5) / parts - 0.5))
                    column, row = at[0] + radius * dx, at[1] + radius * dy
                    if column < 0 or row < 0 or column > w - 1 or row > h - 1:
                        continue
                    i, j = min(int(column), w - 2), min(int(row), h - 2)
                    s, t = column - i, row - j
                    sure[a, b] += (1 - t) * ((1 - s) * known[j, i] + s * known[j, i + 1]) + t * (
                        (1 - s) * known[j + 1, i] + s * known[j + 1, i + 1]
                    )
                    upper = image[j, i + 1] - image[j, i]
                    lower = image[j + 1, i + 1] - image[j + 1, i]
                    top = image[j, i] + s * upper
                    bottom = image[j + 1, i] + s * lower
                    total += top + t * (bottom - top)
                    total_x += upper + t * (lower - upper)
                    total_y += bottom - top
                    count += 1
            if count > 0:
                value[a, b], by_x[a, b], by_y[a, b] = (
                    total / count,
                    total_x / count,
                    total_y / count,
                )
                most = (sure[a, b] / count - PARTLY_KNOWN) / (1 - PARTLY_KNOWN)
                sure[a, b] = max(0.0, most) * count * share
    return value, by_x, by_y, sure

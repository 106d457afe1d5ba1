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
QUIET = 1e-6
"""Change of the cost in a sweep, levels squared, from which a ray is solved: a thousandth of what
decides between candidates."""


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
    whole = math.exp(-rate) / rate
    last, count = 1 / rate, bins
    for i in range(bins):
        # The share of the way at which the bin ends; taps lie between 1 - rho and 1.
        gone = min(1 - math.exp(-(i + 0.5) * step), rho)
        value = math.exp(-rate / rho * gone) / rate
        weights[i] = (last - value + (own if i == 0 else 0.0)) / total
        inner[i] = weights[i] + (value - whole) / total
        last = value
        if gone >= rho:
            count = i + 1
            break
    return weights[:count], inner


@fast_jit
def solve_rays(light, weight, kernel, inner, bounds, x, sweeps):
    """Solve x (rays, bins) in place, from where it is, and return the residuals (rays, bins), light
    minus its prediction.

    Least squares of ``light`` with ``weight`` (rays, bins) by coordinate descent; ``bounds``
    (2, bins) are the upper bounds of x, whose lower one is 0, and slopes towards them. The
    innermost x is that of all that is farther in: ``inner`` (bins,) are its weights.
    """
    rays, bins = light.shape
    count = len(kernel)
    residual = np.empty_like(light)
    size = np.empty(bins)
    for a in range(rays):
        # Beyond the last bin that is observed nothing has an effect.
        end = 0
        for i in range(bins):
            if weight[a, i] > 0:
                end = i + 1
        for i in range(end):
            total = inner[i] * x[a, 0]
            for j in range(max(1, i - count + 1), i + 1):
                total += kernel[i - j] * x[a, j]
            residual[a, i] = light[a, i] - total
        for i in range(end, bins):
            residual[a, i] = 0.0
        for j in range(end):
            total = 0.0
            for i in range(j, end if j == 0 else min(end, j + count)):
                k = inner[i] if j == 0 else kernel[i - j]
                total += weight[a, i] * k * k
            size[j] = total
        for _ in range(sweeps):
            moved = 0.0
            for j in range(end):
                if size[j] <= TINY:
                    continue
                new = x[a, j]
                slope = bounds[1, j]
                if j == 0:
                    for i in range(end):
                        slope += weight[a, i] * residual[a, i] * inner[i]
                else:
                    for i in range(j, min(end, j + count)):
                        slope += weight[a, i] * residual[a, i] * kernel[i - j]
                new = min(max(x[a, j] + slope / size[j], 0.0), bounds[0, j])
                change = new - x[a, j]
                if change != 0.0:
                    x[a, j] = new
                    moved += size[j] * change * change
                    if j == 0:
                        for i in range(end):
                            residual[a, i] -= change * inner[i]
                    else:
                        for i in range(j, min(end, j + count)):
                            residual[a, i] -= change * kernel[i - j]
            if moved < QUIET / rays:
                break
    return residual


@fast_jit
def slopes(x, force, kernel, inner, upper):
    """Sums of ``force`` (rays, bins), weight times residual: times x so many bins further in
    (bins,); times the innermost x (bins,); and, where x is at its bound, times the weight of x
    (bins,). These are the slopes, with their signs turned, by kernel, ``inner`` and ``upper``."""
    rays, bins = x.shape
    count = len(kernel)
    out = np.zeros((3, bins))
    for a in range(rays):
        for i in range(bins):
            r = force[a, i]
            if r != 0.0:
                out[1, i] += r * x[a, 0]
                for t in range(min(count, i)):
                    out[0, t] += r * x[a, i - t]
        for j in range(bins):
            if x[a, j] >= upper[j]:
                if j == 0:
                    for i in range(bins):
                        out[2, 0] += force[a, i] * inner[i]
                else:
                    for i in range(j, min(bins, j + count)):
                        out[2, j] += force[a, i] * kernel[i - j]
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
        parts = min(max(int(math.ceil(radii[b] * step / SPACING)), 1), MOST_PARTS)
        arcs = min(max(int(math.ceil(radii[b] * apart / SPACING)), 1), MOST_PARTS)
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
                    if known[j, i] * known[j, i + 1] * known[j + 1, i] * known[j + 1, i + 1] == 0:
                        continue
                    s, t = column - i, row - j
                    upper = image[j, i + 1] - image[j, i]
                    lower = image[j + 1, i + 1] - image[j + 1, i]
                    top = image[j, i] + s * upper
                    bottom = image[j + 1, i] + s * lower
                    total += top + t * (bottom - top)
                    total_x += upper + t * (lower - upper)
                    total_y += bottom - top
                    count += 1
            if count > 0:
                value[a, b], by_x[a, b], by_y[a, b] = total / count, total_x / count, total_y / count
                sure[a, b] = count * share
    return value, by_x, by_y, sure

"""The robust misfit of many lights at once, compiled.

For every light the radial sums of the maps of a hypothesis are taken at both pixels of every pair,
the linear coefficients are solved for by reweighted least squares (variable projection: Golub &
Pereyra, SIAM J. Numer. Anal. 10 (1973), 413), and the misfit is Cauchy's, sum log(1 + (r / s)^2).
Attenuation is exp(-kappa t / rho) at a share t of the way to the light, up to t = rho.
"""

from __future__ import annotations

import math

import numpy as np

from godfit.runtime.numba_jit import fast_jit, jit

TAPS = 14
"""Nearest texels of a ray: twice as many change the misfit by less than other pairs do."""
ALLOWED_EXCESS = 0.01
"""Light above the picture's value that is not counted: two or three levels of noise."""
DAMPING = 1e-9
"""Relative damping of the normal equations, for maps that no pair's ray meets."""


@fast_jit
def radial_sums(x, y, point, maps, windowed, out):
    """Fill ``out`` (k, 2, n) with the sums of ``maps`` (k, h, w) at pixels ``x`` and ``y`` (2, n).

    ``point`` (5,) is light x and y, kappa, rho and radius. Only texels within the radius count of
    maps that are ``windowed`` (k,).
    """
    count, h, w = maps.shape
    light_x, light_y, kappa, rho, radius = point[0], point[1], point[2], point[3], point[4]
    begin = max(0.0, 1.0 - rho)
    for half in range(2):
        for i in range(x.shape[1]):
            dx, dy = x[half, i] - light_x, y[half, i] - light_y
            away = math.sqrt(dx * dx + dy * dy) + 1e-9
            for k in range(count):
                out[k, half, i] = 0.0
            for kind in range(2):
                any_map = False
                for k in range(count):
                    any_map = any_map or windowed[k] == kind
                end = min(1.0, radius / away) if kind == 1 else 1.0
                if end <= begin or not any_map:
                    continue
                step = (end - begin) / TAPS
                at = begin + 0.5 * step
                factor = math.exp(-kappa / rho * (1.0 - at)) * step / rho
                grow = math.exp(kappa / rho * step)
                column, row = light_x + dx * at, light_y + dy * at
                for _ in range(TAPS):
                    c = int(min(max(column, 0.0), w - 1.0))
                    r = int(min(max(row, 0.0), h - 1.0))
                    for k in range(count):
                        if windowed[k] == kind:
                            out[k, half, i] += maps[k, r, c] * factor
                    factor *= grow
                    column += dx * step
                    row += dy * step


@jit
def _cholesky(matrix, right):
    """The solution of a few normal equations; LAPACK's takes ten seconds to be compiled in."""
    n = right.size
    for i in range(n):
        for j in range(i + 1):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = math.sqrt(max(rest, DAMPING)) if i == j else rest / matrix[j, j]
    for i in range(n):
        for k in range(i):
            right[i] -= matrix[i, k] * right[k]
        right[i] /= matrix[i, i]
    for back in range(n):
        i = n - 1 - back
        for k in range(i + 1, n):
            right[i] -= matrix[k, i] * right[k]
        right[i] /= matrix[i, i]
    return right


@jit
def _solve(gram, goal, gains):
    """The coefficients, the first ``gains`` of them not negative: the most negative one is dropped
    until none is."""
    n = goal.size
    on = np.ones(n, np.bool_)
    out = np.zeros(n)
    for _ in range(gains + 1):
        index = np.flatnonzero(on)
        m = index.size
        matrix, right = np.empty((m, m)), np.empty(m)
        for i in range(m):
            right[i] = goal[index[i]]
            for j in range(m):
                matrix[i, j] = gram[index[i], index[j]]
            matrix[i, i] += matrix[i, i] * DAMPING + DAMPING
        found = _cholesky(matrix, right)
        out[:] = 0.0
        worst, least = -1, 0.0
        for i in range(m):
            out[index[i]] = found[i]
            if index[i] < gains and found[i] < least:
                least, worst = found[i], index[i]
        if worst < 0:
            break
        on[worst] = False
    return out


@jit
def misfit(free, difference, side, light, most, spread, dark_weight, widths):
    """The misfit of one light, ``light`` (k, 2, n), and its coefficients (k + p,)."""
    gains, n = light.shape[0], difference.size
    size = gains + free.shape[1]
    design = np.empty((n, size))
    for i in range(n):
        for k in range(gains):
            design[i, k] = light[k, 0, i] - light[k, 1, i]
        design[i, gains:] = free[i]
    found, left = np.zeros(size), difference.copy()
    for turn in range(widths.size):
        inverse = 1.0 / (spread * widths[turn]) ** 2
        gram, goal = np.zeros((size, size)), np.zeros(size)
        for i in range(n):
            if side[i] * left[i] < 0:
                continue
            weight = 1.0 if turn == 0 else 1.0 / (1.0 + left[i] * left[i] * inverse)
            for a in range(size):
                row = weight * design[i, a]
                goal[a] += row * difference[i]
                for b in range(a + 1):
                    gram[a, b] += row * design[i, b]
        if turn > 0 and gains:
            for half in range(2):
                for i in range(n):
                    lit = 0.0
                    for k in range(gains):
                        lit += found[k] * light[k, half, i]
                    limit = most[half, i] + ALLOWED_EXCESS
                    if lit > limit:
                        for a in range(gains):
                            row = dark_weight * light[a, half, i]
                            goal[a] += row * limit
                            for b in range(a + 1):
                                gram[a, b] += row * light[b, half, i]
        for a in range(size):
            for b in range(a):
                gram[b, a] = gram[a, b]
        found = _solve(gram, goal, gains)
        for i in range(n):
            rest = difference[i]
            for a in range(size):
                rest -= design[i, a] * found[a]
            left[i] = rest
    total, inverse = 0.0, 1.0 / spread**2
    for i in range(n):
        if side[i] * left[i] >= 0:
            total += math.log(1.0 + left[i] * left[i] * inverse)
    if gains:
        for half in range(2):
            for i in range(n):
                lit = 0.0
                for k in range(gains):
                    lit += found[k] * light[k, half, i]
                excess = lit - most[half, i] - ALLOWED_EXCESS
                if excess > 0:
                    total += dark_weight * excess * excess * inverse
    return total, found


@jit
def misfits(
    points, x, y, difference, side, most, free, maps, windowed, spread, dark_weight, widths
):
    """The misfits (m,) of ``points`` (m, 5) and their coefficients (m, k + p)."""
    count, maps_count = points.shape[0], maps.shape[0]
    out = np.empty(count)
    coefficients = np.empty((count, maps_count + free.shape[1]))
    light = np.empty((maps_count, 2, difference.size))
    for i in range(count):
        radial_sums(x, y, points[i], maps, windowed, light)
        out[i], coefficients[i] = misfit(
            free, difference, side, light, most, spread, dark_weight, widths
        )
    return out, coefficients

"""What discs of many radii add along rays, and which adds what was missing, compiled by numba."""

from __future__ import annotations

import numpy as np

from godfit.runtime.numba_jit import jit


@jit
def is_clear(x, y, light, density, samples, blocked):
    """Whether (n,) none of the taps towards column and row ``light`` (2,) reads what is ``blocked``
    (h, w)."""
    h, w = blocked.shape
    clear = np.ones(len(x), np.bool_)
    for a in range(len(x)):
        for k in range(samples + 1):
            t = density * k / samples
            i = int(np.rint(x[a] + t * (light[0] - x[a])))
            j = int(np.rint(y[a] + t * (light[1] - y[a])))
            if blocked[min(max(j, 0), h - 1), min(max(i, 0), w - 1)]:
                clear[a] = False
                break
    return clear


@jit
def open_sums(x, y, open_, light, t, c):
    """(n,) the sum over taps ``t``, ``c`` (k,) towards column and row ``light`` (2,) of what is
    ``open_`` (h, w)."""
    h, w = open_.shape
    out = np.zeros(len(x))
    for a in range(len(x)):
        for k in range(len(t)):
            column, row = x[a] + t[k] * (light[0] - x[a]), y[a] + t[k] * (light[1] - y[a])
            left, low = int(np.floor(column)), int(np.floor(row))
            for corner in range(4):
                right, high = corner % 2, corner // 2
                share = c[k] * (column - left if right else 1 - column + left)
                share *= row - low if high else 1 - row + low
                i, j = min(max(left + right, 0), w - 1), min(max(low + high, 0), h - 1)
                out[a] += share * open_[j, i]
    return out


@jit
def disc_sums(x, y, clear, open_, light, t, c, radii, cut, power):
    """(n, r, power + 1) what discs of ``radii`` (r,), evenly apart, about column and row ``light``
    (2,) add under taps ``t``, ``c`` (k,), and that times powers of how far from the last one,
    where texels are ``open_`` (h, w); ``clear`` (n,) is said of rays on which all of them are."""
    (h, w), count, parts = open_.shape, len(radii), cut * cut
    thin = radii[1] - radii[0] if count > 1 else 1.0
    # The first radius that has each part of a texel inside it, near the rim.
    reach = int(radii[-1]) + 3
    middle_x, middle_y = int(np.rint(light[0])), int(np.rint(light[1]))
    first = np.empty((2 * reach + 1, 2 * reach + 1, parts), np.int64)
    for j in range(2 * reach + 1):
        for i in range(2 * reach + 1):
            for part in range(parts):
                dx = middle_x + i - reach + (part % cut + 0.5) / cut - 0.5 - light[0]
                dy = middle_y + j - reach + (part // cut + 0.5) / cut - 0.5 - light[1]
                first[j, i, part] = max(int(np.ceil((np.hypot(dx, dy) - radii[0]) / thin)), 0)
    # What taps from one on add to every disc, where all of these read what lies inside.
    deep = np.zeros((len(t) + 1, power + 1))
    for k in range(len(t) - 1, -1, -1):
        share = c[k]
        for p in range(power + 1):
            deep[k, p] = deep[k + 1, p] + share
            share *= t[k] - t[-1]
    # Of a light off the picture taps read what is at its border.
    straight = 0 <= light[0] <= w - 1 and 0 <= light[1] <= h - 1
    out = np.zeros((len(x), count, power + 1))
    for a in range(len(x)):
        sums = out[a]
        start, stop = 0, len(t)
        if straight and clear[a]:
            whole = max(np.hypot(light[0] - x[a], light[1] - y[a]), 1e-9)
            start = np.searchsorted(t, 1 - (radii[-1] + 2) / whole)
            stop = np.searchsorted(t, 1 - (radii[0] - 2) / whole)
            sums[0] += deep[stop]
        for k in range(start, stop):
            column, row = x[a] + t[k] * (light[0] - x[a]), y[a] + t[k] * (light[1] - y[a])
            away = np.hypot(light[0] - column, light[1] - row)
            if 0 <= column <= w - 1 and 0 <= row <= h - 1 and away > radii[-1] + 2:
                continue
            left, low = int(np.floor(column)), int(np.floor(row))
            for corner in range(4):
                right, high = corner % 2, corner // 2
                share = c[k] / parts * (column - left if right else 1 - column + left)
                share *= row - low if high else 1 - row + low
                i, j = min(max(left + right, 0), w - 1), min(max(low + high, 0), h - 1)
                share *= open_[j, i]
                i, j = i - middle_x + reach, j - middle_y + reach
                if not (0 <= i <= 2 * reach and 0 <= j <= 2 * reach):
                    continue
                for part in range(parts):
                    at = first[j, i, part]
                    if at < count:
                        along = share
                        for p in range(power + 1):
                            sums[at, p] += along
                            along *= t[k] - t[-1]
        for r in range(1, count):
            for p in range(power + 1):
                sums[r, p] += sums[r - 1, p]
    return out


@jit
def best_discs(x, y, clear, open_, lights, t, c, radii, cut, goal, basis, expanded):
    """(m, 4) of the best disc about each column and row of ``lights`` (m, 2), by least squares: how
    much of the square of ``goal`` (n,) it explains, by how much its sums count, and which of
    ``radii`` (r,) and of ``expanded`` (q, power + 1), what powers of the way count, are its own.
    ``basis`` (k, n), orthonormal rows to which the goal is orthogonal, goes with any of them."""
    (k, n), count, powers = basis.shape, len(radii), expanded.shape[1]
    out = np.zeros((len(lights), 4))
    squares = np.empty((powers, powers))
    for m in range(len(lights)):
        sums = disc_sums(x, y, clear, open_, lights[m], t, c, radii, cut, powers - 1)
        flat = sums.reshape(n, count * powers)
        along, shown = goal @ flat, basis @ flat
        for r in range(count):
            for i in range(powers):
                for j in range(i + 1):
                    square = 0.0
                    for a in range(n):
                        square += sums[a, r, i] * sums[a, r, j]
                    for a in range(k):
                        square -= shown[a, r * powers + i] * shown[a, r * powers + j]
                    squares[i, j] = squares[j, i] = square
            for q in range(len(expanded)):
                share, all_ = 0.0, 0.0
                for i in range(powers):
                    share += along[r * powers + i] * expanded[q, i]
                    for j in range(powers):
                        all_ += squares[i, j] * expanded[q, i] * expanded[q, j]
                all_ = max(all_, 1e-12)
                if share > 0 and share * share / all_ > out[m, 0]:
                    out[m, 0], out[m, 1] = share * share / all_, share / all_
                    out[m, 2], out[m, 3] = r, q
    return out

"""What sums of many spacings of taps leave of a target, compiled by numba."""

from __future__ import annotations

import numpy as np

from godfit.runtime.numba_jit import jit
from godfit.scattering.radial.strips_kernel import FLAT_CELL, point_sums


@jit
def left(mask, at, numbers, counts, shows_own, target):
    """(n,) what is left of ``target`` (points,) by sums of ``counts`` taps, each with its
    ``numbers`` (n, 5), when they and the mask itself at ``at`` (2, points) take the share that
    leaves the least."""
    points = at.shape[1]
    # Points that are far apart ask for no flat cells.
    flat = np.full(
        (mask.shape[0] // FLAT_CELL + 1, mask.shape[1] // FLAT_CELL + 1), np.nan, mask.dtype
    )
    rays, own = np.empty((1, 1, points), np.float32), np.zeros((1, 1, points), np.float32)
    if shows_own:
        # The sum with one tap at no distance.
        nearby = numbers[0].copy()
        nearby[2], nearby[3] = 1.0, 0.0
        point_sums(mask, flat, at, nearby, 1, own)
    squares = np.empty(len(counts))
    for i in range(len(counts)):
        point_sums(mask, flat, at, numbers[i], counts[i], rays)
        aa = ab = bb = ay = by = 0.0
        for p in range(points):
            a, b, y = float(own[0, 0, p]), float(rays[0, 0, p]), target[p]
            aa, ab, bb, ay, by = aa + a * a, ab + a * b, bb + b * b, ay + a * y, by + b * y
        little = 1e-12 * (aa + bb) + 1e-300
        aa, bb = aa + little, bb + little
        determinant = aa * bb - ab * ab
        of_own, of_rays = (bb * ay - ab * by) / determinant, (aa * by - ab * ay) / determinant
        squares[i] = 0.0
        for p in range(points):
            shown = of_own * float(own[0, 0, p]) + of_rays * float(rays[0, 0, p])
            squares[i] += (target[p] - shown) ** 2
    return squares

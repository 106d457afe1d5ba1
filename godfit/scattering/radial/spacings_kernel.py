"""How well sums over taps of many spacings fit a target, compiled by numba.

``godfit.inference.sample_count`` scans the number of samples with it: banding determines that
number, and the spacing of the taps determines the bands.
"""

from __future__ import annotations

import numpy as np

from godfit.runtime.numba_jit import jit
from godfit.scattering.radial.strips import FLAT_CELL
from godfit.scattering.radial.strips_kernel import point_sums

RELATIVE_RIDGE = 1e-12
"""Added to the diagonal of the normal equations, relative to its sum: a matrix without an own-pixel
column is singular."""
LEAST_RIDGE = 1e-300
"""The same, absolute, for a mask that is black at all points."""


@jit
def residual_squares(mask, at, rays, counts, with_own, target):
    """(n,) sums of squared residuals of ``target`` (points,), fitted by each of n sums over taps.

    Two weights are solved for: that of the sum with ``counts`` (n,) taps and RayParameters ``rays``
    (n, 5), and, if ``with_own``, that of the mask itself. ``mask`` is padded as in
    ``strips_kernel``; ``at`` (2, points) are columns and rows.
    """
    points = at.shape[1]
    # Flat cells pay only for points in a row: none counts as flat here.
    flat = np.full(
        (mask.shape[0] // FLAT_CELL + 1, mask.shape[1] // FLAT_CELL + 1), np.nan, mask.dtype
    )
    sums, own = np.empty((1, 1, points), np.float32), np.zeros((1, 1, points), np.float32)
    if with_own:
        # The mask at the points is the sum over one tap of weight 1 at no distance.
        own_ray = rays[0].copy()
        own_ray[2], own_ray[3] = 1.0, 0.0
        point_sums(mask, flat, at, own_ray, 1, own)
    squares = np.empty(len(counts))
    for i in range(len(counts)):
        point_sums(mask, flat, at, rays[i], counts[i], sums)
        # The normal equations of the two weights.
        aa = ab = bb = ay = by = 0.0
        for p in range(points):
            a, b, y = float(own[0, 0, p]), float(sums[0, 0, p]), target[p]
            aa, ab, bb, ay, by = aa + a * a, ab + a * b, bb + b * b, ay + a * y, by + b * y
        ridge = RELATIVE_RIDGE * (aa + bb) + LEAST_RIDGE
        aa, bb = aa + ridge, bb + ridge
        determinant = aa * bb - ab * ab
        own_weight = (bb * ay - ab * by) / determinant
        sum_weight = (aa * by - ab * ay) / determinant
        squares[i] = 0.0
        for p in range(points):
            fitted = own_weight * float(own[0, 0, p]) + sum_weight * float(sums[0, 0, p])
            squares[i] += (target[p] - fitted) ** 2
    return squares

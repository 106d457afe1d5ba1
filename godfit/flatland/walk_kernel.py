"""One ray's walk through the padded canvas, compiled by numba; the other kernels call it."""

from __future__ import annotations

import numpy as np

from godfit.runtime.numba_jit import fast_jit, inlined_jit

FILLED = -1.0
"""Free distance of a cell that emits light or hides some."""

OUTSIDE = -2.0
"""Free distance of the cells around the canvas."""

STOPPED = 0
"""End of a walk at an opaque cell, or after all of its steps."""

ESCAPED = 1
"""End of a walk outside the canvas, where the sky is."""

ARRIVED = 2
"""End of a walk at its farthest distance."""

AXIS_PARALLEL = 1e-9
"""A direction's component below this counts as zero: in 16,384 pixels, the largest canvas, such a
ray drifts by far less than rounding."""

AXIS_PARALLEL_INVERSE = 1e9
"""Stands for 1 / component of such a ray: larger than any canvas, and finite."""


@inlined_jit
def inverse(component, real):
    """1 / component, large but finite for a ray along an axis."""
    return real(1) / component if abs(component) > AXIS_PARALLEL else real(AXIS_PARALLEL_INVERSE)


@fast_jit
def first_step(free_distance, ray, stepping):
    """The distance at which a ray has left its own cell, whatever that holds, and the number of
    fixed steps that ended inside it."""
    real = free_distance.dtype.type
    x, y, dx, dy = ray.x, ray.y, ray.dx, ray.dy
    column, row = np.int32(x), np.int32(y)
    used = np.int32(0)
    step = stepping.length
    if step > 0:
        t = step
        while np.int32(x + t * dx) == column and np.int32(y + t * dy) == row:
            t += step
            used += np.int32(1)
        return t, used
    right, below = real(dx > -AXIS_PARALLEL), real(dy > -AXIS_PARALLEL)
    border = min(
        (real(column) + right - x) * inverse(dx, real),
        (real(row) + below - y) * inverse(dy, real),
    )
    return max(max(free_distance[row, column], real(0)), border + stepping.overshoot), used


@fast_jit
def walk(grid, ray, own_cell, stepping, limits, hits):
    """Write the indices of the filled cells that a ray crosses within its ``limits`` to ``hits``;
    their number, and how the walk ended. ``own_cell`` is a cell that does not count, -1 if every
    cell does."""
    free_distance, cells = grid.free_distance, grid.cells
    x, y, dx, dy = ray.x, ray.y, ray.dx, ray.dy
    t, end, step, overshoot = limits.start, limits.end, stepping.length, stepping.overshoot
    width = free_distance.shape[1]
    real = free_distance.dtype.type
    across, down = inverse(dx, real), inverse(dy, real)
    right, below = real(dx > -AXIS_PARALLEL), real(dy > -AXIS_PARALLEL)
    last_row, last_column = real(free_distance.shape[0] - 1), real(width - 1)
    previous = own_cell
    hit_count, opaque = 0, 0
    for _ in range(limits.steps):
        if t >= end:
            return hit_count, ARRIVED
        column = np.int32(min(max(x + t * dx, real(0)), last_column))
        row = np.int32(min(max(y + t * dy, real(0)), last_row))
        value = free_distance[row, column]
        if value == OUTSIDE:
            return hit_count, ESCAPED
        cell = row * width + column
        if value == FILLED and cell != previous:
            hits[hit_count] = cell
            hit_count += 1
            if cells[cell, 3] >= 1:
                opaque += 1
                if opaque == limits.opaque_cells:
                    return hit_count, STOPPED
        previous = cell
        if step > 0:
            t += step
        else:
            border = min((real(column) + right - x) * across, (real(row) + below - y) * down)
            t = max(t + max(value, real(0)), border + overshoot)
    return hit_count, STOPPED


@inlined_jit
def most_hits(free_distance):
    """More filled cells than any ray can cross: room for the hits of a walk."""
    return free_distance.shape[0] * 2 + free_distance.shape[1] * 2


@fast_jit
def blend(cells, hits, ended, sky, light):
    """Write what a ray gathers to ``light`` (4,): the radiance of the cells ``hits``, with that of
    the ``sky`` (3,) where it escaped, and the transmittance of those cells."""
    transmittance = light.dtype.type(1)
    light[:] = 0
    for n in range(len(hits)):
        cell = hits[n]
        for c in range(3):
            light[c] += transmittance * cells[cell, c]
        transmittance *= 1 - cells[cell, 3]
    light[3] = transmittance
    if ended == ESCAPED:
        for c in range(3):
            light[c] += transmittance * sky[c]

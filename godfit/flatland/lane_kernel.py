"""Many rays' steps through empty cells side by side, in vector registers, compiled by numba.

No loop over the lanes has a branch. The one that gathers from the canvas, which cannot be done by
vectors, does nothing else.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from godfit.flatland.walk_kernel import AXIS_PARALLEL, inverse
from godfit.runtime.numba_jit import fast_jit, inlined_jit

LANES = 32
"""Rays side by side: four registers of eight floats, enough work to hide a gather's latency."""


class FlatGrid(NamedTuple):
    """The free distance of the padded canvas as one row of cells, (cells,), its number of columns
    (int32), and the last row and column."""

    free_distance: Any
    columns: Any
    last_row: Any
    last_column: Any


class Lanes(NamedTuple):
    """Rays: origins ``x`` and ``y`` (LANES,), distances ``t`` (LANES,) along them, and ``heading``
    (6, LANES): the direction's components dx and dy, their inverses, and 1 where the ray goes right
    and down, else 0."""

    x: Any
    y: Any
    t: Any
    heading: Any


class LaneScratch(NamedTuple):
    """Room to work in, each (LANES,): the cell that a ray is in, the distance just beyond that
    cell's border, and the free distance there."""

    cell: Any
    beyond: Any
    value: Any


@inlined_jit
def flat_grid(free_distance):
    """``FlatGrid`` of a padded canvas (h + 2, w + 2)."""
    real = free_distance.dtype.type
    rows, columns = free_distance.shape
    last_row, last_column = real(rows - 1), real(columns - 1)
    return FlatGrid(free_distance.reshape(-1), np.int32(columns), last_row, last_column)


@inlined_jit
def new_lanes(real):
    """Lanes of dtype ``real``, not initialised."""
    x, y, t = np.empty(LANES, real), np.empty(LANES, real), np.empty(LANES, real)
    return Lanes(x, y, t, np.empty((6, LANES), real))


@inlined_jit
def new_scratch(real):
    """Scratch of dtype ``real``, not initialised."""
    return LaneScratch(np.empty(LANES, np.int32), np.empty(LANES, real), np.empty(LANES, real))


@inlined_jit
def set_heading(heading, lane, dx, dy):
    """Write a direction's column of ``heading``."""
    real = heading.dtype.type
    heading[0, lane], heading[1, lane] = dx, dy
    heading[2, lane], heading[3, lane] = inverse(dx, real), inverse(dy, real)
    heading[4, lane], heading[5, lane] = real(dx > -AXIS_PARALLEL), real(dy > -AXIS_PARALLEL)


@inlined_jit
def _locate(grid, lanes, overshoot, scratch):
    """Set the ``scratch`` of all rays."""
    x, y, t, heading = lanes
    cell, beyond, value = scratch
    real = x.dtype.type
    dx, dy, across, down, right, below = (
        heading[0], heading[1], heading[2], heading[3], heading[4], heading[5],
    )  # fmt: skip
    for p in range(LANES):
        u, v = x[p] + t[p] * dx[p], y[p] + t[p] * dy[p]
        u = u if u > 0 else real(0)
        v = v if v > 0 else real(0)
        u = u if u < grid.last_column else grid.last_column
        v = v if v < grid.last_row else grid.last_row
        column, row = np.int32(u), np.int32(v)
        cell[p] = row * grid.columns + column
        a = (real(column) + right[p] - x[p]) * across[p]
        b = (real(row) + below[p] - y[p]) * down[p]
        beyond[p] = (a if a < b else b) + overshoot
    for p in range(LANES):
        value[p] = grid.free_distance[np.uint32(cell[p])]


@fast_jit
def leap(grid, lanes, used, steps, overshoot, scratch):
    """Take all rays on through empty cells, until each has come to one that is not empty, for at
    most ``steps`` steps.

    A step is as long as the free distance allows, and ends at least ``overshoot`` beyond the cell's
    border. ``grid`` is a ``FlatGrid``; ``used`` (LANES,) counts each ray's steps.
    """
    t = lanes.t
    beyond, value = scratch.beyond, scratch.value
    zero, one = np.int32(0), np.int32(1)
    for _ in range(steps):
        _locate(grid, lanes, overshoot, scratch)
        moving = zero
        for p in range(LANES):
            farther = t[p] + value[p]
            farther = farther if farther > beyond[p] else beyond[p]
            t[p] = farther if value[p] >= 0 else t[p]
            goes = one if value[p] >= 0 else zero
            used[p] += goes
            moving += goes
        if moving == 0:
            break


@fast_jit
def leap_to_limit(grid, lanes, limit, steps, overshoot, scratch):
    """As ``leap``, but a ray also ends at the distance ``limit`` (LANES,), and steps are not
    counted. In one function, each would be slower by the other's work."""
    t = lanes.t
    beyond, value = scratch.beyond, scratch.value
    zero, one = np.int32(0), np.int32(1)
    for _ in range(steps):
        _locate(grid, lanes, overshoot, scratch)
        moving = zero
        for p in range(LANES):
            farther = t[p] + value[p]
            farther = farther if farther > beyond[p] else beyond[p]
            goes = one if (value[p] >= 0) & (t[p] < limit[p]) else zero
            t[p] = farther if goes else t[p]
            moving += goes
        if moving == 0:
            break


@fast_jit
def march(grid, lanes, used, steps, length):
    """As ``leap``, by steps of equal ``length``, at most ``steps`` with those in ``used``."""
    x, y, t, heading = lanes
    real = x.dtype.type
    dx, dy = heading[0], heading[1]
    zero, one = np.int32(0), np.int32(1)
    for _ in range(steps):
        moving = zero
        for p in range(LANES):
            u, v = x[p] + t[p] * dx[p], y[p] + t[p] * dy[p]
            u = u if u > 0 else real(0)
            v = v if v > 0 else real(0)
            u = u if u < grid.last_column else grid.last_column
            v = v if v < grid.last_row else grid.last_row
            value = grid.free_distance[np.uint32(np.int32(v) * grid.columns + np.int32(u))]
            goes = one if (value >= 0) & (used[p] < steps) else zero
            t[p] = t[p] + length if goes else t[p]
            used[p] += goes
            moving += goes
        if moving == 0:
            break

"""One radiance cascade, compiled by numba; see ``godfit.flatland.cascades``."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from godfit.flatland.kernel_records import Limits, Ray, Stepping, read_grid
from godfit.flatland.lane_kernel import (
    LANES,
    flat_grid,
    leap_to_limit,
    new_lanes,
    new_scratch,
    set_heading,
)
from godfit.flatland.walk_kernel import FILLED, STOPPED, blend, most_hits, walk
from godfit.runtime.call_frame import answers_version_query, matrix, result, vector
from godfit.runtime.numba_jit import fast_jit


class Cascade(NamedTuple):
    """The probes of one cascade: ``spacing`` pixels apart, each with rays in ``directions``
    (rays, 2), right and down, that gather light between the distances ``start`` and ``end``."""

    directions: Any
    spacing: Any
    start: Any
    end: Any


class UpperCascade(NamedTuple):
    """The cascade above, that continues the rays: ``light`` (rows columns, 4 rays), radiance and
    transmittance of every ray of every probe; the probes' ``rows`` and ``columns``; their
    ``spacing``, 0 where there is no cascade above; and ``branching``, how many rays one becomes."""

    light: Any
    rows: Any
    columns: Any
    spacing: Any
    branching: Any


@fast_jit
def _merge_rows(grid, cascade, upper, overshoot, first_row, out):
    """Some rows of a cascade's probes, from ``first_row`` on, merged with the cascade above.

    ``out`` (rows, columns, 4 rays) is the radiance and the transmittance of every ray;
    ``overshoot`` is how far a ray is taken over a cell's border.
    """
    cells = grid.cells
    real = grid.free_distance.dtype.type
    directions, spacing, start = cascade.directions, cascade.spacing, cascade.start
    flat = flat_grid(grid.free_distance)
    steps = np.int64(4 * (grid.free_distance.shape[0] + grid.free_distance.shape[1]))
    stepping = Stepping(real(0), overshoot)
    hits = np.empty(most_hits(grid.free_distance), np.int64)
    light, no_sky = np.empty(4, real), np.zeros(3, real)
    lanes, scratch = new_lanes(real), new_scratch(real)
    x, y, t, heading = lanes
    limit = np.empty(LANES, real)
    weights, own_cell = np.empty(LANES, real), np.empty(LANES, np.int64)
    upper_probe = np.empty(LANES, np.int64)
    ray_of, column_of = np.empty(LANES, np.int64), np.empty(LANES, np.int64)
    rays, last = directions.shape[0], upper.spacing == 0
    corners = 1 if last else 4
    half, one = real(0.5), real(1)
    part = one / real(upper.branching)
    for i in range(out.shape[0]):
        out[i] = 0
        from_y = (real(first_row + i) + half) * spacing + one
        upper_row, low = 0, real(0)
        if not last:
            low = (from_y - one) / upper.spacing - half
            upper_row = int(np.floor(low))
            low -= real(upper_row)
        count = out.shape[1] * rays * corners
        j, r, corner = 0, 0, 0
        for group in range(0, count, LANES):
            within = min(LANES, count - group)
            for p in range(LANES):
                from_x = (real(j) + half) * spacing + one
                dx, dy = directions[r, 0], directions[r, 1]
                # To where the ray of the upper probe starts, not to where this one's ends, so that
                # no light is lost or counted twice between the two.
                way_x, way_y = dx * (cascade.end - start), dy * (cascade.end - start)
                weights[p], upper_probe[p] = one, 0
                if not last:
                    side = (from_x - one) / upper.spacing - half
                    upper_column = int(np.floor(side))
                    side -= real(upper_column)
                    lower, over = corner // 2, corner % 2
                    row = min(max(upper_row + lower, 0), upper.rows - 1)
                    column = min(max(upper_column + over, 0), upper.columns - 1)
                    weights[p] = (low if lower else one - low) * (side if over else one - side)
                    upper_probe[p] = row * upper.columns + column
                    way_x += (real(column) + half) * upper.spacing + one - from_x
                    way_y += (real(row) + half) * upper.spacing + one - from_y
                x[p], y[p] = from_x + dx * start, from_y + dy * start
                heading[0, p], heading[1, p] = way_x, way_y
                own_cell[p] = np.int64(y[p]) * flat.columns + np.int64(x[p]) if start == 0 else -1
                ray_of[p], column_of[p], t[p] = r, j, real(0)
                # The next ray; after the last, the last again, whose lanes are not used.
                if group + p + 1 < count:
                    corner += 1
                    if corner == corners:
                        corner, r = 0, r + 1
                        if r == rays:
                            r, j = 0, j + 1
            for p in range(LANES):
                way_x, way_y = heading[0, p], heading[1, p]
                length = np.sqrt(way_x * way_x + way_y * way_y)
                limit[p] = length
                length = length if length > overshoot else overshoot
                set_heading(heading, p, way_x / length, way_y / length)
            leap_to_limit(flat, lanes, limit, steps, overshoot, scratch)
            for p in range(within):
                to = out[i, column_of[p], 4 * ray_of[p] : 4 * ray_of[p] + 4]
                weight, cell = weights[p], np.int64(scratch.cell[p])
                passing = weight
                if t[p] < limit[p] and scratch.value[p] == FILLED:
                    if cells[cell, 3] >= 1 and cell != own_cell[p]:
                        for c in range(3):
                            to[c] += weight * cells[cell, c]
                        continue
                    ray = Ray(x[p], y[p], heading[0, p], heading[1, p])
                    limits = Limits(t[p], limit[p], steps, 1)
                    hit_count, _ = walk(grid, ray, own_cell[p], stepping, limits, hits)
                    blend(cells, hits[:hit_count], STOPPED, no_sky, light)
                    for c in range(3):
                        to[c] += weight * light[c]
                    passing = weight * light[3]
                if last:
                    to[3] += passing
                elif passing > 0:
                    upper_light = upper.light[upper_probe[p]]
                    passing *= part
                    first = 4 * upper.branching * ray_of[p]
                    for n in range(upper.branching):
                        for c in range(4):
                            to[c] += passing * upper_light[first + 4 * n + c]


@fast_jit
def _merge(frame, real):
    if not answers_version_query(frame):
        lengths, counts = vector(frame, 4, real), vector(frame, 5, np.int32)
        cascade = Cascade(matrix(frame, 2, real), lengths[0], lengths[1], lengths[2])
        upper = UpperCascade(matrix(frame, 3, real), counts[1], counts[2], lengths[3], counts[3])
        grid, out = read_grid(frame, real), result(frame, real)
        _merge_rows(grid, cascade, upper, lengths[4], counts[0], out)
    return 0


def _merge_single(frame):
    return _merge(frame, np.float32)


def _merge_double(frame):
    return _merge(frame, np.float64)


CASCADE_FUNCTIONS = {
    ("merge", False): _merge_single,
    ("merge", True): _merge_double,
}
"""By name, and whether in double precision."""

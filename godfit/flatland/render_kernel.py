"""The radiance that the rays of every pixel gather, compiled by numba; see
``godfit.flatland.rays``."""

from __future__ import annotations

import numpy as np

from godfit.flatland.kernel_records import Limits, Ray, read_trace_arguments
from godfit.flatland.lane_kernel import (
    LANES,
    flat_grid,
    leap,
    march,
    new_lanes,
    new_scratch,
    set_heading,
)
from godfit.flatland.walk_kernel import (
    ESCAPED,
    FILLED,
    OUTSIDE,
    blend,
    first_step,
    most_hits,
    walk,
)
from godfit.runtime.call_frame import answers_version_query, result
from godfit.runtime.numba_jit import fast_jit


@fast_jit
def _headings(directions):
    """(6, R J) what ``Lanes.heading`` holds, of every direction."""
    headings = np.empty((6, len(directions)), directions.dtype)
    for k in range(len(directions)):
        set_heading(headings, k, directions[k, 0], directions[k, 1])
    return headings


@fast_jit
def _render_rows(inputs, plan, out):
    """Rows of the picture. ``out`` (rows, w, 3) is the mean radiance over a pixel's rays; or
    (rows, w, 3 + rays), that mean without a sky, and every ray's transmittance divided by the
    number of rays, 0 for a ray that does not reach the sky."""
    grid, sky = inputs.grid, inputs.sky
    free_distance, cells = grid.free_distance, grid.cells
    rays, steps, stepping = plan.rays, plan.max_steps, plan.stepping
    real = free_distance.dtype.type
    rows, w = out.shape[0], out.shape[1]
    flat = flat_grid(free_distance)
    with_transmittance = out.shape[2] > 3
    headings = _headings(inputs.directions)
    lanes, scratch = new_lanes(real), new_scratch(real)
    x, _, t, heading = lanes
    used = np.empty(LANES, np.int32)
    own_distance, own_cell = np.empty(LANES, real), np.empty(LANES, np.int64)
    direction = np.empty(LANES, np.int64)
    hits = np.empty(most_hits(free_distance), np.int64)
    light, no_sky = np.empty(4, real), np.zeros(3, real)
    total = np.empty((LANES, 3), real)
    share, half, unlimited = real(1) / real(rays), real(0.5), real(np.inf)
    for i in range(rows):
        y = real(plan.first_row + i) + real(1.5)
        lanes.y[:] = y
        for first_column in range(0, w, LANES):
            within = min(LANES, w - first_column)
            for p in range(LANES):
                column = min(first_column + p, w - 1)
                x[p] = real(column) + real(1.5)
                own_cell[p] = np.int64(y) * flat.columns + column + 1
                own_distance[p] = max(flat.free_distance[own_cell[p]], real(0))
            total[:] = 0
            for r in range(rays):
                if plan.jitter_bins == 1:
                    for n in range(6):
                        heading[n] = headings[n, r]
                    direction[:] = r
                else:
                    for p in range(LANES):
                        column = min(first_column + p, w - 1)
                        jitter_bin = inputs.jitter_bin[plan.first_row + i, column]
                        direction[p] = r * plan.jitter_bins + jitter_bin
                        for n in range(6):
                            heading[n, p] = headings[n, direction[p]]
                used[:] = 0
                # Out of its own cell, whatever that holds; its middle is half a cell from a border.
                if stepping.length > 0:
                    for p in range(LANES):
                        ray = Ray(x[p], y, heading[0, p], heading[1, p])
                        t[p], used[p] = first_step(free_distance, ray, stepping)
                    march(flat, lanes, used, steps, stepping.length)
                else:
                    for p in range(LANES):
                        a, b = abs(heading[2, p]), abs(heading[3, p])
                        border = half * (a if a < b else b) + stepping.overshoot
                        t[p] = own_distance[p] if own_distance[p] > border else border
                    leap(flat, lanes, used, steps, stepping.overshoot, scratch)
                for p in range(within):
                    dx, dy = heading[0, p], heading[1, p]
                    u = min(max(x[p] + t[p] * dx, real(0)), flat.last_column)
                    v = min(max(y + t[p] * dy, real(0)), flat.last_row)
                    cell = np.int64(v) * flat.columns + np.int64(u)
                    value = flat.free_distance[cell]
                    # Nearly every ray ends here: at the sky, or at something opaque.
                    if used[p] < steps and value == OUTSIDE:
                        if with_transmittance:
                            out[i, first_column + p, 3 + r] = share
                        else:
                            for c in range(3):
                                total[p, c] += sky[direction[p], c]
                        continue
                    if with_transmittance:
                        out[i, first_column + p, 3 + r] = 0
                    if (
                        used[p] < steps
                        and value == FILLED
                        and cells[cell, 3] >= 1
                        and cell != own_cell[p]
                    ):
                        for c in range(3):
                            total[p, c] += cells[cell, c]
                        continue
                    limits = Limits(t[p], unlimited, steps - used[p], 1)
                    ray = Ray(x[p], y, dx, dy)
                    hit_count, ended = walk(grid, ray, own_cell[p], stepping, limits, hits)
                    beyond = no_sky if with_transmittance else sky[direction[p]]
                    blend(cells, hits[:hit_count], ended, beyond, light)
                    for c in range(3):
                        total[p, c] += light[c]
                    if with_transmittance and ended == ESCAPED:
                        out[i, first_column + p, 3 + r] = light[3] * share
            for p in range(within):
                for c in range(3):
                    out[i, first_column + p, c] = total[p, c] * share


@fast_jit
def _render(frame, real):
    if not answers_version_query(frame):
        inputs, plan = read_trace_arguments(frame, real)
        _render_rows(inputs, plan, result(frame, real))
    return 0


def _render_single(frame):
    return _render(frame, np.float32)


def _render_double(frame):
    return _render(frame, np.float64)


RENDER_FUNCTIONS = {
    ("render", False): _render_single,
    ("render", True): _render_double,
}
"""By name, and whether in double precision."""

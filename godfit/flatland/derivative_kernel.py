"""The derivative of the radiance that the rays gather, and its transpose, compiled by numba."""

from __future__ import annotations

import numpy as np

from godfit.flatland.kernel_records import Limits, Ray, read_trace_arguments
from godfit.flatland.walk_kernel import ESCAPED, first_step, most_hits, walk
from godfit.runtime.call_frame import answers_version_query, matrix, result, vector
from godfit.runtime.numba_jit import fast_jit, inlined_jit

DERIVATIVE_OPAQUE_CELLS = 2
"""A derivative's walk goes on to the second opaque cell: the opacity of the first has a derivative,
which depends on what lies behind it."""


@inlined_jit
def _walk_all(inputs, plan, ray, own_cell, hits):
    """``walk`` from a ray's own cell on, as far as a derivative depends on it."""
    t, used = first_step(inputs.grid.free_distance, ray, plan.stepping)
    unlimited = inputs.grid.free_distance.dtype.type(np.inf)
    limits = Limits(t, unlimited, plan.max_steps - used, DERIVATIVE_OPAQUE_CELLS)
    return walk(inputs.grid, ray, own_cell, plan.stepping, limits, hits)


@fast_jit
def _tangent_rows(inputs, plan, d_cells, d_sky, out):
    """Rows of the picture's derivative along ``d_cells`` and ``d_sky``, which have the shapes of
    the cells and the sky; ``out`` (rows, w, 3)."""
    free_distance, cells = inputs.grid
    _, directions, sky, jitter_bin = inputs
    rays = plan.rays
    real, width = free_distance.dtype.type, free_distance.shape[1]
    hits = np.empty(most_hits(free_distance), np.int64)
    share = real(1) / real(rays)
    for i in range(out.shape[0]):
        row = plan.first_row + i
        y = real(row) + real(1.5)
        for j in range(out.shape[1]):
            x = real(j) + real(1.5)
            to = out[i, j]
            to[:] = 0
            own_cell = np.int64(y) * width + np.int64(x)
            for r in range(rays):
                k = r * plan.jitter_bins + jitter_bin[row, j]
                ray = Ray(x, y, directions[k, 0], directions[k, 1])
                hit_count, ended = _walk_all(inputs, plan, ray, own_cell, hits)
                transmittance, d_transmittance = share, real(0)
                for n in range(hit_count):
                    cell = hits[n]
                    for c in range(3):
                        to[c] += d_transmittance * cells[cell, c] + transmittance * d_cells[cell, c]
                    through = 1 - cells[cell, 3]
                    d_transmittance = d_transmittance * through - transmittance * d_cells[cell, 3]
                    transmittance *= through
                if ended == ESCAPED:
                    for c in range(3):
                        to[c] += d_transmittance * sky[k, c] + transmittance * d_sky[k, c]


@fast_jit
def _transpose_rows(inputs, plan, end_row, cotangent, out):
    """The transpose of ``_tangent_rows``, of the rows up to ``end_row``: ``cotangent`` (h, 3 w),
    ``out`` (1, cells + R J, 4), for the cells and then, in its first three columns, for the sky."""
    free_distance, cells = inputs.grid
    _, directions, sky, jitter_bin = inputs
    rays, cell_count = plan.rays, cells.shape[0]
    real, width = free_distance.dtype.type, free_distance.shape[1]
    hits = np.empty(most_hits(free_distance), np.int64)
    share = real(1) / real(rays)
    # The transmittance up to every hit, and the radiance that reaches it from behind.
    transmittance, behind = np.empty(len(hits) + 1, real), np.empty(3, real)
    to = out[0]
    to[:] = 0
    for i in range(plan.first_row, end_row):
        y = real(i) + real(1.5)
        for j in range(jitter_bin.shape[1]):
            x = real(j) + real(1.5)
            own_cell = np.int64(y) * width + np.int64(x)
            g = cotangent[i, 3 * j : 3 * j + 3]
            if g[0] == 0 and g[1] == 0 and g[2] == 0:
                continue
            for r in range(rays):
                k = r * plan.jitter_bins + jitter_bin[i, j]
                ray = Ray(x, y, directions[k, 0], directions[k, 1])
                hit_count, ended = _walk_all(inputs, plan, ray, own_cell, hits)
                transmittance[0] = share
                for n in range(hit_count):
                    transmittance[n + 1] = transmittance[n] * (1 - cells[hits[n], 3])
                behind[:] = 0
                if ended == ESCAPED:
                    for c in range(3):
                        behind[c] = sky[k, c]
                        to[cell_count + k, c] += g[c] * transmittance[hit_count]
                for n in range(hit_count - 1, -1, -1):
                    cell = hits[n]
                    lost = real(0)
                    for c in range(3):
                        to[cell, c] += g[c] * transmittance[n]
                        lost += g[c] * behind[c]
                        behind[c] = cells[cell, c] + (1 - cells[cell, 3]) * behind[c]
                    to[cell, 3] -= transmittance[n] * lost


@fast_jit
def _tangent(frame, real):
    if not answers_version_query(frame):
        inputs, plan = read_trace_arguments(frame, real)
        d_cells, d_sky = matrix(frame, 7, real), matrix(frame, 8, real)
        _tangent_rows(inputs, plan, d_cells, d_sky, result(frame, real))
    return 0


@fast_jit
def _transpose(frame, real):
    if not answers_version_query(frame):
        inputs, plan = read_trace_arguments(frame, real)
        end_row = vector(frame, 6, np.int32)[4]
        _transpose_rows(inputs, plan, end_row, matrix(frame, 7, real), result(frame, real))
    return 0


def _tangent_single(frame):
    return _tangent(frame, np.float32)


def _tangent_double(frame):
    return _tangent(frame, np.float64)


def _transpose_single(frame):
    return _transpose(frame, np.float32)


def _transpose_double(frame):
    return _transpose(frame, np.float64)


DERIVATIVE_FUNCTIONS = {
    ("tangent", False): _tangent_single,
    ("tangent", True): _tangent_double,
    ("transpose", False): _transpose_single,
    ("transpose", True): _transpose_double,
}
"""By name, and whether in double precision."""

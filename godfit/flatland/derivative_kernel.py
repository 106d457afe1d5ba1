"""The derivative of what the rays see, and its transpose, compiled by numba.

Arrays are those of ``godfit.flatland.render_kernel``.
"""

from __future__ import annotations

import numpy as np

from godfit.flatland.walk_kernel import LEFT, first_step, walk
from godfit.runtime.numba_jit import fast_jit
from godfit.runtime.xla_ffi import answers_version_query, matrix, result, vector


@fast_jit
def _moved(free, cells, directions, sky, turn, numbers, whole, d_cells, d_sky, out):
    """``_picture``'s derivative along d_cells and d_sky."""
    real = free.dtype.type
    rays, kinds, steps, begin = whole[0], whole[1], whole[2], whole[3]
    step, little = numbers[0], numbers[1]
    width = free.shape[1]
    hits = np.empty(free.shape[0] * 2 + free.shape[1] * 2, np.int64)
    share, unlimited = real(1) / real(rays), real(np.inf)
    for i in range(out.shape[0]):
        y = real(begin + i) + real(1.5)
        for j in range(out.shape[1]):
            x = real(j) + real(1.5)
            to = out[i, j]
            to[:] = 0
            own = np.int64(y) * width + np.int64(x)
            for r in range(rays):
                k = r * kinds + turn[begin + i, j]
                dx, dy = directions[k, 0], directions[k, 1]
                t, used = first_step(free, x, y, dx, dy, step, little)
                found, ended = walk(
                    free, cells, x, y, dx, dy, t, own, unlimited, step, little, steps - used, 2,
                    hits,
                )  # fmt: skip
                passing, d_passing = share, real(0)
                for n in range(found):
                    cell = hits[n]
                    for c in range(3):
                        to[c] += d_passing * cells[cell, c] + passing * d_cells[cell, c]
                    open_ = 1 - cells[cell, 3]
                    d_passing = d_passing * open_ - passing * d_cells[cell, 3]
                    passing *= open_
                if ended == LEFT:
                    for c in range(3):
                        to[c] += d_passing * sky[k, c] + passing * d_sky[k, c]


@fast_jit
def _pulled(free, cells, directions, sky, turn, numbers, whole, pull, out):
    """``_moved``'s transpose: ``pull`` (h, 3 w), out (1, cells + rays kinds, 4)."""
    real = free.dtype.type
    rays, kinds, steps, begin, end = whole[0], whole[1], whole[2], whole[3], whole[4]
    step, little = numbers[0], numbers[1]
    width, count = free.shape[1], cells.shape[0]
    hits = np.empty(free.shape[0] * 2 + free.shape[1] * 2, np.int64)
    share, unlimited = real(1) / real(rays), real(np.inf)
    passings, behind = np.empty(len(hits) + 1, free.dtype), np.empty(3, free.dtype)
    to = out[0]
    to[:] = 0
    for i in range(begin, end):
        y = real(i) + real(1.5)
        for j in range(turn.shape[1]):
            x = real(j) + real(1.5)
            own = np.int64(y) * width + np.int64(x)
            g = pull[i, 3 * j : 3 * j + 3]
            if g[0] == 0 and g[1] == 0 and g[2] == 0:
                continue
            for r in range(rays):
                k = r * kinds + turn[i, j]
                dx, dy = directions[k, 0], directions[k, 1]
                t, used = first_step(free, x, y, dx, dy, step, little)
                found, ended = walk(
                    free, cells, x, y, dx, dy, t, own, unlimited, step, little, steps - used, 2,
                    hits,
                )  # fmt: skip
                passings[0] = share
                for n in range(found):
                    passings[n + 1] = passings[n] * (1 - cells[hits[n], 3])
                behind[:] = 0
                if ended == LEFT:
                    for c in range(3):
                        behind[c] = sky[k, c]
                        to[count + k, c] += g[c] * passings[found]
                for n in range(found - 1, -1, -1):
                    cell = hits[n]
                    lost = real(0)
                    for c in range(3):
                        to[cell, c] += g[c] * passings[n]
                        lost += g[c] * behind[c]
                        behind[c] = cells[cell, c] + (1 - cells[cell, 3]) * behind[c]
                    to[cell, 3] -= passings[n] * lost


@fast_jit
def _tangent(frame, real):
    if not answers_version_query(frame):
        _moved(
            matrix(frame, 0, real), matrix(frame, 1, real), matrix(frame, 2, real),
            matrix(frame, 3, real), matrix(frame, 4, np.int32), vector(frame, 5, real),
            vector(frame, 6, np.int32), matrix(frame, 7, real), matrix(frame, 8, real),
            result(frame, real),
        )  # fmt: skip
    return 0


@fast_jit
def _transpose(frame, real):
    if not answers_version_query(frame):
        _pulled(
            matrix(frame, 0, real), matrix(frame, 1, real), matrix(frame, 2, real),
            matrix(frame, 3, real), matrix(frame, 4, np.int32), vector(frame, 5, real),
            vector(frame, 6, np.int32), matrix(frame, 7, real), result(frame, real),
        )  # fmt: skip
    return 0


def _tangent_single(frame):
    return _tangent(frame, np.float32)


def _tangent_double(frame):
    return _tangent(frame, np.float64)


def _transpose_single(frame):
    return _transpose(frame, np.float32)


def _transpose_double(frame):
    return _transpose(frame, np.float64)


FUNCTIONS = {
    ("tangent", False): _tangent_single,
    ("tangent", True): _tangent_double,
    ("transpose", False): _transpose_single,
    ("transpose", True): _transpose_double,
}

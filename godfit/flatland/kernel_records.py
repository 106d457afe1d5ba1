"""The records that the compiled kernels of this room share, and how XLA's buffers become them.

Positions and lengths are in pixels of the padded canvas, which has one more cell on every side than
the canvas: x counts columns to the right and y rows downwards, so the middle of the canvas's first
pixel is (1.5, 1.5).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from godfit.runtime.call_frame import matrix, vector
from godfit.runtime.numba_jit import inlined_jit


class Grid(NamedTuple):
    """The padded canvas of h x w pixels.

    ``free_distance`` (h + 2, w + 2) is how far a ray may go from anywhere in a cell without meeting
    anything, or ``FILLED`` or ``OUTSIDE`` (``godfit.flatland.walk_kernel``). ``cells``
    ((h + 2) (w + 2), 4) is the radiance that a cell adds to a ray, and its opacity.
    """

    free_distance: Any
    cells: Any


class TraceInputs(NamedTuple):
    """What the rays of every pixel depend on: R rays a pixel, each in one of J jittered directions.

    ``directions`` (R J, 2) are unit vectors, right and down; ``sky`` (R J, 3) is the radiance
    outside the canvas in those directions; ``jitter_bin`` (h, w) is which of the J directions each
    of a pixel's rays takes: ray r of a pixel goes in direction r J + jitter_bin.
    """

    grid: Grid
    directions: Any
    sky: Any
    jitter_bin: Any


class Stepping(NamedTuple):
    """How a ray goes on: ``length`` is that of a fixed step, 0 for the distance march, which steps
    by the free distance and at least ``overshoot`` beyond the border of the ray's cell."""

    length: Any
    overshoot: Any


class TracePlan(NamedTuple):
    """``rays`` a pixel, ``jitter_bins`` directions a ray, at most ``max_steps`` steps a ray, the
    ``first_row`` of the pixels that this call computes, and the ``stepping``."""

    rays: Any
    jitter_bins: Any
    max_steps: Any
    first_row: Any
    stepping: Stepping


class Ray(NamedTuple):
    """Origin and direction (a unit vector) of one ray."""

    x: Any
    y: Any
    dx: Any
    dy: Any


class Limits(NamedTuple):
    """A walk's extent along its ray: from the distance ``start`` to the distance ``end``, for at
    most ``steps`` steps, and to the ``opaque_cells``-th cell that lets nothing through."""

    start: Any
    end: Any
    steps: Any
    opaque_cells: Any


@inlined_jit
def read_grid(frame, real):
    """The grid of a call whose first two arguments are its arrays; ``real`` is their dtype."""
    return Grid(matrix(frame, 0, real), matrix(frame, 1, real))


@inlined_jit
def read_trace_arguments(frame, real):
    """The inputs and the plan of a call whose first seven arguments are those of
    ``godfit.flatland.rays.trace_arguments``."""
    inputs = TraceInputs(
        read_grid(frame, real),
        matrix(frame, 2, real),
        matrix(frame, 3, real),
        matrix(frame, 4, np.int32),
    )
    lengths, counts = vector(frame, 5, real), vector(frame, 6, np.int32)
    stepping = Stepping(lengths[0], lengths[1])
    return inputs, TracePlan(counts[0], counts[1], counts[2], counts[3], stepping)

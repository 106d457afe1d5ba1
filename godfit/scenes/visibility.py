"""Nearest surface at the pixel centres: an exact z-buffer with the top-left rule, compiled.

Triangles are scan-converted row by row: the work grows with triangles plus covered pixels. Bands of
rows run on all cores, as the compiled code releases the interpreter's lock. Coordinates are those
of ``projection.py``.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from godfit.runtime.numba_jit import jit
from godfit.runtime.parallel import cores, parallel_map
from godfit.scenes.labels import BACKGROUND_LABEL, LIGHT_LABEL
from godfit.scenes.projection import ProjectedScene

SPAN_MARGIN = 1e-3
"""Pixels that a row's span is widened by at both ends, far above rounding. Edge functions
decide."""
BANDS_PER_CORE = 4
"""Bands of rows for each core: more than one, as objects seldom fill a picture evenly."""


class Pixel(NamedTuple):
    """A pixel and the surfaces that may cover a part of it: the triangles ``candidates`` (c,), as
    row numbers of ``Triangles``, and the edges ``rim`` (n, 4) of the light's outline that cross
    it."""

    column: int
    row: int
    candidates: np.ndarray
    rim: np.ndarray


@jit
def sphere_depth(x, y, sphere, lens, touches):
    """Depth of the front of the light's sphere under the point (x, y), or 0 where there is none.
    With ``touches`` the ray is known to meet the sphere; a ray that misses it by rounding then gets
    the depth of the nearest approach."""
    centre, radius = sphere.centre, sphere.radius
    dx, dy = (x - lens.centre_x) / lens.focal_x, -(y - lens.centre_y) / lens.focal_y
    along = dx * centre[0] + dy * centre[1] - centre[2]
    length = dx * dx + dy * dy + 1.0
    # The squared distance of the centre from the ray, by a cross product: without cancellation.
    ax = centre[1] * -1.0 - centre[2] * dy
    ay = centre[2] * dx + centre[0]
    az = centre[0] * dy - centre[1] * dx
    apart = (ax * ax + ay * ay + az * az) / length
    if along <= 0 or (apart >= radius * radius and not touches):
        return 0.0
    depth = (along - np.sqrt(length * max(radius * radius - apart, 0.0))) / length
    return depth if lens.near <= depth <= lens.far else 0.0


@jit
def _edge_functions(p):
    """Coefficients (3, 3) of the three edge functions of a triangle, each positive inside, and
    whether pixel centres on the edge belong to the triangle (top-left rule).

    The ends of an edge are put in an order first, so that two triangles that share the edge get
    exactly opposite coefficients.
    """
    line = np.empty((3, 3))
    owns = np.empty(3, np.bool_)
    for k in range(3):
        a, b = p[k], p[(k + 1) % 3]
        swap = a[0] > b[0] or (a[0] == b[0] and a[1] > b[1])
        if swap:
            a, b = b, a
        sign = -1.0 if swap else 1.0
        line[k, 0] = -sign * (b[1] - a[1])
        line[k, 1] = sign * (b[0] - a[0])
        line[k, 2] = sign * (a[0] * (b[1] - a[1]) - a[1] * (b[0] - a[0]))
        owns[k] = line[k, 0] > 0 or (line[k, 0] == 0 and line[k, 1] > 0)
    return line, owns


@jit
def _label_rows(scene, first, last, label, q):
    """Fill ``label`` and ``q`` (1/depth) of rows first to before last with the nearest surface at
    the pixel centres."""
    triangles, sphere, lens = scene.triangles, scene.sphere, scene.lens
    width = label.shape[1]
    least_q = 1.0 / lens.far
    for t in range(triangles.label.shape[0]):
        p = triangles.corners[t]
        top = max(first, int(np.ceil(max(min(p[0, 1], p[1, 1], p[2, 1]) - 0.5, -1.0))))
        bottom = min(last - 1, int(np.floor(min(max(p[0, 1], p[1, 1], p[2, 1]) - 0.5, last + 0.0))))
        if top > bottom:
            continue
        line, owns = _edge_functions(p)
        low, high = min(p[0, 0], p[1, 0], p[2, 0]), max(p[0, 0], p[1, 0], p[2, 0])
        for row in range(top, bottom + 1):
            y = row + 0.5
            begin, end = max(low, 0.0), min(high, width + 0.0)
            for k in range(3):
                a, rest = line[k, 0], line[k, 1] * y + line[k, 2]
                if a > 0:
                    begin = max(begin, -rest / a - SPAN_MARGIN)
                elif a < 0:
                    end = min(end, -rest / a + SPAN_MARGIN)
            for column in range(int(np.ceil(begin - 0.5)), int(np.floor(end - 0.5)) + 1):
                if column < 0 or column >= width:
                    continue
                x = column + 0.5
                w0 = line[0, 0] * x + line[0, 1] * y + line[0, 2]
                w1 = line[1, 0] * x + line[1, 1] * y + line[1, 2]
                w2 = line[2, 0] * x + line[2, 1] * y + line[2, 2]
                if (
                    (w0 > 0 or (w0 == 0 and owns[0]))
                    and (w1 > 0 or (w1 == 0 and owns[1]))
                    and (w2 > 0 or (w2 == 0 and owns[2]))
                ):
                    here = (w1 * p[0, 2] + w2 * p[1, 2] + w0 * p[2, 2]) / (w0 + w1 + w2)
                    if here > q[row, column] and here >= least_q:
                        q[row, column] = here
                        label[row, column] = triangles.label[t]
    for row in range(first, last):
        for column in range(width):
            depth = sphere_depth(column + 0.5, row + 0.5, sphere, lens, False)
            if depth > 0 and 1.0 / depth > q[row, column]:
                q[row, column] = 1.0 / depth
                label[row, column] = LIGHT_LABEL


@jit
def surface_at(x, y, pixel, scene):
    """Label of the nearest surface at one point of a pixel, and its triangle (-1 for the light and
    for none).

    In the pixels that the light's outline crosses, its edges bound the light. The sphere lies up to
    thousandths of a pixel beside these edges, enough to give a narrow cell its neighbour's label.
    """
    triangles, rim = scene.triangles, pixel.rim
    nearest_q, label, nearest = 1.0 / scene.lens.far, BACKGROUND_LABEL, -1
    for t in pixel.candidates:
        p = triangles.corners[t]
        w0 = (p[1, 0] - p[0, 0]) * (y - p[0, 1]) - (p[1, 1] - p[0, 1]) * (x - p[0, 0])
        if w0 < 0:
            continue
        w1 = (p[2, 0] - p[1, 0]) * (y - p[1, 1]) - (p[2, 1] - p[1, 1]) * (x - p[1, 0])
        if w1 < 0:
            continue
        w2 = (p[0, 0] - p[2, 0]) * (y - p[2, 1]) - (p[0, 1] - p[2, 1]) * (x - p[2, 0])
        if w2 < 0 or w0 + w1 + w2 == 0:
            continue
        q = (w1 * p[0, 2] + w2 * p[1, 2] + w0 * p[2, 2]) / (w0 + w1 + w2)
        if q > nearest_q:
            nearest_q, label, nearest = q, triangles.label[t], t
    for x0, y0, x1, y1 in rim:
        # The outline is convex: within the pixel, the edges that cross the pixel bound it.
        if (x1 - x0) * (y - y0) < (y1 - y0) * (x - x0):
            return label, nearest
    depth = sphere_depth(x, y, scene.sphere, scene.lens, rim.shape[0] > 0)
    if depth > 0 and depth * nearest_q < 1.0:
        return LIGHT_LABEL, -1
    return label, nearest


def label_pixels(scene: ProjectedScene, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """The z-buffer of a picture of ``size`` (h, w): the label of the nearest surface at the pixel
    centres, (h, w) int32, and 1/depth (h, w), 0 where there is none."""
    labels, q = np.full(size, BACKGROUND_LABEL, np.int32), np.zeros(size)
    map_row_bands(size[0], lambda first, last: _label_rows(scene, first, last, labels, q))
    return labels, q


def map_row_bands(height: int, work: Callable[[int, int], Any]) -> list[Any]:
    """The results of work(first, last) for bands of rows, run on all cores, in order of the
    rows."""
    bands = min(height, BANDS_PER_CORE * cores() if cores() > 1 else 1)
    borders = [height * i // bands for i in range(bands + 1)]
    return parallel_map(lambda rows: work(*rows), list(itertools.pairwise(borders)))

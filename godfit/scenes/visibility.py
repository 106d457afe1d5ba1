"""What lies at the pixel centres: an exact z-buffer with the top-left rule, compiled.

Triangles are found per pixel by their rows' spans: work grows with triangles plus covered pixels.
Rows are shared out among threads; the compiled code releases the interpreter's lock. Coordinates
are those of ``projection.py``.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from godfit.runtime.numba_jit import jit
from godfit.runtime.parallel import cores, parallel_map
from godfit.scenes.projection import Lens, Triangles

BACKGROUND, LIGHT, FIRST_OBJECT = 0, 1, 2


@jit
def sphere_depth(x, y, lens, centre, radius, inside):
    """Depth of the light's front under (x, y), or 0 where it is not. A point known to be ``inside``
    is never beside the sphere: at worst it touches."""
    dx, dy = (x - lens.centre_x) / lens.focal_x, -(y - lens.centre_y) / lens.focal_y
    along = dx * centre[0] + dy * centre[1] - centre[2]
    length = dx * dx + dy * dy + 1.0
    # Distance of the ray from the centre, squared, without cancellation.
    ax = centre[1] * -1.0 - centre[2] * dy
    ay = centre[2] * dx + centre[0]
    az = centre[0] * dy - centre[1] * dx
    apart = (ax * ax + ay * ay + az * az) / length
    if along <= 0 or (apart >= radius * radius and not inside):
        return 0.0
    depth = (along - np.sqrt(length * max(radius * radius - apart, 0.0))) / length
    return depth if lens.near <= depth <= lens.far else 0.0


@jit
def _lines(p):
    """Coefficients (3, 3) of the three edge functions of a triangle, each positive inside, and
    whether pixel centres on the edge belong to it (top-left rule).

    Two triangles that share an edge get exactly opposite numbers: the ends are put in an order
    first.
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
def _label_rows(triangles, lens, centre, radius, first, last, label, q):
    """Nearest surface at the pixel centres of rows first to last."""
    width = label.shape[1]
    least_q = 1.0 / lens.far
    for t in range(triangles.label.shape[0]):
        p = triangles.corners[t]
        top = max(first, int(np.ceil(max(min(p[0, 1], p[1, 1], p[2, 1]) - 0.5, -1.0))))
        bottom = min(last - 1, int(np.floor(min(max(p[0, 1], p[1, 1], p[2, 1]) - 0.5, last + 0.0))))
        if top > bottom:
            continue
        line, owns = _lines(p)
        low, high = min(p[0, 0], p[1, 0], p[2, 0]), max(p[0, 0], p[1, 0], p[2, 0])
        for row in range(top, bottom + 1):
            y = row + 0.5
            begin, end = max(low, 0.0), min(high, width + 0.0)
            for k in range(3):
                a, rest = line[k, 0], line[k, 1] * y + line[k, 2]
                if a > 0:
                    begin = max(begin, -rest / a - 1e-3)
                elif a < 0:
                    end = min(end, -rest / a + 1e-3)
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
            depth = sphere_depth(column + 0.5, row + 0.5, lens, centre, radius, False)
            if depth > 0 and 1.0 / depth > q[row, column]:
                q[row, column] = 1.0 / depth
                label[row, column] = LIGHT


@jit
def seen_at(x, y, triangles, candidates, lens, centre, radius, rim):
    """Label of the nearest surface at one point of the screen, and which triangle it is (-1 where
    it is none). In the pixels that they cross, the edges ``rim`` (n, 4) of the light's outline say
    where it is: the sphere lies up to thousandths of a pixel beside them, enough to take a narrow
    cell for its neighbour."""
    best, found, nearest = 1.0 / lens.far, BACKGROUND, -1
    for t in candidates:
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
        if q > best:
            best, found, nearest = q, triangles.label[t], t
    for x0, y0, x1, y1 in rim:
        # The polygon is convex: within the pixel, those of its edges that cross it bound it.
        if (x1 - x0) * (y - y0) < (y1 - y0) * (x - x0):
            return found, nearest
    depth = sphere_depth(x, y, lens, centre, radius, rim.shape[0] > 0)
    if depth > 0 and depth * best < 1.0:
        return LIGHT, -1
    return found, nearest


def label(
    triangles: Triangles, lens: Lens, centre: np.ndarray, radius: float, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """What lies at the pixel centres: label (h, w) int32, 1/depth (h, w), 0 where nothing is."""
    labels, q = np.full(size, BACKGROUND, np.int32), np.zeros(size)
    share_rows(size[0], lambda a, b: _label_rows(triangles, lens, centre, radius, a, b, labels, q))
    return labels, q


def share_rows(height: int, work: Callable[[int, int], Any]) -> list[Any]:
    """Call work(first, last) for bands of rows, on all cores; what each returned, in order."""
    # More bands than cores: objects seldom fill the picture evenly.
    bands = min(height, 4 * cores() if cores() > 1 else 1)
    at = [height * i // bands for i in range(bands + 1)]
    return parallel_map(lambda rows: work(*rows), list(itertools.pairwise(at)))

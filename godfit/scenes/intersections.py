"""Lines in which surfaces of different colours pass through each other. Compiled.

No edge of a mesh lies on such a line. The lines come from the projected triangles: scan lines
across a pixel find its pieces of line. Both surfaces are equally far at the line, so it moves as
their depths do: where 1/depth of one surface gains d on that of the other, the line moves by d over
the difference of the slopes of 1/depth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from godfit.runtime.numba_jit import jit
from godfit.scenes.labels import BACKGROUND_LABEL, LIGHT_LABEL
from godfit.scenes.visibility import sphere_depth, surface_at

SCANS_PER_AXIS = 8
"""Scan lines through a pixel along each axis. Each piece of line weighs 1/SCANS_PER_AXIS."""
SCAN_INTERVALS = 8
"""Intervals on a scan line. A colour that begins and ends within one interval is missed."""
SCAN_BISECTIONS = 15
"""Bisections of an interval in which the colour changes: 1/8 pixel / 2^15 = 4e-6 pixels."""
SCAN_INSET = 1e-5
"""Pixels between a scan line's ends and the pixel's border, where a neighbour's colour may
begin."""
SLOPE_STEP = 1e-3
"""Pixels to either side of a crossing, for central differences of 1/depth."""
MAX_DEPTH_GAP = 0.2
"""Largest difference of 1/depth at a crossing, in slopes times SLOPE_STEP. Surfaces that differ by
more do not meet there: one of them ends."""
LINE_FIELDS = 9
"""RayParameters of a piece of line: row, column, two colours, two faces, x, y and weight."""


class Crossings(NamedTuple):
    """Pieces of line in which surfaces pass through each other.

    At ``place`` (n, 2), x and y on the screen, the two faces ``faces`` (n, 2) are equally far; -1
    is the light's sphere. When 1/depth of the first exceeds that of the second by d there, colour
    ``colours[i, 0]`` gains ``weight[i] d`` of ``pixel[i]`` from ``colours[i, 1]``.
    """

    pixel: np.ndarray
    faces: np.ndarray
    colours: np.ndarray
    place: np.ndarray
    weight: np.ndarray


@jit
def _inverse_depth(x, y, t, scene):
    """1/depth under (x, y) of the plane of triangle t, or of the light's sphere where t is -1; and
    whether the triangle, or the sphere, covers (x, y)."""
    if t < 0:
        depth = sphere_depth(x, y, scene.sphere, scene.lens, False)
        return (1.0 / depth, True) if depth > 0 else (0.0, False)
    p = scene.triangles.corners[t]
    w0 = (p[1, 0] - p[0, 0]) * (y - p[0, 1]) - (p[1, 1] - p[0, 1]) * (x - p[0, 0])
    w1 = (p[2, 0] - p[1, 0]) * (y - p[1, 1]) - (p[2, 1] - p[1, 1]) * (x - p[1, 0])
    w2 = (p[0, 0] - p[2, 0]) * (y - p[2, 1]) - (p[0, 1] - p[2, 1]) * (x - p[2, 0])
    q = (w1 * p[0, 2] + w2 * p[1, 2] + w0 * p[2, 2]) / (w0 + w1 + w2)
    return q, min(w0, w1, w2) >= 0


@jit
def find_lines(pixel, scene, colour_of, lines, count):
    """Append the pieces of line in a pixel to ``lines`` (n, LINE_FIELDS), of which ``count`` are in
    use; returns both. ``lines`` is replaced by a longer array when it is full.

    A piece of line is counted on the scan lines that it crosses at the larger angle.
    """
    column, row, face = pixel.column, pixel.row, scene.triangles.face
    lead = np.empty((2, 2))
    for scan in range(2 * SCANS_PER_AXIS):
        along = scan % 2
        beside = (scan // 2 + 0.5) / SCANS_PER_AXIS
        a, before, i = 0.0, -1, -1
        for part in range(SCAN_INTERVALS + 1):
            b = min(max(part / SCAN_INTERVALS, SCAN_INSET), 1 - SCAN_INSET)
            x, y = (b, beside) if along == 0 else (beside, b)
            label, j = surface_at(column + x, row + y, pixel, scene)
            last, last_j, end = label, j, b
            if part > 0 and colour_of[label] != colour_of[before]:
                for _ in range(SCAN_BISECTIONS):
                    middle = 0.5 * (a + b)
                    x, y = (middle, beside) if along == 0 else (beside, middle)
                    here, t = surface_at(column + x, row + y, pixel, scene)
                    if colour_of[here] == colour_of[before]:
                        a, before, i = middle, here, t
                    else:
                        b, label, j = middle, here, t
                crosses = before != BACKGROUND_LABEL and label != BACKGROUND_LABEL
                for axis in range(2):
                    for side in range(2):
                        step = SLOPE_STEP * (2 * side - 1)
                        dx, dy = (step, 0.0) if axis == 0 else (0.0, step)
                        near_x, near_y = column + x + dx, row + y + dy
                        first, first_covers = _inverse_depth(near_x, near_y, i, scene)
                        second, second_covers = _inverse_depth(near_x, near_y, j, scene)
                        lead[axis, side] = first - second
                        if axis == along:
                            # Both surfaces must reach past the line, each where it is hidden. At an
                            # edge of a mesh one of the two ends.
                            crosses = crosses and (second_covers if side == 0 else first_covers)
                fall = 0.5 * (lead[along, 0] - lead[along, 1]) / SLOPE_STEP
                across = 0.5 * abs(lead[1 - along, 0] - lead[1 - along, 1]) / SLOPE_STEP
                gap = abs(lead[along, 0] + lead[along, 1])
                met = gap < MAX_DEPTH_GAP * SLOPE_STEP * fall
                steep = fall >= across if along == 0 else fall > across
                if crosses and met and steep:
                    if count == lines.shape[0]:
                        lines = np.concatenate((lines, np.empty_like(lines)))
                    line, count = lines[count], count + 1
                    line[0], line[1] = row, column
                    line[2], line[3] = colour_of[before], colour_of[label]
                    line[4] = face[i] if i >= 0 else -1
                    line[5] = face[j] if j >= 0 else -1
                    line[6], line[7] = column + x, row + y
                    line[8] = 1.0 / (SCANS_PER_AXIS * fall)
            a, before, i = end, last, last_j
    return lines, count


def named_crossings(lines: np.ndarray, width: int) -> Crossings:
    """The rows (n, LINE_FIELDS) of ``find_lines`` by name, in a picture of ``width`` pixels."""
    row, column, colours, faces = lines[:, 0], lines[:, 1], lines[:, 2:4], lines[:, 4:6]
    pixel = (row * width + column).astype(np.int64)
    return Crossings(
        pixel, faces.astype(np.int64), colours.astype(np.int64), lines[:, 6:8], lines[:, 8]
    )


@jit
def _minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@jit
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@jit
def _cross_product(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@jit
def _through_sphere(a, b, c, squared):
    """Whether a triangle has points inside and outside the sphere around the origin of that squared
    radius."""
    if max(_dot(a, a), _dot(b, b), _dot(c, c)) <= squared:
        return False
    normal = _cross_product(_minus(b, a), _minus(c, a))
    above = True
    for p, q in ((a, b), (b, c), (c, a)):
        edge = _minus(q, p)
        share = min(max(-_dot(p, edge) / max(_dot(edge, edge), 1e-300), 0.0), 1.0)
        foot = p[0] + share * edge[0], p[1] + share * edge[1], p[2] + share * edge[2]
        if _dot(foot, foot) < squared:
            return True
        above = above and _dot(_cross_product(edge, p), normal) <= 0
    height = _dot(a, normal)
    return above and height * height < squared * _dot(normal, normal)


@jit
def may_cross(mesh, sphere, colour_of):
    """Whether surfaces of different colours may pass through each other: a triangle and the light's
    sphere, or two objects whose boxes overlap. ``colour_of`` (labels,) is the colour of a label."""
    # Compiled, because numpy's temporaries for a million triangles take longer than all else.
    vertices, faces = mesh.vertices, mesh.faces
    labels = colour_of.shape[0]
    low, high = np.full((labels, 3), np.inf), np.full((labels, 3), -np.inf)
    centre, radius = sphere.centre, sphere.radius
    middle = centre[0], centre[1], centre[2]
    for f in range(faces.shape[0]):
        label = mesh.label[f]
        for k in range(3):
            corner = vertices[faces[f, k]]
            for axis in range(3):
                low[label, axis] = min(low[label, axis], corner[axis])
                high[label, axis] = max(high[label, axis], corner[axis])
        if colour_of[label] != colour_of[LIGHT_LABEL]:
            a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
            if _through_sphere(
                _minus(a, middle), _minus(b, middle), _minus(c, middle), radius * radius
            ):
                return True
    for i in range(labels):
        for j in range(i):
            if (
                colour_of[i] != colour_of[j]
                and (low[i] < high[j]).all()
                and (low[j] < high[i]).all()
            ):
                return True
    return False

"""Lines in which surfaces of different colours pass through each other. Compiled.

No edge of a mesh lies there: a picture with such lines is known by its triangles, and a pixel's
piece of line is found by scan lines across it. At the line both surfaces are equally far, so that
it moves as their depths do: where 1/depth of one gains d on the other's, the line goes by d over
the difference of their slopes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from godfit.runtime.numba_jit import jit
from godfit.scenes.visibility import BACKGROUND, LIGHT, seen_at, sphere_depth

# Scan lines of a pixel each way, places on each that are looked at, bisections where the colour
# changes between two of them, and the step, in pixels, that slopes are taken by.
SCANS, PARTS, HALVINGS = 8, 8, 15
NEAR = 1e-3
# Of a piece of line: row and column, two colours, two faces, x and y, and weight.
FIELDS = 9


class Crossed(NamedTuple):
    """Where surfaces pass through each other: at ``place`` (n, 2), x and y on the screen, the faces
    ``faces`` (n, 2), of which -1 is the light's sphere, are equally far. When 1/depth of the first
    exceeds that of the second by d there, colour ``colours[i, 0]`` gains ``weight[i] d`` of
    ``pixel[i]`` from ``colours[i, 1]``."""

    pixel: np.ndarray
    faces: np.ndarray
    colours: np.ndarray
    place: np.ndarray
    weight: np.ndarray


@jit
def _inverse_depth(x, y, triangles, t, lens, centre, radius):
    """1/depth under (x, y) of the plane of triangle t, or of the light's sphere where it is -1; and
    whether the triangle, or the sphere, is there at all."""
    if t < 0:
        depth = sphere_depth(x, y, lens, centre, radius, False)
        return (1.0 / depth, True) if depth > 0 else (0.0, False)
    p = triangles.corners[t]
    w0 = (p[1, 0] - p[0, 0]) * (y - p[0, 1]) - (p[1, 1] - p[0, 1]) * (x - p[0, 0])
    w1 = (p[2, 0] - p[1, 0]) * (y - p[1, 1]) - (p[2, 1] - p[1, 1]) * (x - p[1, 0])
    w2 = (p[0, 0] - p[2, 0]) * (y - p[2, 1]) - (p[0, 1] - p[2, 1]) * (x - p[2, 0])
    q = (w1 * p[0, 2] + w2 * p[1, 2] + w0 * p[2, 2]) / (w0 + w1 + w2)
    return q, min(w0, w1, w2) >= 0


@jit
def find_lines(
    column, row, triangles, candidates, lens, centre, radius, rim, colour_of, found, count
):
    """Append the lines of intersection in a pixel to ``found`` (n, FIELDS), of which ``count`` are
    in use; returns both.

    A piece of line is counted on the scan lines that cross it at the larger angle.
    """
    lead = np.empty((2, 2))
    for scan in range(2 * SCANS):
        along = scan % 2
        beside = (scan // 2 + 0.5) / SCANS
        a, before, i = 0.0, -1, -1
        for part in range(PARTS + 1):
            b = min(max(part / PARTS, 1e-5), 1 - 1e-5)
            x, y = (b, beside) if along == 0 else (beside, b)
            label, j = seen_at(
                column + x, row + y, triangles, candidates, lens, centre, radius, rim
            )
            last, last_j, end = label, j, b
            if part > 0 and colour_of[label] != colour_of[before]:
                for _ in range(HALVINGS):
                    middle = 0.5 * (a + b)
                    x, y = (middle, beside) if along == 0 else (beside, middle)
                    here, t = seen_at(
                        column + x, row + y, triangles, candidates, lens, centre, radius, rim
                    )
                    if colour_of[here] == colour_of[before]:
                        a, before, i = middle, here, t
                    else:
                        b, label, j = middle, here, t
                crosses = before != BACKGROUND and label != BACKGROUND
                for axis in range(2):
                    for side in range(2):
                        step = NEAR * (2 * side - 1)
                        dx, dy = (step, 0.0) if axis == 0 else (0.0, step)
                        over = column + x + dx, row + y + dy
                        first, goes_on = _inverse_depth(
                            over[0], over[1], triangles, i, lens, centre, radius
                        )
                        second, was_there = _inverse_depth(
                            over[0], over[1], triangles, j, lens, centre, radius
                        )
                        lead[axis, side] = first - second
                        if axis == along:
                            # At a mere edge one of the two ends; or they are not equally far.
                            crosses = crosses and (was_there if side == 0 else goes_on)
                fall = 0.5 * (lead[along, 0] - lead[along, 1]) / NEAR
                across = 0.5 * abs(lead[1 - along, 0] - lead[1 - along, 1]) / NEAR
                met = abs(lead[along, 0] + lead[along, 1]) < 0.2 * NEAR * fall
                steep = fall >= across if along == 0 else fall > across
                if crosses and met and steep:
                    if count == found.shape[0]:
                        found = np.concatenate((found, np.empty_like(found)))
                    line, count = found[count], count + 1
                    line[0], line[1] = row, column
                    line[2], line[3] = colour_of[before], colour_of[label]
                    line[4] = triangles.face[i] if i >= 0 else -1
                    line[5] = triangles.face[j] if j >= 0 else -1
                    line[6], line[7], line[8] = column + x, row + y, 1.0 / (SCANS * fall)
            a, before, i = end, last, last_j
    return found, count


def pieces(found: np.ndarray, width: int) -> Crossed:
    """What ``find_lines`` has found, by name."""
    row, column, colours, faces = found[:, 0], found[:, 1], found[:, 2:4], found[:, 4:6]
    pixel = (row * width + column).astype(np.int64)
    return Crossed(
        pixel, faces.astype(np.int64), colours.astype(np.int64), found[:, 6:8], found[:, 8]
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
def may_cross(camera, faces, face_label, colour_of, centre, radius):
    """Whether surfaces of different colours may pass through each other: a triangle the light's
    sphere, or two objects whose boxes overlap."""
    # Compiled, for in numpy the temporaries of a million triangles take longer than all else.
    labels = colour_of.shape[0]
    low, high = np.full((labels, 3), np.inf), np.full((labels, 3), -np.inf)
    middle = centre[0], centre[1], centre[2]
    for f in range(faces.shape[0]):
        label = face_label[f]
        for k in range(3):
            corner = camera[faces[f, k]]
            for axis in range(3):
                low[label, axis] = min(low[label, axis], corner[axis])
                high[label, axis] = max(high[label, axis], corner[axis])
        if colour_of[label] != colour_of[LIGHT]:
            a, b, c = camera[faces[f, 0]], camera[faces[f, 1]], camera[faces[f, 2]]
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

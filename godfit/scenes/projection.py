"""From camera space to the screen: triangles, and the edges that may be contours. Compiled.

Pixel (row i, column j) covers [j, j+1) x [i, i+1), y down; camera space is OpenGL's (x right, y up,
looking along -z); q = 1/depth, which is linear on the screen. Triangles are clipped at the near
plane.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from godfit.runtime.numba_jit import jit


class Lens(NamedTuple):
    """Screen x = centre_x + focal_x X/-Z, y = centre_y - focal_y Y/-Z; near and far depths."""

    focal_x: float
    focal_y: float
    centre_x: float
    centre_y: float
    near: float
    far: float


class Triangles(NamedTuple):
    """On the screen, clipped at the near plane, counter-clockwise in (x, y): corners (n, 3, 3) as
    (x, y, q), what each belongs to (n,), and which face it is, or a part of (n,)."""

    corners: np.ndarray
    label: np.ndarray
    face: np.ndarray


class Edges(NamedTuple):
    """Edges that may be contours, on the screen: ends (n, 4) as x0, y0, x1, y1, and the vertices
    each end is made of (n, 4), i, j, k, l: a vertex where i == j, else where i-j meets the near
    plane; and whether it belongs to the light's outline (n,), which turns from x to y."""

    ends: np.ndarray
    made_of: np.ndarray
    of_light: np.ndarray


@jit
def _cut(camera, i, j, near):
    """The point of segment i-j on the near plane: the same whichever end is named first."""
    if i > j:
        i, j = j, i
    a, b = -camera[i, 2], -camera[j, 2]
    t = (near - a) / (b - a)
    x = camera[i, 0] + t * (camera[j, 0] - camera[i, 0])
    y = camera[i, 1] + t * (camera[j, 1] - camera[i, 1])
    return x, y, near


@jit
def _at(camera, i, j, near):
    """(x, y, depth) of a point made of i and j."""
    if i == j:
        return camera[i, 0], camera[i, 1], -camera[i, 2]
    return _cut(camera, i, j, near)


@jit
def _project(point, lens):
    x, y, depth = point
    q = 1.0 / depth
    return lens.centre_x + lens.focal_x * x * q, lens.centre_y - lens.focal_y * y * q, q


@jit
def _polygon(camera, faces, f, near, made_of):
    """Corners of face f before the near plane, as pairs i, j; how many (0, 3 or 4); and the two
    that lie on the near plane (or -1)."""
    count, first_cut, last_cut = 0, -1, -1
    for k in range(3):
        i, j = faces[f, k], faces[f, (k + 1) % 3]
        inside, next_inside = -camera[i, 2] >= near, -camera[j, 2] >= near
        if inside:
            made_of[count, 0], made_of[count, 1] = i, i
            count += 1
        if inside != next_inside:
            made_of[count, 0], made_of[count, 1] = i, j
            first_cut, last_cut = last_cut, count
            count += 1
    return count, first_cut, last_cut


@jit
def _screen_triangles(camera, faces, face_label, lens, height, width, corners, label, face, cuts):
    """Fill ``corners``, ``label`` and ``face``, and ``cuts`` (near-plane edges, as four indices);
    returns how many of each there are. Called with empty arrays it only counts."""
    made_of = np.empty((4, 2), np.int64)
    screen = np.empty((4, 3))
    n, m = 0, 0
    for f in range(faces.shape[0]):
        count, first_cut, last_cut = _polygon(camera, faces, f, lens.near, made_of)
        if count < 3:
            continue
        if first_cut >= 0:
            if cuts.shape[0] > 0:
                for k in range(2):
                    cuts[m, k] = made_of[first_cut, k]
                    cuts[m, 2 + k] = made_of[last_cut, k]
            m += 1
        for k in range(count):
            point = _at(camera, made_of[k, 0], made_of[k, 1], lens.near)
            screen[k, 0], screen[k, 1], screen[k, 2] = _project(point, lens)
        for k in range(1, count - 1):
            x0, x1, x2 = screen[0, 0], screen[k, 0], screen[k + 1, 0]
            y0, y1, y2 = screen[0, 1], screen[k, 1], screen[k + 1, 1]
            area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
            outside = (
                max(x0, x1, x2) < 0
                or min(x0, x1, x2) > width
                or max(y0, y1, y2) < 0
                or min(y0, y1, y2) > height
            )
            if area == 0 or outside or not np.isfinite(area):
                continue
            if corners.shape[0] > 0:
                second, third = (k, k + 1) if area > 0 else (k + 1, k)
                corners[n, 0], corners[n, 1], corners[n, 2] = (
                    screen[0],
                    screen[second],
                    screen[third],
                )
                label[n], face[n] = face_label[f], f
            n += 1
    return n, m


def screen_triangles(
    camera: np.ndarray,
    faces: np.ndarray,
    face_label: np.ndarray,
    lens: Lens,
    size: tuple[int, int],
) -> tuple[Triangles, np.ndarray]:
    """Project and clip: camera (v, 3), faces (t, 3) -> triangles, and (n, 4) near-plane cuts."""

    def fill(n: int, m: int):
        found = Triangles(np.empty((n, 3, 3)), np.empty(n, np.int32), np.empty(n, np.int32))
        cuts = np.empty((m, 4), np.int32)
        counts = _screen_triangles(camera, faces, face_label, lens, *size, *found, cuts)
        return counts, found, cuts

    (n, m), _, _ = fill(0, 0)
    # One spare row, so that arrays that are to be filled are never empty.
    _, found, cuts = fill(n + 1, m + 1)
    return Triangles(*(z[:n] for z in found)), cuts[:m]


@jit
def _may_be_contour(camera, edges, e):
    """Whether both faces of the edge lie on one side of it, as seen from the camera; edges of one
    face, or of more than two, always may."""
    a, b, c, d = edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3]
    if c < 0 or d < 0:
        return True
    x = camera[a, 1] * camera[b, 2] - camera[a, 2] * camera[b, 1]
    y = camera[a, 2] * camera[b, 0] - camera[a, 0] * camera[b, 2]
    z = camera[a, 0] * camera[b, 1] - camera[a, 1] * camera[b, 0]
    side_c = x * camera[c, 0] + y * camera[c, 1] + z * camera[c, 2]
    side_d = x * camera[d, 0] + y * camera[d, 1] + z * camera[d, 2]
    return side_c * side_d >= 0


@jit
def _screen_edges(camera, edges, outline, cuts, lens, height, width, ends, made_of):
    """Project the candidates among ``edges`` (e, 4), the polygon of the vertices from ``outline``
    on, and ``cuts``; returns how many there are. Called with empty arrays it only counts."""
    n = 0
    count = camera.shape[0] - outline
    for e in range(edges.shape[0] + count + cuts.shape[0]):
        if e < edges.shape[0]:
            i, k = edges[e, 0], edges[e, 1]
            j, m = i, k
            in_i, in_k = -camera[i, 2] >= lens.near, -camera[k, 2] >= lens.near
            if not (in_i or in_k) or not _may_be_contour(camera, edges, e):
                continue
        elif e < edges.shape[0] + count:
            i = outline + e - edges.shape[0]
            k = outline + (e - edges.shape[0] + 1) % count
            j, m = i, k
            in_i, in_k = -camera[i, 2] >= lens.near, -camera[k, 2] >= lens.near
            if not (in_i or in_k):
                continue
        else:
            c = e - edges.shape[0] - count
            i, j, k, m = cuts[c, 0], cuts[c, 1], cuts[c, 2], cuts[c, 3]
            in_i, in_k = True, True
        if not in_i:
            j = k
        elif not in_k:
            m = i
        x0, y0, _ = _project(_at(camera, i, j, lens.near), lens)
        x1, y1, _ = _project(_at(camera, k, m, lens.near), lens)
        if (
            max(x0, x1) < 0
            or min(x0, x1) > width
            or max(y0, y1) < 0
            or min(y0, y1) > height
            or not np.isfinite(x0 + y0 + x1 + y1)
        ):
            continue
        if ends.shape[0] > 0:
            ends[n, 0], ends[n, 1], ends[n, 2], ends[n, 3] = x0, y0, x1, y1
            made_of[n, 0], made_of[n, 1], made_of[n, 2], made_of[n, 3] = i, j, k, m
        n += 1
    return n


def screen_edges(
    camera: np.ndarray,
    edges: np.ndarray,
    outline: int,
    cuts: np.ndarray,
    lens: Lens,
    size: tuple[int, int],
) -> Edges:
    """Edges that may be contours; the vertices from ``outline`` on are the light's outline."""
    none = np.empty((0, 4)), np.empty((0, 4), np.int32)
    n = _screen_edges(camera, edges, outline, cuts, lens, *size, *none)
    filled = np.empty((n + 1, 4)), np.empty((n + 1, 4), np.int32)
    _screen_edges(camera, edges, outline, cuts, lens, *size, *filled)
    ends, made_of = filled[0][:n], filled[1][:n]
    return Edges(ends, made_of, made_of[:, 0] >= outline)

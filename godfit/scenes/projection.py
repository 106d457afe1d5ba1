"""Projection of a scene to the screen: triangles, and the edges that may be contours. Compiled.

Pixel (row i, column j) covers [j, j+1) x [i, i+1), y down. Camera space is OpenGL's: x right, y up,
the view is along -z. q = 1/depth is linear on the screen. Triangles are clipped at the near
plane.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from godfit.runtime.numba_jit import jit


class Lens(NamedTuple):
    """Pinhole camera: screen x = centre_x + focal_x X/-Z, y = centre_y - focal_y Y/-Z, in pixels.
    ``near`` and ``far`` are depths in the scene's unit."""

    focal_x: float
    focal_y: float
    centre_x: float
    centre_y: float
    near: float
    far: float


def lens_of(size: tuple[int, int], focal: float, near: float, far: float) -> Lens:
    """The lens of a picture of ``size`` (height, width), its focal length in half heights of it."""
    height, width = size
    scale = 0.5 * height * focal
    return Lens(scale, scale, 0.5 * width, 0.5 * height, near, far)


class Sphere(NamedTuple):
    """The light in camera space: centre (3,) float64 and radius, in the scene's unit."""

    centre: np.ndarray
    radius: float


NO_SPHERE = Sphere(np.array([0.0, 0.0, 1.0]), 0.0)
"""A sphere behind the view that covers nothing."""


class CameraMesh(NamedTuple):
    """All triangles of a scene: vertices (v, 3) float64 in camera space, faces (t, 3) int32, the
    label (t,) int32 of the object that each face belongs to, and whether it is drawn only where it
    is counter-clockwise (t,); an empty array stands for none."""

    vertices: np.ndarray
    faces: np.ndarray
    label: np.ndarray
    single_sided: np.ndarray = np.zeros(0, np.bool_)


class Triangles(NamedTuple):
    """Triangles on the screen, clipped at the near plane, counter-clockwise in (x, y): corners
    (n, 3, 3) as (x, y, q), the label (n,) of the object, and the face (n,) that the triangle is, or
    is a part of."""

    corners: np.ndarray
    label: np.ndarray
    face: np.ndarray


class ProjectedScene(NamedTuple):
    """All surfaces that can cover a pixel, and the lens that they were projected through."""

    triangles: Triangles
    sphere: Sphere
    lens: Lens


class EdgeSources(NamedTuple):
    """Edges in camera space, before projection: ``vertices`` (v, 3); ``edges`` (e, 4) as in
    ``mesh.edges``; the closed polygon of the vertices from number ``outline`` on, which is the
    light's outline; and ``cuts`` (n, 4), the edges in which the near plane cuts faces."""

    vertices: np.ndarray
    edges: np.ndarray
    outline: int
    cuts: np.ndarray


class Edges(NamedTuple):
    """Edges on the screen that may be contours: ends (n, 4) as x0, y0, x1, y1, in pixels; the
    vertices i, j, k, l that the two ends are made of (n, 4); and whether an edge belongs to the
    light's outline (n,), which turns from x to y.

    The first end is vertex i where i == j, else the point where the segment i-j meets the near
    plane. The second end is made of k and l in the same way.
    """

    ends: np.ndarray
    made_of: np.ndarray
    of_light: np.ndarray


@jit
def _near_plane_point(vertices, i, j, near):
    """The point of segment i-j on the near plane, the same for i-j and for j-i."""
    if i > j:
        i, j = j, i
    a, b = -vertices[i, 2], -vertices[j, 2]
    t = (near - a) / (b - a)
    x = vertices[i, 0] + t * (vertices[j, 0] - vertices[i, 0])
    y = vertices[i, 1] + t * (vertices[j, 1] - vertices[i, 1])
    return x, y, near


@jit
def _point_made_of(vertices, i, j, near):
    """(x, y, depth) of the point made of i and j: see ``Edges``."""
    if i == j:
        return vertices[i, 0], vertices[i, 1], -vertices[i, 2]
    return _near_plane_point(vertices, i, j, near)


@jit
def _project(point, lens):
    """(x, y, depth) in camera space -> (x, y, q) on the screen."""
    x, y, depth = point
    q = 1.0 / depth
    return lens.centre_x + lens.focal_x * x * q, lens.centre_y - lens.focal_y * y * q, q


@jit
def _clip_face(mesh, f, near, made_of):
    """Clip face f at the near plane. Fills ``made_of`` with the corners, as pairs i, j; returns
    their number (0, 3 or 4), and the two corners that lie on the near plane (or -1)."""
    vertices, faces = mesh.vertices, mesh.faces
    count, first_cut, last_cut = 0, -1, -1
    for k in range(3):
        i, j = faces[f, k], faces[f, (k + 1) % 3]
        inside, next_inside = -vertices[i, 2] >= near, -vertices[j, 2] >= near
        if inside:
            made_of[count, 0], made_of[count, 1] = i, i
            count += 1
        if inside != next_inside:
            made_of[count, 0], made_of[count, 1] = i, j
            first_cut, last_cut = last_cut, count
            count += 1
    return count, first_cut, last_cut


@jit
def _screen_triangles(mesh, lens, size, triangles, cuts):
    """Fill ``triangles`` and ``cuts`` (near-plane edges, as four indices); returns the number of
    each. With empty arrays it only counts."""
    height, width = size
    corners, label, face = triangles.corners, triangles.label, triangles.face
    made_of = np.empty((4, 2), np.int64)
    screen = np.empty((4, 3))
    n, m = 0, 0
    for f in range(mesh.faces.shape[0]):
        count, first_cut, last_cut = _clip_face(mesh, f, lens.near, made_of)
        if count < 3:
            continue
        if first_cut >= 0:
            if cuts.shape[0] > 0:
                for k in range(2):
                    cuts[m, k] = made_of[first_cut, k]
                    cuts[m, 2 + k] = made_of[last_cut, k]
            m += 1
        for k in range(count):
            point = _point_made_of(mesh.vertices, made_of[k, 0], made_of[k, 1], lens.near)
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
            # y is down: what is counter-clockwise in space has a negative area here.
            culled = area > 0 and f < mesh.single_sided.shape[0] and mesh.single_sided[f]
            if area == 0 or outside or culled or not np.isfinite(area):
                continue
            if corners.shape[0] > 0:
                second, third = (k, k + 1) if area > 0 else (k + 1, k)
                corners[n, 0], corners[n, 1], corners[n, 2] = (
                    screen[0],
                    screen[second],
                    screen[third],
                )
                label[n], face[n] = mesh.label[f], f
            n += 1
    return n, m


def screen_triangles(
    mesh: CameraMesh, lens: Lens, size: tuple[int, int]
) -> tuple[Triangles, np.ndarray]:
    """Project and clip the faces of ``mesh`` to a picture of ``size`` (height, width). Returns the
    triangles, and the near-plane cuts (n, 4): see ``EdgeSources``."""

    def fill(n: int, m: int):
        triangles = Triangles(np.empty((n, 3, 3)), np.empty(n, np.int32), np.empty(n, np.int32))
        cuts = np.empty((m, 4), np.int32)
        return _screen_triangles(mesh, lens, size, triangles, cuts), triangles, cuts

    (n, m), _, _ = fill(0, 0)
    # The spare row keeps arrays to be filled from being empty, which means counting alone.
    _, triangles, cuts = fill(n + 1, m + 1)
    return Triangles(*(z[:n] for z in triangles)), cuts[:m]


@jit
def _may_be_contour(vertices, edges, e):
    """Whether both faces of edge e lie on one side of it, from the camera. An edge of one face, or
    of more than two, always may be a contour."""
    a, b, c, d = edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3]
    if c < 0 or d < 0:
        return True
    x = vertices[a, 1] * vertices[b, 2] - vertices[a, 2] * vertices[b, 1]
    y = vertices[a, 2] * vertices[b, 0] - vertices[a, 0] * vertices[b, 2]
    z = vertices[a, 0] * vertices[b, 1] - vertices[a, 1] * vertices[b, 0]
    side_c = x * vertices[c, 0] + y * vertices[c, 1] + z * vertices[c, 2]
    side_d = x * vertices[d, 0] + y * vertices[d, 1] + z * vertices[d, 2]
    return side_c * side_d >= 0


@jit
def _screen_edges(sources, lens, size, ends, made_of):
    """Project the edges of ``sources`` that may be contours into ``ends`` and ``made_of``; returns
    their number. With empty arrays it only counts."""
    height, width = size
    vertices, edges, cuts = sources.vertices, sources.edges, sources.cuts
    n = 0
    count = vertices.shape[0] - sources.outline
    for e in range(edges.shape[0] + count + cuts.shape[0]):
        if e < edges.shape[0]:
            i, k = edges[e, 0], edges[e, 1]
            j, m = i, k
            in_i, in_k = -vertices[i, 2] >= lens.near, -vertices[k, 2] >= lens.near
            if not (in_i or in_k) or not _may_be_contour(vertices, edges, e):
                continue
        elif e < edges.shape[0] + count:
            i = sources.outline + e - edges.shape[0]
            k = sources.outline + (e - edges.shape[0] + 1) % count
            j, m = i, k
            in_i, in_k = -vertices[i, 2] >= lens.near, -vertices[k, 2] >= lens.near
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
        x0, y0, _ = _project(_point_made_of(vertices, i, j, lens.near), lens)
        x1, y1, _ = _project(_point_made_of(vertices, k, m, lens.near), lens)
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


def screen_edges(sources: EdgeSources, lens: Lens, size: tuple[int, int]) -> Edges:
    """The edges of ``sources`` that may be contours in a picture of ``size`` (height, width)."""

    def fill(n: int):
        ends, made_of = np.empty((n, 4)), np.empty((n, 4), np.int32)
        return _screen_edges(sources, lens, size, ends, made_of), ends, made_of

    n, _, _ = fill(0)
    # As in ``screen_triangles``, one spare row.
    _, ends, made_of = fill(n + 1)
    ends, made_of = ends[:n], made_of[:n]
    return Edges(ends, made_of, made_of[:, 0] >= sources.outline)

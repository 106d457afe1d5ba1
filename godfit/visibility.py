"""What is seen in every pixel, and where one colour gives way to another: exact, compiled.

Colours are constant over an object, so a mask changes only across contours: silhouette edges,
boundary edges, cuts by the near plane, and the outline of the light. ``label`` draws what lies at
the pixel centres. ``contours`` works out the pixels that a contour crosses: lines sweep over the
pixel, the edges divide them into cells, one ray says which colour a cell has, and between two
events (an edge's end, a crossing of two edges, a corner of the pixel) cells are trapezoids, so that
areas are exact. Where two neighbouring cells differ in colour, the edge between them is visible,
and the areas change with its ends as the end points of a trapezoid's side move.

Triangles are found per pixel by their rows' spans: work grows with triangles plus covered pixels.
Rows are shared out among threads; the compiled code releases the interpreter's lock.

Coordinates here: pixel (row i, column j) covers [j, j+1) x [i, i+1), y down; camera space is
OpenGL's (x right, y up, looking along -z); q = 1/depth, which is linear on the screen.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numba import njit

from godfit.cache import numba_keeps

BACKGROUND, LIGHT, FIRST_OBJECT = 0, 1, 2
# Lines of the sweep are not level: y + SHEAR x is constant along them, so that the edges people
# draw, upright and level ones, are never parallel to a line.
SHEAR = 0.3719
# More edges than this in one pixel are swept by so many even steps, without their crossings.
MANY_EDGES = 64
EVEN_STEPS = 32
# Cells narrower than this share of a pixel are nobody's.
NARROW = 1e-10


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
    (x, y, q), what each belongs to (n,)."""

    corners: np.ndarray
    label: np.ndarray


class Edges(NamedTuple):
    """Edges that may be contours, on the screen: ends (n, 4) as x0, y0, x1, y1, and the vertices
    each end is made of (n, 4), i, j, k, l: a vertex where i == j, else where i-j meets the near
    plane; and whether it belongs to the light's outline (n,), which turns from x to y."""

    ends: np.ndarray
    made_of: np.ndarray
    of_light: np.ndarray


class Contours(NamedTuple):
    """Shares (h, w, colours) of every pixel, and how they follow the edges: fragment f adds
    ``weight[f, c] @ (dx0, dy0, dx1, dy1)`` to colour c's share of ``pixel[f]`` when the ends of
    edge ``edge[f]`` move by so many pixels."""

    share: np.ndarray
    pixel: np.ndarray
    edge: np.ndarray
    weight: np.ndarray


_compiled = njit(cache=numba_keeps(), nogil=True, error_model="numpy")


@_compiled
def _cut(camera, i, j, near):
    """The point of segment i-j on the near plane: the same whichever end is named first."""
    if i > j:
        i, j = j, i
    a, b = -camera[i, 2], -camera[j, 2]
    t = (near - a) / (b - a)
    x = camera[i, 0] + t * (camera[j, 0] - camera[i, 0])
    y = camera[i, 1] + t * (camera[j, 1] - camera[i, 1])
    return x, y, near


@_compiled
def _at(camera, i, j, near):
    """(x, y, depth) of a point made of i and j."""
    if i == j:
        return camera[i, 0], camera[i, 1], -camera[i, 2]
    return _cut(camera, i, j, near)


@_compiled
def _project(point, lens):
    x, y, depth = point
    q = 1.0 / depth
    return lens.centre_x + lens.focal_x * x * q, lens.centre_y - lens.focal_y * y * q, q


@_compiled
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


@_compiled
def _screen_triangles(camera, faces, face_label, lens, height, width, corners, label, cuts):
    """Fill ``corners`` and ``label`` and ``cuts`` (near-plane edges, as four indices); returns how
    many of each there are. Called with empty arrays it only counts."""
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
                label[n] = face_label[f]
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
    none = np.empty((0, 3, 3)), np.empty(0, np.int32), np.empty((0, 4), np.int32)
    n, m = _screen_triangles(camera, faces, face_label, lens, *size, *none)
    corners, label = np.empty((n, 3, 3)), np.empty(n, np.int32)
    cuts = np.empty((m, 4), np.int32)
    if n or m:
        # One spare row, so that arrays that are to be filled are never empty.
        filled = np.empty((n + 1, 3, 3)), np.empty(n + 1, np.int32), np.empty((m + 1, 4), np.int32)
        _screen_triangles(camera, faces, face_label, lens, *size, *filled)
        corners, label, cuts = filled[0][:n], filled[1][:n], filled[2][:m]
    return Triangles(corners, label), cuts


@_compiled
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


@_compiled
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


@_compiled
def _sphere_depth(x, y, lens, centre, radius, inside):
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


@_compiled
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


@_compiled
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
            depth = _sphere_depth(column + 0.5, row + 0.5, lens, centre, radius, False)
            if depth > 0 and 1.0 / depth > q[row, column]:
                q[row, column] = 1.0 / depth
                label[row, column] = LIGHT


def label(
    triangles: Triangles, lens: Lens, centre: np.ndarray, radius: float, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """What lies at the pixel centres: label (h, w) int32, 1/depth (h, w), 0 where nothing is."""
    labels, q = np.full(size, BACKGROUND, np.int32), np.zeros(size)
    share_rows(size[0], lambda a, b: _label_rows(triangles, lens, centre, radius, a, b, labels, q))
    return labels, q


def share_rows(height: int, work) -> None:
    """Call work(first, last) for bands of rows, on all cores."""
    cores = os.cpu_count() or 1
    # More bands than cores: objects seldom fill the picture evenly.
    bands = min(height, 4 * cores if cores > 1 else 1)
    at = [height * i // bands for i in range(bands + 1)]
    if bands == 1:
        work(0, height)
        return
    with ThreadPoolExecutor(cores) as pool:
        for _ in pool.map(work, at[:-1], at[1:]):
            pass


@_compiled
def _span(x0, y0, x1, y1, row):
    """Least and greatest x of a segment within [row, row + 1]; least > greatest if it is not."""
    if y0 > y1:
        x0, y0, x1, y1 = x1, y1, x0, y0
    if y1 < row or y0 > row + 1:
        return np.inf, -np.inf
    a, b = x0, x1
    if y0 < row:
        a = x0 + (x1 - x0) * ((row - y0) / (y1 - y0))
    if y1 > row + 1:
        b = x0 + (x1 - x0) * ((row + 1 - y0) / (y1 - y0))
    return min(a, b), max(a, b)


@_compiled
def _edges_of_pixels(ends, height, width, begin, listed):
    """Lists of the edges that cross each pixel. ``begin`` (h w + 1): counts on the first call
    (``listed`` empty), starts afterwards; the second call fills ``listed``."""
    filling = listed.shape[0] > 0
    for e in range(ends.shape[0]):
        x0, y0, x1, y1 = ends[e]
        top = int(np.floor(max(min(y0, y1), 0.0)))
        bottom = int(np.floor(min(max(y0, y1), height - 1.0)))
        for row in range(top, bottom + 1):
            low, high = _span(x0, y0, x1, y1, row)
            if low > high:
                continue
            left = int(np.floor(max(low, 0.0)))
            right = int(np.floor(min(high, width - 1.0)))
            for column in range(left, right + 1):
                pixel = row * width + column
                if filling:
                    listed[begin[pixel]] = e
                begin[pixel] += 1


@_compiled
def _triangles_of_pixels(triangles, wanted, first, last, begin, listed):
    """The same for the triangles that touch the wanted pixels of rows first to last."""
    width = wanted.shape[1]
    filling = listed.shape[0] > 0
    for t in range(triangles.label.shape[0]):
        p = triangles.corners[t]
        top = int(np.floor(max(min(p[0, 1], p[1, 1], p[2, 1]), first + 0.0)))
        bottom = int(np.floor(min(max(p[0, 1], p[1, 1], p[2, 1]), last - 1.0)))
        for row in range(top, bottom + 1):
            low, high = np.inf, -np.inf
            for k in range(3):
                a, b = p[k], p[(k + 1) % 3]
                left, right = _span(a[0], a[1], b[0], b[1], row)
                low, high = min(low, left), max(high, right)
            if low > high:
                continue
            for column in range(
                int(np.floor(max(low, 0.0))), int(np.floor(min(high, width - 1.0))) + 1
            ):
                if wanted[row, column]:
                    pixel = (row - first) * width + column
                    if filling:
                        listed[begin[pixel]] = t
                    begin[pixel] += 1


@_compiled
def _seen_at(x, y, triangles, candidates, lens, centre, radius, rim):
    """Label of the nearest surface at one point of the screen. In the pixels that they cross, the
    edges ``rim`` (n, 4) of the light's outline say where it is: the sphere lies up to thousandths
    of a pixel beside them, enough to take a narrow cell for its neighbour."""
    best, found = 1.0 / lens.far, BACKGROUND
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
            best, found = q, triangles.label[t]
    for x0, y0, x1, y1 in rim:
        # The polygon is convex: within the pixel, those of its edges that cross it bound it.
        if (x1 - x0) * (y - y0) < (y1 - y0) * (x - x0):
            return found
    depth = _sphere_depth(x, y, lens, centre, radius, rim.shape[0] > 0)
    if depth > 0 and depth * best < 1.0:
        found = LIGHT
    return found


@_compiled
def _clip_to_pixel(u0, v0, u1, v1):
    """Parameters of the part of a segment inside the unit square (Liang & Barsky, ACM Trans.
    Graph. 3 (1984), 1); the first is larger if there is none."""
    low, high = 0.0, 1.0
    for start, step in ((u0, u1 - u0), (v0, v1 - v0)):
        if step == 0:
            if start < 0 or start > 1:
                return 1.0, 0.0
        else:
            a, b = -start / step, (1 - start) / step
            low, high = max(low, min(a, b)), min(high, max(a, b))
    return low, high


@_compiled
def _sweep_rows(
    triangles, edges, colour_of, labels, wanted, crossing, lens, centre, radius,
    first, last, edge_begin, edge_list, share, weight,
):  # fmt: skip
    """Fill ``share`` (h, w, colours) and ``weight`` (of every entry of the edge list, colours, 4)
    for rows first to last."""
    width = labels.shape[1]
    begin = np.zeros((last - first) * width + 1, np.int64)
    _triangles_of_pixels(triangles, wanted, first, last, begin, np.empty(0, np.int32))
    total, most = 0, 0
    for pixel in range(begin.shape[0]):
        count = begin[pixel]
        begin[pixel] = total
        total += count
    tri_list = np.empty(total + 1, np.int32)
    fill = begin.copy()
    _triangles_of_pixels(triangles, wanted, first, last, fill, tri_list)
    for pixel in range(first * width, last * width):
        most = max(most, edge_begin[pixel + 1] - edge_begin[pixel])
    # Per edge in the pixel: Y and u of both clipped ends, parameters of these.
    part = np.empty((most + 1, 6))
    slot = np.empty(most + 1, np.int64)
    around = np.empty((most + 1, 4))
    events = np.empty(4 + EVEN_STEPS + 2 * (most + 1) + MANY_EDGES * MANY_EDGES)
    active = np.empty(most + 1, np.int64)
    at = np.empty(most + 2)
    for row in range(first, last):
        for column in range(width):
            pixel = row * width + column
            if not wanted[row, column]:
                share[row, column, colour_of[labels[row, column]]] = 1.0
                continue
            local = pixel - first * width
            candidates = tri_list[begin[local] : begin[local + 1]]
            m, of_light = 0, 0
            for entry in range(edge_begin[pixel], edge_begin[pixel + 1]):
                edge = edge_list[entry]
                x0, y0, x1, y1 = edges.ends[edge]
                if edges.of_light[edge]:
                    around[of_light] = edges.ends[edge]
                    of_light += 1
                u0, v0, u1, v1 = x0 - column, y0 - row, x1 - column, y1 - row
                t0, t1 = _clip_to_pixel(u0, v0, u1, v1)
                if t0 >= t1:
                    continue
                ua, ub = u0 + t0 * (u1 - u0), u0 + t1 * (u1 - u0)
                ya = v0 + t0 * (v1 - v0) + SHEAR * ua
                yb = v0 + t1 * (v1 - v0) + SHEAR * ub
                if ya > yb:
                    ua, ya, t0, ub, yb, t1 = ub, yb, t1, ua, ya, t0
                if yb - ya <= NARROW:
                    continue
                part[m, 0], part[m, 1], part[m, 2] = ya, ua, t0
                part[m, 3], part[m, 4], part[m, 5] = yb, ub, t1
                slot[m] = entry
                m += 1
            rim = around[:of_light]
            if m == 0 and not crossing:
                # No contour passes: the pixel has the colour of its centre.
                share[row, column, colour_of[labels[row, column]]] = 1.0
                continue
            events[0], events[1], events[2], events[3] = 0.0, SHEAR, 1.0, 1.0 + SHEAR
            n = 4
            for i in range(m):
                events[n], events[n + 1] = part[i, 0], part[i, 3]
                n += 2
            if m > MANY_EDGES or crossing:
                for i in range(1, EVEN_STEPS):
                    events[n] = (1.0 + SHEAR) * i / EVEN_STEPS
                    n += 1
            if m <= MANY_EDGES:
                for i in range(m):
                    slope_i = (part[i, 4] - part[i, 1]) / (part[i, 3] - part[i, 0])
                    for j in range(i):
                        low, high = max(part[i, 0], part[j, 0]), min(part[i, 3], part[j, 3])
                        if low >= high:
                            continue
                        slope_j = (part[j, 4] - part[j, 1]) / (part[j, 3] - part[j, 0])
                        apart = part[j, 1] - part[i, 1] + slope_j * (low - part[j, 0])
                        apart -= slope_i * (low - part[i, 0])
                        turn = slope_i - slope_j
                        if turn != 0:
                            y = low + apart / turn
                            if low < y < high:
                                events[n] = y
                                n += 1
            ordered = np.sort(events[:n])
            for k in range(n - 1):
                step = ordered[k + 1] - ordered[k]
                if step <= NARROW:
                    continue
                y = 0.5 * (ordered[k] + ordered[k + 1])
                left, right = max(0.0, (y - 1.0) / SHEAR), min(1.0, y / SHEAR)
                a = 0
                for i in range(m):
                    if part[i, 0] <= y <= part[i, 3]:
                        go = (y - part[i, 0]) / (part[i, 3] - part[i, 0])
                        u = min(max(part[i, 1] + go * (part[i, 4] - part[i, 1]), left), right)
                        # Insertion sort: there are few.
                        j = a
                        while j > 0 and at[j - 1] > u:
                            at[j], active[j] = at[j - 1], active[j - 1]
                            j -= 1
                        at[j], active[j] = u, i
                        a += 1
                before, border = -1, left
                for j in range(a + 1):
                    end = at[j] if j < a else right
                    if end - border <= NARROW:
                        continue
                    u = 0.5 * (border + end)
                    if crossing:
                        colour, last_colour = _cross(
                            column, row, border, end, y, step, triangles, candidates, lens,
                            centre, radius, rim, colour_of, share[row, column],
                        )  # fmt: skip
                    else:
                        seen = _seen_at(
                            column + u, row + y - SHEAR * u, triangles, candidates, lens,
                            centre, radius, rim,
                        )  # fmt: skip
                        colour = colour_of[seen]
                        last_colour = colour
                        share[row, column, colour] += step * (end - border)
                    if before >= 0 and colour != before:
                        # Of edges that lie on one another the last stands for all.
                        i = active[j - 1]
                        go = (y - part[i, 0]) / (part[i, 3] - part[i, 0])
                        t = part[i, 2] + go * (part[i, 5] - part[i, 2])
                        run = (part[i, 4] - part[i, 1]) / (part[i, 3] - part[i, 0]) * step
                        # u moves by du - (run/step) dY, with dY = dy + SHEAR du.
                        by_x, by_y = step - run * SHEAR, -run
                        for c, sign in ((before, 1.0), (colour, -1.0)):
                            w = weight[slot[i], c]
                            w[0] += sign * (1 - t) * by_x
                            w[1] += sign * (1 - t) * by_y
                            w[2] += sign * t * by_x
                            w[3] += sign * t * by_y
                    before, border = last_colour, end


@_compiled
def _cross(
    column, row, begin, end, y, step, triangles, candidates, lens, centre, radius, rim, colour_of,
    share,
):  # fmt: skip
    """A cell in which surfaces may pass through each other: its first and last colour, with the
    place where they change found by bisection."""
    # A little inside, where surfaces that meet at the border are told apart by more than rounding.
    inset = min(0.25 * (end - begin), 0.01)
    a, b = begin + inset, end - inset
    one = colour_of[
        _seen_at(
            column + a, row + y - SHEAR * a, triangles, candidates, lens, centre, radius, rim
        )
    ]  # fmt: skip
    other = colour_of[
        _seen_at(
            column + b, row + y - SHEAR * b, triangles, candidates, lens, centre, radius, rim
        )
    ]  # fmt: skip
    if one == other:
        share[one] += step * (end - begin)
        return one, other
    for _ in range(20):
        u = 0.5 * (a + b)
        here = _seen_at(
            column + u, row + y - SHEAR * u, triangles, candidates, lens, centre, radius, rim
        )
        if colour_of[here] == one:
            a = u
        else:
            b = u
    share[one] += step * (0.5 * (a + b) - begin)
    share[other] += step * (end - 0.5 * (a + b))
    return one, other


@_compiled
def _minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@_compiled
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@_compiled
def _cross_product(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@_compiled
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


@_compiled
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


def contours(
    triangles: Triangles,
    edges: Edges,
    labels: np.ndarray,
    colour_of: np.ndarray,
    colours: int,
    lens: Lens,
    centre: np.ndarray,
    radius: float,
    crossing: bool,
) -> Contours:
    """Exact shares of the colours in every pixel, and how they follow the contours.

    ``labels`` (h, w) is what ``label`` gave, ``colour_of`` (labels,) the colour of each.
    ``crossing`` says that surfaces of different colours may pass through each other.
    """
    height, width = labels.shape
    begin = np.zeros(height * width + 1, np.int64)
    _edges_of_pixels(edges.ends, height, width, begin[1:], np.empty(0, np.int32))
    np.cumsum(begin, out=begin)
    listed = np.empty(begin[-1] + 1, np.int32)
    _edges_of_pixels(edges.ends, height, width, begin[:-1].copy(), listed)
    wanted = (np.diff(begin) > 0).reshape(height, width)
    if crossing:
        wanted |= _changes(colour_of[labels])
    share = np.zeros((height, width, colours), np.float64)
    weight = np.zeros((len(listed), colours, 4))
    share_rows(
        height,
        lambda a, b: _sweep_rows(
            triangles, edges, colour_of, labels, wanted, crossing, lens, centre, radius,
            a, b, begin, listed, share, weight,
        ),
    )  # fmt: skip
    shown = np.flatnonzero(np.abs(weight).max((1, 2), initial=0))
    pixel = np.repeat(np.arange(height * width), np.diff(begin))
    return Contours(share, pixel[shown], listed[shown], weight[shown])


def _changes(colour: np.ndarray) -> np.ndarray:
    """(h, w) True where one of the eight neighbours has another colour."""
    padded = np.pad(colour, 1, mode="edge")
    h, w = colour.shape
    found = np.zeros(colour.shape, bool)
    for i in range(3):
        for j in range(3):
            found |= padded[i : i + h, j : j + w] != colour
    return found

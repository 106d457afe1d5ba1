"""Where one colour gives way to another: exact shares of every pixel, compiled.

Colours are constant over an object, so a mask changes only across contours: silhouette edges,
boundary edges, cuts by the near plane, the outline of the light, and the lines in which surfaces
pass through each other. In a pixel that a contour crosses, lines sweep over it, the edges divide
them into cells, one ray says which colour a cell has, and between two events (an edge's end, a
crossing of two edges, a corner of the pixel) cells are trapezoids, so that areas are exact. Where
two neighbouring cells differ in colour, the edge between them is visible, and the areas change with
its ends as the end points of a trapezoid's side move. Coordinates are those of ``projection.py``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from godfit.runtime.numba_jit import jit
from godfit.scenes.intersections import FIELDS, Crossed, find_lines, pieces
from godfit.scenes.projection import Edges, Lens, Triangles
from godfit.scenes.visibility import seen_at, share_rows

# Lines of the sweep are not level: y + SHEAR x is constant along them, so that the edges people
# draw, upright and level ones, are never parallel to a line.
SHEAR = 0.3719
# More edges than this in one pixel are swept by so many even steps, without their crossings.
MANY_EDGES = 64
EVEN_STEPS = 32
# Cells narrower than this share of a pixel are nobody's.
NARROW = 1e-10
# Where colours change inside a cell.
HALVINGS = 20


class Contours(NamedTuple):
    """Shares (h, w, colours) of every pixel, and how they follow the edges: fragment f adds
    ``weight[f, c] @ (dx0, dy0, dx1, dy1)`` to colour c's share of ``pixel[f]`` when the ends of
    edge ``edge[f]`` move by so many pixels; and how they follow the lines of ``crossed``."""

    share: np.ndarray
    pixel: np.ndarray
    edge: np.ndarray
    weight: np.ndarray
    crossed: Crossed


@jit
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


@jit
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


@jit
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


@jit
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


@jit
def _sweep_rows(
    triangles, edges, colour_of, labels, wanted, crossing, lens, centre, radius,
    first, last, edge_begin, edge_list, share, weight,
):  # fmt: skip
    """Fill ``share`` (h, w, colours) and ``weight`` (of every entry of the edge list, colours, 4)
    for rows first to last; returns the lines of intersection that ``find_lines`` finds."""
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
    crossed, lines = np.empty((64, FIELDS)), 0
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
                        colour, last_colour, place = _cross(
                            column, row, border, end, y, triangles, candidates, lens, centre,
                            radius, rim, colour_of,
                        )  # fmt: skip
                        share[row, column, colour] += step * (place - border)
                        share[row, column, last_colour] += step * (end - place)
                    else:
                        label, _ = seen_at(
                            column + u, row + y - SHEAR * u, triangles, candidates, lens,
                            centre, radius, rim,
                        )  # fmt: skip
                        colour = colour_of[label]
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
            if crossing and share[row, column].max() < 1 - NARROW:
                crossed, lines = find_lines(
                    column, row, triangles, candidates, lens, centre, radius, rim, colour_of,
                    crossed, lines,
                )  # fmt: skip
    return crossed[:lines]


@jit
def _cross(column, row, begin, end, y, triangles, candidates, lens, centre, radius, rim, colour_of):
    """A cell in which surfaces may pass through each other: its first and last colour, and the u
    at which they change, found by bisection."""

    def seen(u):
        label, _ = seen_at(
            column + u, row + y - SHEAR * u, triangles, candidates, lens, centre, radius, rim
        )
        return colour_of[label]

    # A little inside, where surfaces that meet at the border are told apart by more than rounding.
    inset = min(0.25 * (end - begin), 1e-5)
    a, b = begin + inset, end - inset
    one, other = seen(a), seen(b)
    if one == other:
        return one, other, end
    for _ in range(HALVINGS):
        u = 0.5 * (a + b)
        if seen(u) == one:
            a = u
        else:
            b = u
    return one, other, 0.5 * (a + b)


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
    lines = share_rows(
        height,
        lambda a, b: _sweep_rows(
            triangles, edges, colour_of, labels, wanted, crossing, lens, centre, radius,
            a, b, begin, listed, share, weight,
        ),
    )  # fmt: skip
    shown = np.flatnonzero(np.abs(weight).max((1, 2), initial=0))
    pixel = np.repeat(np.arange(height * width), np.diff(begin))
    crossed = pieces(np.concatenate(lines), width)
    return Contours(share, pixel[shown], listed[shown], weight[shown], crossed)


def _changes(colour: np.ndarray) -> np.ndarray:
    """(h, w) True where one of the eight neighbours has another colour."""
    padded = np.pad(colour, 1, mode="edge")
    h, w = colour.shape
    found = np.zeros(colour.shape, bool)
    for i in range(3):
        for j in range(3):
            found |= padded[i : i + h, j : j + w] != colour
    return found

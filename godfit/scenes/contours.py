"""Exact share of every colour in every pixel, and its motion with the contours. Compiled.

Colours are constant over an object, so a mask changes only across contours: silhouette edges,
boundary edges, cuts by the near plane, the outline of the light, and the lines in which surfaces
pass through each other. In a pixel that a contour crosses, a sweep line moves over the pixel, and
the edges divide the line into cells. One ray gives the colour of a cell. Between two events (an
edge's end, a crossing of two edges, a corner of the pixel) cells are trapezoids, so areas are
exact. Where two neighbouring cells differ in colour, the edge between them is visible, and the
areas change with its ends as a trapezoid's area does. Coordinates are those of ``projection.py``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from godfit.runtime.numba_jit import jit
from godfit.scenes.intersections import LINE_FIELDS, Crossings, find_lines, named_crossings
from godfit.scenes.pixel_lists import PixelLists, edge_lists, triangle_lists
from godfit.scenes.projection import Edges, ProjectedScene
from godfit.scenes.visibility import Pixel, map_row_bands, surface_at

SHEAR = 0.3719
"""Slope of the sweep lines: Y = y + SHEAR x is constant along a line. Upright and level edges,
which are the most frequent, are therefore never parallel to a line."""
MAX_CROSSED_EDGES = 64
"""Edges in a pixel whose crossings with each other become events. A pixel with more edges is swept
in EVEN_STEPS instead: the number of crossings grows with the square."""
EVEN_STEPS = 32
"""Even steps of the sweep in a pixel with too many edges, or with lines of intersection."""
NARROW_CELL = 1e-10
"""Pixels; a narrower cell or step has no colour of its own: its middle is known to rounding."""
CELL_BISECTIONS = 20
"""Bisections for the place where the colour changes inside a cell: 2^-20 of a pixel."""
CELL_INSET = 1e-5
"""Pixels (at most a quarter of the cell) between a cell's border and the rays at its ends. Surfaces
that meet at the border differ there by more than rounding."""
FIRST_LINES = 64
"""Rows that the list of intersection lines has room for at first; it grows."""


class Contours(NamedTuple):
    """Shares (h, w, colours) of every pixel, and their motion with the edges.

    Fragment f adds ``weight[f, c] @ (dx0, dy0, dx1, dy1)`` to colour c's share of ``pixel[f]`` when
    the ends of edge ``edge[f]`` move by so many pixels. ``crossings`` are the lines of
    intersection, which move the shares as well.
    """

    share: np.ndarray
    pixel: np.ndarray
    edge: np.ndarray
    weight: np.ndarray
    crossings: Crossings


class _Sweep(NamedTuple):
    """Input of the sweep: the surfaces; the edges, and their numbers by pixel; the labels (h, w) at
    the pixel centres, and the colour of each label (labels,); the pixels (h, w) that are swept; and
    whether surfaces may pass through each other."""

    scene: ProjectedScene
    edges: Edges
    edge_lists: PixelLists
    labels: np.ndarray
    colour_of: np.ndarray
    swept: np.ndarray
    crossing: bool


class _Workspace(NamedTuple):
    """Arrays for the edges of one pixel.

    Row i of ``part`` (n, 6) is edge i clipped to the pixel: Y, u and the parameter along the edge
    of its lower end, then of its upper end. ``entry`` (n,) is its place in the edge list. ``rim``
    (n, 4) holds the edges of the light's outline. ``events`` are values of Y. ``on_line`` and ``u``
    are the edges that a sweep line crosses, sorted, and the places where it crosses them.
    """

    part: np.ndarray
    entry: np.ndarray
    rim: np.ndarray
    events: np.ndarray
    on_line: np.ndarray
    u: np.ndarray


@jit
def _workspace(most):
    """Room for ``most`` edges in a pixel."""
    events = 4 + EVEN_STEPS + 2 * (most + 1) + MAX_CROSSED_EDGES * MAX_CROSSED_EDGES
    return _Workspace(
        np.empty((most + 1, 6)),
        np.empty(most + 1, np.int64),
        np.empty((most + 1, 4)),
        np.empty(events),
        np.empty(most + 1, np.int64),
        np.empty(most + 2),
    )


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
def _clip_edges(edges, lists, row, column, width, work):
    """Clip the edges of a pixel into ``work``; returns the number of edges, and that of the edges
    of the light's outline."""
    part, pixel = work.part, row * width + column
    count, of_light = 0, 0
    for entry in range(lists.begin[pixel], lists.begin[pixel + 1]):
        edge = lists.items[entry]
        x0, y0, x1, y1 = edges.ends[edge]
        if edges.of_light[edge]:
            work.rim[of_light] = edges.ends[edge]
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
        if yb - ya <= NARROW_CELL:
            continue
        part[count, 0], part[count, 1], part[count, 2] = ya, ua, t0
        part[count, 3], part[count, 4], part[count, 5] = yb, ub, t1
        work.entry[count] = entry
        count += 1
    return count, of_light


@jit
def _list_events(part, count, crossing, events):
    """Fill ``events`` with the values of Y between which the cells of a pixel are trapezoids;
    returns their number."""
    events[0], events[1], events[2], events[3] = 0.0, SHEAR, 1.0, 1.0 + SHEAR
    n = 4
    for i in range(count):
        events[n], events[n + 1] = part[i, 0], part[i, 3]
        n += 2
    if count > MAX_CROSSED_EDGES or crossing:
        for i in range(1, EVEN_STEPS):
            events[n] = (1.0 + SHEAR) * i / EVEN_STEPS
            n += 1
    if count > MAX_CROSSED_EDGES:
        return n
    for i in range(count):
        slope_i = (part[i, 4] - part[i, 1]) / (part[i, 3] - part[i, 0])
        for j in range(i):
            low, high = max(part[i, 0], part[j, 0]), min(part[i, 3], part[j, 3])
            if low >= high:
                continue
            slope_j = (part[j, 4] - part[j, 1]) / (part[j, 3] - part[j, 0])
            apart = part[j, 1] - part[i, 1] + slope_j * (low - part[j, 0])
            apart -= slope_i * (low - part[i, 0])
            difference = slope_i - slope_j
            if difference != 0:
                y = low + apart / difference
                if low < y < high:
                    events[n] = y
                    n += 1
    return n


@jit
def _cross_line(work, count, y, left, right):
    """Sort the edges that the sweep line Y = ``y`` crosses, between its ends ``left`` and
    ``right``, into ``work``; returns their number."""
    part, on_line, places = work.part, work.on_line, work.u
    n = 0
    for i in range(count):
        if part[i, 0] <= y <= part[i, 3]:
            go = (y - part[i, 0]) / (part[i, 3] - part[i, 0])
            u = min(max(part[i, 1] + go * (part[i, 4] - part[i, 1]), left), right)
            # Insertion sort: few edges cross a line.
            j = n
            while j > 0 and places[j - 1] > u:
                places[j], on_line[j] = places[j - 1], on_line[j - 1]
                j -= 1
            places[j], on_line[j] = u, i
            n += 1
    return n


@jit
def _colour_change(pixel, y, begin, end, scene, colour_of):
    """The first and last colour of a cell in which surfaces may pass through each other, and the u
    at which the colour changes, found by bisection."""

    def colour_at(u):
        label, _ = surface_at(pixel.column + u, pixel.row + y - SHEAR * u, pixel, scene)
        return colour_of[label]

    inset = min(0.25 * (end - begin), CELL_INSET)
    a, b = begin + inset, end - inset
    one, other = colour_at(a), colour_at(b)
    if one == other:
        return one, other, end
    for _ in range(CELL_BISECTIONS):
        u = 0.5 * (a + b)
        if colour_at(u) == one:
            a = u
        else:
            b = u
    return one, other, 0.5 * (a + b)


@jit
def _add_motion(weight, part, y, step, before, after):
    """Add to ``weight`` (colours, 4) the motion of a visible edge over a step of the sweep: the
    colour ``before`` it gains what the colour ``after`` it loses."""
    go = (y - part[0]) / (part[3] - part[0])
    t = part[2] + go * (part[5] - part[2])
    run = (part[4] - part[1]) / (part[3] - part[0]) * step
    # u moves by du - (run/step) dY, with dY = dy + SHEAR du.
    by_x, by_y = step - run * SHEAR, -run
    for colour, sign in ((before, 1.0), (after, -1.0)):
        w = weight[colour]
        w[0] += sign * (1 - t) * by_x
        w[1] += sign * (1 - t) * by_y
        w[2] += sign * t * by_x
        w[3] += sign * t * by_y


@jit
def _sweep_pixel(sweep, pixel, work, count, share, weight):
    """Add to ``share`` (colours,) of a pixel, and to ``weight`` of its ``count`` edges."""
    scene, colour_of, crossing = sweep.scene, sweep.colour_of, sweep.crossing
    column, row = pixel.column, pixel.row
    n = _list_events(work.part, count, crossing, work.events)
    ordered = np.sort(work.events[:n])
    for k in range(n - 1):
        step = ordered[k + 1] - ordered[k]
        if step <= NARROW_CELL:
            continue
        y = 0.5 * (ordered[k] + ordered[k + 1])
        left, right = max(0.0, (y - 1.0) / SHEAR), min(1.0, y / SHEAR)
        crossed = _cross_line(work, count, y, left, right)
        before, border = -1, left
        for j in range(crossed + 1):
            end = work.u[j] if j < crossed else right
            if end - border <= NARROW_CELL:
                continue
            u = 0.5 * (border + end)
            if crossing:
                colour, last_colour, place = _colour_change(pixel, y, border, end, scene, colour_of)
                share[colour] += step * (place - border)
                share[last_colour] += step * (end - place)
            else:
                label, _ = surface_at(column + u, row + y - SHEAR * u, pixel, scene)
                colour = colour_of[label]
                last_colour = colour
                share[colour] += step * (end - border)
            if before >= 0 and colour != before:
                # The last edge stands for all edges that lie on one another.
                i = work.on_line[j - 1]
                _add_motion(weight[work.entry[i]], work.part[i], y, step, before, colour)
            before, border = last_colour, end


@jit
def _sweep_rows(sweep, share, weight, first, last):
    """Fill ``share`` (h, w, colours), and ``weight`` (colours, 4) of every entry of the edge lists,
    for rows first to before last; returns the lines of intersection of ``find_lines``."""
    width = sweep.labels.shape[1]
    triangles_of = triangle_lists(sweep.scene.triangles, sweep.swept, first, last)
    edge_begin, most = sweep.edge_lists.begin, 0
    for index in range(first * width, last * width):
        most = max(most, edge_begin[index + 1] - edge_begin[index])
    work = _workspace(most)
    lines, line_count = np.empty((FIRST_LINES, LINE_FIELDS)), 0
    for row in range(first, last):
        for column in range(width):
            colours = share[row, column]
            if not sweep.swept[row, column]:
                colours[sweep.colour_of[sweep.labels[row, column]]] = 1.0
                continue
            count, of_light = _clip_edges(sweep.edges, sweep.edge_lists, row, column, width, work)
            if count == 0 and not sweep.crossing:
                # No contour passes: the pixel has the colour of its centre.
                colours[sweep.colour_of[sweep.labels[row, column]]] = 1.0
                continue
            local = (row - first) * width + column
            begin, end = triangles_of.begin[local], triangles_of.begin[local + 1]
            candidates = triangles_of.items[begin:end]
            pixel = Pixel(column, row, candidates, work.rim[:of_light])
            _sweep_pixel(sweep, pixel, work, count, colours, weight)
            if sweep.crossing and colours.max() < 1 - NARROW_CELL:
                lines, line_count = find_lines(
                    pixel, sweep.scene, sweep.colour_of, lines, line_count
                )
    return lines[:line_count]


def contours(
    scene: ProjectedScene,
    edges: Edges,
    labels: np.ndarray,
    colour_of: np.ndarray,
    crossing: bool,
) -> Contours:
    """Exact shares of the colours in every pixel, and their motion with the contours.

    ``labels`` (h, w) are those of ``label_pixels``; ``colour_of`` (labels,) is the number of each
    label's colour, from 0. With ``crossing`` surfaces of different colours may pass through each
    other.
    """
    height, width = labels.shape
    colours = int(colour_of.max()) + 1
    lists = edge_lists(edges.ends, height, width)
    swept = (np.diff(lists.begin) > 0).reshape(height, width)
    if crossing:
        swept |= _beside_other_colour(colour_of[labels])
    sweep = _Sweep(scene, edges, lists, labels, colour_of, swept, crossing)
    share = np.zeros((height, width, colours), np.float64)
    weight = np.zeros((len(lists.items), colours, 4))
    lines = map_row_bands(
        height, lambda first, last: _sweep_rows(sweep, share, weight, first, last)
    )
    visible = np.flatnonzero(np.abs(weight).max((1, 2), initial=0))
    pixel = np.repeat(np.arange(height * width), np.diff(lists.begin))
    crossings = named_crossings(np.concatenate(lines), width)
    return Contours(share, pixel[visible], lists.items[visible], weight[visible], crossings)


def _beside_other_colour(colour: np.ndarray) -> np.ndarray:
    """(h, w) True where one of the eight neighbours has another colour."""
    padded = np.pad(colour, 1, mode="edge")
    h, w = colour.shape
    differs = np.zeros(colour.shape, bool)
    for i in range(3):
        for j in range(3):
            differs |= padded[i : i + h, j : j + w] != colour
    return differs

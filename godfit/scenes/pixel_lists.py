"""Lists, for every pixel, of the edges and the triangles that cross it. Compiled.

A list is made in two passes: the first counts, the second fills. Coordinates are those of
``projection.py``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from godfit.runtime.numba_jit import jit


class PixelLists(NamedTuple):
    """A list for each pixel, row by row: that of pixel p is ``items[begin[p] : begin[p + 1]]``.
    ``items`` has a spare entry at its end."""

    begin: np.ndarray
    items: np.ndarray


@jit
def _span(x0, y0, x1, y1, row):
    """Least and greatest x of a segment within [row, row + 1]; least > greatest if none of it
    is."""
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
def _list_edges(ends, height, width, begin, items):
    """List the edges that cross each pixel. The first call, with ``items`` empty, counts: it adds
    to ``begin`` (h w,). The second call takes each pixel's start from ``begin`` and fills
    ``items``."""
    filling = items.shape[0] > 0
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
                    items[begin[pixel]] = e
                begin[pixel] += 1


@jit
def _list_triangles(triangles, swept, first, last, begin, items):
    """List the triangles that touch the swept pixels of rows first to before last, as
    ``_list_edges`` does."""
    width = swept.shape[1]
    filling = items.shape[0] > 0
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
                if swept[row, column]:
                    pixel = (row - first) * width + column
                    if filling:
                        items[begin[pixel]] = t
                    begin[pixel] += 1


@jit
def triangle_lists(triangles, swept, first, last):
    """The triangles that touch each pixel of rows first to before last, of those that are True in
    ``swept`` (h, w)."""
    begin = np.zeros((last - first) * swept.shape[1] + 1, np.int64)
    _list_triangles(triangles, swept, first, last, begin, np.empty(0, np.int32))
    total = 0
    for pixel in range(begin.shape[0]):
        count = begin[pixel]
        begin[pixel] = total
        total += count
    items = np.empty(total + 1, np.int32)
    _list_triangles(triangles, swept, first, last, begin.copy(), items)
    return PixelLists(begin, items)


def edge_lists(ends: np.ndarray, height: int, width: int) -> PixelLists:
    """The edges ``ends`` (n, 4), as x0, y0, x1, y1, that cross each pixel."""
    begin = np.zeros(height * width + 1, np.int64)
    _list_edges(ends, height, width, begin[1:], np.empty(0, np.int32))
    np.cumsum(begin, out=begin)
    items = np.empty(begin[-1] + 1, np.int32)
    _list_edges(ends, height, width, begin[:-1].copy(), items)
    return PixelLists(begin, items)

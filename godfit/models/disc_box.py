"""The part of a disc light's mask that the disc changes: a box of texels around the light,
compiled.

A texel of the box holds the disc's part of the mask, and its derivatives by the light's place (u,
v), radius, edge and veil.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from godfit.models.disc_mask import DISTANCE_SOFTENING
from godfit.runtime.numba_jit import fast_jit

TEXEL_NUMBERS = 8
"""Numbers of a texel: the disc's part, five derivatives, and two that fill a vector register."""
BOX_MARGIN = 1.5
"""Texels; more than the distance of the four texels that a tap mixes."""


class DiscNumbers(NamedTuple):
    """The light in pixels of the mask, and the taps' ratio, step and lag (``derivatives.Numbers``);
    the disc's radius and edge, in heights of the mask, and the veil; the least width of the edge in
    derivatives, in texels; and the parts a side that a texel is cut into."""

    light_x: float
    light_y: float
    ratio: float
    step: float
    lag: float
    radius: float
    edge: float
    veil: float
    soft: float
    cut: int


class Box(NamedTuple):
    """Texels in the box, ``rows`` by ``columns`` with a border of one texel, as a flat array; the
    first row and column inside the border, ``top`` and ``left``; and the last row and column of the
    mask."""

    texels: np.ndarray
    top: int
    left: int
    rows: int
    columns: int
    last_row: float
    last_column: float


class _Edge(NamedTuple):
    """A disc's edge, in texels: radius, width, the number of widths after which it ends, and the
    softening of squared distances."""

    radius: float
    width: float
    tail: float
    softening: float


@fast_jit
def _covered(x, y, edge, cut):
    """The share of the texel at ``x``, ``y`` from the light that the disc covers, in texels."""
    total = 0.0
    for part in range(cut * cut):
        dx = x + (part % cut + 0.5) / cut - 0.5
        dy = y + (part // cut + 0.5) / cut - 0.5
        inside = (edge.radius - math.sqrt(dx * dx + dy * dy + edge.softening)) / edge.width
        if inside >= edge.tail:
            total += 1.0
        elif inside > -edge.tail:
            total += 1 / (1 + math.exp(-inside))
    return total / (cut * cut)


@fast_jit
def edge_distances(disc, height, soft, tail):
    """The least and greatest distance from the light, in texels, of the disc's edge, which ends
    ``tail`` of its widths from the rim and is at least ``soft`` wide."""
    radius, wide = disc.radius * height, max(disc.edge * height, soft)
    # One more, for a texel's own width.
    return radius - tail * wide - 1, radius + tail * wide + 1


@fast_jit
def disc_box(open_, disc, reach, slopes):
    """The box of texels that the disc changes, and whether the open mask exceeds 1 at a texel that
    is nearer to the light than ``near``.

    ``reach`` is (near, far, tail): texels nearer than ``near`` are inside the disc and left out,
    none farther than ``far`` is changed, and the edge ends ``tail`` of its widths from the rim. The
    border of the box is 0, but repeats the texels beside it where the picture ends. With ``slopes``
    a texel has TEXEL_NUMBERS numbers, without one.
    """
    near, far, tail = reach
    h, w = open_.shape
    real = open_.dtype.type
    light_x, light_y = float(disc.light_x), float(disc.light_y)
    veil, soft = float(disc.veil), float(disc.soft)
    radius, edge = disc.radius * float(h), disc.edge * float(h)
    wide = max(edge, soft)
    softening = DISTANCE_SOFTENING * float(h) * float(h)
    hard_edge, soft_edge = (
        _Edge(radius, edge, tail, softening),
        _Edge(radius, wide, tail, softening),
    )
    top, bottom = max(math.floor(light_y - far), 0), min(math.ceil(light_y + far), h - 1)
    left, right = max(math.floor(light_x - far), 0), min(math.ceil(light_x + far), w - 1)
    rows, columns = max(bottom - top + 1, 0), max(right - left + 1, 0)
    box = np.zeros((rows + 2, columns + 2, TEXEL_NUMBERS if slopes else 1), open_.dtype)
    # Every tap that mixes texels nearer than this lies inside the disc.
    unread, over = max(near - 2 * BOX_MARGIN, 0.0), False
    for j in range(rows):
        y = top + j - light_y
        for i in range(columns):
            x = left + i - light_x
            square = x * x + y * y
            here = float(open_[top + j, left + i])
            over |= square < near * near and here > 1
            if square < unread * unread:
                continue
            if here == 0 or square > far * far:
                continue
            lit = here * (veil + (1 - veil) * _covered(x, y, hard_edge, disc.cut))
            texel = box[j + 1, i + 1]
            texel[0] = real(min(lit, 1.0) - veil * here)
            if not slopes:
                continue
            covered = _covered(x, y, soft_edge, 1)
            if here * (veil + (1 - veil) * covered) > 1:
                texel[5] = real(-here)
                continue
            texel[5] = real(-here * covered)
            if covered == 0 or covered == 1:
                continue
            # By radius, edge and place in heights. Rows run down, v runs up.
            by = here * (1 - veil) * covered * (1 - covered) / wide * h
            away = math.sqrt(square + softening)
            texel[1], texel[2] = real(by * x / away * w / h), real(-by * y / away)
            texel[3] = real(by)
            if edge >= soft:
                texel[4] = real(-by * (radius - away) / wide)
    for s in range(box.shape[2]):
        for i in range(1, columns + 1):
            if top == 0:
                box[0, i, s] = box[1, i, s]
            if bottom == h - 1:
                box[rows + 1, i, s] = box[rows, i, s]
        for j in range(rows + 2):
            if left == 0:
                box[j, 0, s] = box[j, 1, s]
            if right == w - 1:
                box[j, columns + 1, s] = box[j, columns, s]
    return Box(box.reshape(-1), top, left, rows + 2, columns + 2, h - 1.0, w - 1.0), over

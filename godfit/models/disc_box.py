"""What a disc light adds to the texels around it, and what changes it, compiled by numba.

``numbers`` (9,) are the five of ``godfit.scattering.radial.derivatives.Numbers``; the disc's radius and edge, in
heights of the mask, and veil; and how wide its edge is in derivatives, at least, in texels.
"""

from __future__ import annotations

import math

import numpy as np

from godfit.runtime.numba_jit import fast

# Numbers of a texel: what the disc adds and what place (u, v), radius, edge and veil change of it,
# in whole vectors.
EACH = 8
# Texels, more than the four lie away that a tap mixes.
AROUND = 1.5


@fast
def _disc(x, y, least, radius, wide, cut, tail):
    """How much of a texel ``x``, ``y`` from the light the disc covers; ``least`` is added to the
    square of a distance. Lengths are in texels."""
    total = 0.0
    for part in range(cut * cut):
        dx = x + (part % cut + 0.5) / cut - 0.5
        dy = y + (part // cut + 0.5) / cut - 0.5
        inside = (radius - math.sqrt(dx * dx + dy * dy + least)) / wide
        if inside >= tail:
            total += 1.0
        elif inside > -tail:
            total += 1 / (1 + math.exp(-inside))
    return total / (cut * cut)


@fast
def rim(numbers, height, soft, tail):
    """Distances from the light, in texels: nothing of the disc's edge, which ends ``tail`` of its
    widths away, lies nearer than the first or farther than the second; ``soft`` is how wide it is,
    at least."""
    radius, wide = numbers[5] * height, max(numbers[6] * height, soft)
    # And a texel is wide.
    return radius - tail * wide - 1, radius + tail * wide + 1


@fast
def box_of(open_, numbers, cut, slopes, near, far, tail):
    """The first row and column of what the disc reaches, and what it adds there but nearer to the
    light than ``near`` (rows + 2, columns + 2, 1 or EACH), in a border as it is beyond: 0, or where
    the picture ends what is there; and whether anything that is nearer is more than open."""
    h, w = open_.shape
    real = open_.dtype.type
    light_x, light_y = float(numbers[0]), float(numbers[1])
    veil, soft = float(numbers[7]), float(numbers[8])
    radius, edge = numbers[5] * float(h), numbers[6] * float(h)
    wide = max(edge, soft)
    # As ``disc_mask.from_light`` has it, whose square root has a slope everywhere.
    least = 1e-12 * float(h) * float(h)
    top, bottom = max(math.floor(light_y - far), 0), min(math.ceil(light_y + far), h - 1)
    left, right = max(math.floor(light_x - far), 0), min(math.ceil(light_x + far), w - 1)
    rows, columns = max(bottom - top + 1, 0), max(right - left + 1, 0)
    box = np.zeros((rows + 2, columns + 2, EACH if slopes else 1), open_.dtype)
    # What no tap reads that is not in all of the disc.
    unread, over = max(near - 2 * AROUND, 0.0), False
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
            lit = here * (veil + (1 - veil) * _disc(x, y, least, radius, edge, cut, tail))
            texel = box[j + 1, i + 1]
            texel[0] = real(min(lit, 1.0) - veil * here)
            if not slopes:
                continue
            disc = _disc(x, y, least, radius, wide, 1, tail)
            if here * (veil + (1 - veil) * disc) > 1:
                texel[5] = real(-here)
                continue
            texel[5] = real(-here * disc)
            if disc == 0 or disc == 1:
                continue
            # By the radius and the rest in heights; rows run down, v runs up.
            by = here * (1 - veil) * disc * (1 - disc) / wide * h
            away = math.sqrt(square + least)
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
    return top, left, box, over

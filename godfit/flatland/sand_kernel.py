"""One frame of falling sand, compiled by numba; see ``godfit.flatland.sand``."""

from __future__ import annotations

from godfit.runtime.numba_jit import jit

ACCELERATION = 0.4
"""Cells a frame, each frame."""

MAX_SPEED = 8.0
"""Cells a frame."""


@jit
def fall(cells, velocity, rightwards, chance):
    """Move the grains of ``cells`` (h, w) by one frame, in place, and with them their ``velocity``
    (h, w) in cells a frame.

    ``rightwards`` (h,) is which way a row is gone through. ``chance`` (h, w), from 0 to 1, decides
    whether the grain of that cell goes one cell farther for the fraction of its velocity.
    """
    h, w = cells.shape
    for row in range(h - 1, -1, -1):
        for i in range(w):
            column = i if rightwards[row] else w - 1 - i
            if cells[row, column] <= 0:
                continue
            speed = min(velocity[row, column] + ACCELERATION, MAX_SPEED)
            moves = int(speed)
            if chance[row, column] < speed - moves:
                moves += 1
            y, x = row, column
            for _ in range(moves):
                if y + 1 < h and cells[y + 1, x] == 0:
                    to = x
                elif y + 1 < h and x > 0 and cells[y + 1, x - 1] == 0:
                    to = x - 1
                elif y + 1 < h and x + 1 < w and cells[y + 1, x + 1] == 0:
                    to = x + 1
                else:
                    speed = 0.0
                    break
                cells[y + 1, to], cells[y, x] = cells[y, x], 0
                velocity[y, x] = 0.0
                y, x = y + 1, to
            velocity[y, x] = speed

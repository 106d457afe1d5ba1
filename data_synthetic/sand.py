"""Falling sand: a cellular automaton that loses and creates no grain.

Cells are EMPTY, SOLID or a grain, whose number (from GRAIN on) is its colour and goes with it. In
every step the plane is cut into blocks of two by two, each step at another offset (Margolus'
neighbourhood; Toffoli & Margolus, Cellular Automata Machines, 1987, ch. 12), and grains move within
their block, so that none can be lost, doubled or moved by two: down, and where that is taken,
sideways down. All blocks move at once, in a few array operations. Which grains slide now and which
later is drawn from the seed, block by block.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

EMPTY, SOLID, GRAIN = 0, 1, 2
# Share of the grains that slide at once where they can.
LOOSE = 0.6
# The four offsets of the blocks, in an order that falls straight and does not drift.
OFFSETS = ((0, 0), (1, 1), (0, 1), (1, 0))


def step(cells: np.ndarray, number: int, rng: np.random.Generator) -> np.ndarray:
    """(h, w) cells one step on; beyond the border all is solid."""
    h, w = cells.shape
    down, over = OFFSETS[number % len(OFFSETS)]
    # A frame of solid cells, and one more where a block would be cut.
    rows, columns = h + 2 + (h + down) % 2, w + 2 + (w + over) % 2
    framed = np.full((rows + down, columns + over), SOLID, cells.dtype)
    framed[1 + down : 1 + down + h, 1 + over : 1 + over + w] = cells
    framed = framed[: framed.shape[0] // 2 * 2, : framed.shape[1] // 2 * 2]
    # (upper, lower) x (left, right), one layer for each place in a block.
    place = [[framed[i::2, j::2].copy() for j in (0, 1)] for i in (0, 1)]
    for j in (0, 1):
        _swap(place, (0, j), (1, j), (place[0][j] >= GRAIN) & (place[1][j] == EMPTY))
    # Not every grain that could slide does so at once: heaps would be all alike.
    loose = rng.random(place[0][0].shape) < LOOSE
    for j in (0, 1):
        # Down on its own side is taken now; the way leads through the cell beside it.
        free = (place[0][1 - j] == EMPTY) & (place[1][1 - j] == EMPTY)
        _swap(place, (0, j), (1, 1 - j), (place[0][j] >= GRAIN) & free & loose)
    for i in (0, 1):
        for j in (0, 1):
            framed[i::2, j::2] = place[i][j]
    return framed[1 + down : 1 + down + h, 1 + over : 1 + over + w].copy()


def _swap(place, a, b, where) -> None:
    one, other = place[a[0]][a[1]], place[b[0]][b[1]]
    one[where], other[where] = other[where], one[where]


def frames(cells: np.ndarray, count: int, every: int, seed: int) -> Iterator[np.ndarray]:
    """``count`` states, the first as given, ``every`` steps apart."""
    rng, number = np.random.default_rng(seed), 0
    for frame in range(count):
        if frame:
            for _ in range(every):
                cells = step(cells, number, rng)
                number += 1
        yield cells


def grains(cells: np.ndarray) -> dict[int, int]:
    """How many grains of each colour there are."""
    numbers, counts = np.unique(cells[cells >= GRAIN], return_counts=True)
    return {int(n): int(c) for n, c in zip(numbers, counts, strict=True)}


def hourglass(size: int, seed: int) -> np.ndarray:
    """(size, size) a funnel full of grains of three colours above ledges that catch some."""
    y, x = np.mgrid[:size, :size] / size
    rng = np.random.default_rng(seed)
    cells = np.full((size, size), EMPTY, np.int8)
    slope = np.abs(x - 0.5) - (0.035 + 0.9 * np.maximum(0.42 - y, 0))
    cells[(np.abs(slope) < 0.02) & (y > 0.12) & (y < 0.45)] = SOLID
    for at, left, right in ((0.62, 0.3, 0.52), (0.76, 0.5, 0.74)):
        cells[(np.abs(y - at - 0.25 * (x - left)) < 0.012) & (x > left) & (x < right)] = SOLID
    full = (slope < -0.02) & (y > 0.15) & (y < 0.4) & (rng.random((size, size)) < 0.9)
    colour = GRAIN + ((y - 0.15) / 0.25 * 3).astype(np.int8).clip(0, 2)
    cells[full] = colour[full]
    return cells

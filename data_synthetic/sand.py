"""Falling sand: a cellular automaton that loses and creates no grain.

Cells are EMPTY_CELL, SOLID_CELL or a grain, whose number (from FIRST_GRAIN on) is its colour and
moves with it. In every step the plane is cut into blocks of two by two, each step at another offset
(Margolus' neighbourhood; Toffoli & Margolus, Cellular Automata Machines, 1987, ch. 12). Grains move
within their block, so that none can be lost, doubled or moved by two cells: down, and where the
cell below is taken, sideways down. All blocks move at once, in a few array operations. Which grains
slide now and which later is drawn from the seed, block by block.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

EMPTY_CELL = 0
"""A cell that a grain can move into."""

SOLID_CELL = 1
"""A cell that never changes."""

FIRST_GRAIN = 2
"""The first of the numbers of grains."""

SLIDING_SHARE = 0.6
"""Share of the grains that slide at once where they can: if all did, heaps would be all alike."""

BLOCK_OFFSETS = ((0, 0), (1, 1), (0, 1), (1, 0))
"""The four offsets of the blocks (down, right), in an order in which grains fall straight and do
not drift."""


def step(cells: np.ndarray, number: int, rng: np.random.Generator) -> np.ndarray:
    """(h, w) the cells after step ``number``; beyond the border all is solid."""
    h, w = cells.shape
    down, right = BLOCK_OFFSETS[number % len(BLOCK_OFFSETS)]
    # A frame of solid cells, and one more where a block would be cut.
    rows, columns = h + 2 + (h + down) % 2, w + 2 + (w + right) % 2
    framed = np.full((rows + down, columns + right), SOLID_CELL, cells.dtype)
    framed[1 + down : 1 + down + h, 1 + right : 1 + right + w] = cells
    framed = framed[: framed.shape[0] // 2 * 2, : framed.shape[1] // 2 * 2]
    # (upper, lower) x (left, right), one layer for each cell of a block.
    block = [[framed[i::2, j::2].copy() for j in (0, 1)] for i in (0, 1)]
    for j in (0, 1):
        _swap(block, (0, j), (1, j), (block[0][j] >= FIRST_GRAIN) & (block[1][j] == EMPTY_CELL))
    sliding = rng.random(block[0][0].shape) < SLIDING_SHARE
    for j in (0, 1):
        # The cell below is taken now; the way down leads through the cell beside the grain.
        free = (block[0][1 - j] == EMPTY_CELL) & (block[1][1 - j] == EMPTY_CELL)
        _swap(block, (0, j), (1, 1 - j), (block[0][j] >= FIRST_GRAIN) & free & sliding)
    for i in (0, 1):
        for j in (0, 1):
            framed[i::2, j::2] = block[i][j]
    return framed[1 + down : 1 + down + h, 1 + right : 1 + right + w].copy()


def _swap(block, a: tuple[int, int], b: tuple[int, int], where: np.ndarray) -> None:
    """Exchange the cells ``a`` and ``b`` (row, column) of the blocks ``where``."""
    first, second = block[a[0]][a[1]], block[b[0]][b[1]]
    first[where], second[where] = second[where], first[where]


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
    """The number of grains of each colour."""
    numbers, counts = np.unique(cells[cells >= FIRST_GRAIN], return_counts=True)
    return {int(n): int(c) for n, c in zip(numbers, counts, strict=True)}


def hourglass(size: int, seed: int) -> np.ndarray:
    """(size, size) a funnel full of grains of three colours above ledges that catch some."""
    y, x = np.mgrid[:size, :size] / size
    rng = np.random.default_rng(seed)
    cells = np.full((size, size), EMPTY_CELL, np.int8)
    slope = np.abs(x - 0.5) - (0.035 + 0.9 * np.maximum(0.42 - y, 0))
    cells[(np.abs(slope) < 0.02) & (y > 0.12) & (y < 0.45)] = SOLID_CELL
    for height, left, right in ((0.62, 0.3, 0.52), (0.76, 0.5, 0.74)):
        ledge = np.abs(y - height - 0.25 * (x - left)) < 0.012
        cells[ledge & (x > left) & (x < right)] = SOLID_CELL
    full = (slope < -0.02) & (y > 0.15) & (y < 0.4) & (rng.random((size, size)) < 0.9)
    colour = FIRST_GRAIN + ((y - 0.15) / 0.25 * 3).astype(np.int8).clip(0, 2)
    cells[full] = colour[full]
    return cells

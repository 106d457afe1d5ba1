"""Falling sand on a canvas, by the rules of jason.today/gi (2024).

In every frame a grain gains .4 cells a frame of velocity, up to 8, and makes as many moves; for the
fraction it makes one more by chance. A move goes down, else down and left, else down and right. A
grain that cannot move loses its velocity. Rows are gone through from the bottom up, each in a
random direction. No grain is lost or made.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Int, Int32, UInt8

from godfit.errors import InputError
from godfit.flatland.painting import Stroke, check_size, varied
from godfit.flatland.sand_kernel import fall

PARTICLES = ("sand", "solid", "empty")
"""What a stroke on sand lays down."""


class Sand(NamedTuple):
    """``cells`` (h, w): 0 is empty, k a grain and -k a solid cell of colour k, which is row k - 1
    of ``colours`` (n, 3), bytes."""

    cells: Int32[np.ndarray, "h w"]
    colours: UInt8[np.ndarray, "n 3"]

    def rgba(self) -> UInt8[np.ndarray, "h w 4"]:
        """The canvas as bytes: grains and solid cells are opaque, in their colours."""
        out = np.zeros((*self.cells.shape, 4), np.uint8)
        drawn = self.cells != 0
        out[drawn, :3] = self.colours[np.abs(self.cells[drawn]) - 1]
        out[drawn, 3] = 255
        return out


def painted_sand(
    size: tuple[int, int], strokes: Sequence[tuple[Stroke, str]], seed: int = 0
) -> Sand:
    """Sand on a canvas of ``size`` (h, w): every stroke lays down one of ``PARTICLES``, each in a
    variation of its colour that ``seed`` chooses; a later stroke replaces an earlier one.

    The page's example is [(stroke, "sand"), (shadow, "solid")] of ``example_strokes()``. Raises
    InputError.
    """
    check_size(size)
    rng = np.random.default_rng(seed)
    cells = np.zeros(size, np.int32)
    colours, count = [np.zeros((0, 3), np.uint8)], 0
    for stroke, particle in strokes:
        if particle not in PARTICLES:
            raise InputError(f"particle: expected {', '.join(PARTICLES)}, got {particle!r}")
        rows, columns = np.nonzero(_covered(size, stroke))
        if particle == "empty":
            cells[rows, columns] = 0
            continue
        number = count + 1 + np.arange(len(rows), dtype=np.int32)
        cells[rows, columns] = number if particle == "sand" else -number
        colours.append(varied(stroke.rgb(), len(rows), rng))
        count += len(rows)
    return Sand(cells, np.concatenate(colours))


def falling_sand(
    cells: Int[np.ndarray, "h w"], frames: int, seed: int = 0, every: int = 1
) -> Iterator[Int32[np.ndarray, "h w"]]:
    """``frames`` states of ``cells`` (see ``Sand``), the first as given and at rest, ``every``
    frames of the sand apart. One seed is one sequence. Raises InputError."""
    if cells.ndim != 2 or cells.dtype.kind != "i":
        raise InputError(
            f"cells: expected (h, w) signed whole numbers, got {cells.dtype} {cells.shape}"
        )
    for name, value in (("frames", frames), ("every", every)):
        if value < 1:
            raise InputError(f"{name}: expected 1 or more, got {value}")
    return _states(cells.astype(np.int32), frames, seed, every)


def grain_counts(cells: Int[np.ndarray, "h w"]) -> dict[int, int]:
    """The number of grains of each colour that has any."""
    numbers, counts = np.unique(cells[cells > 0], return_counts=True)
    return {int(n): int(c) for n, c in zip(numbers, counts, strict=True)}


def _states(cells: np.ndarray, frames: int, seed: int, every: int) -> Iterator[np.ndarray]:
    rng = np.random.default_rng(seed)
    velocity = np.zeros(cells.shape)
    yield cells.copy()
    for _ in range(frames - 1):
        for _ in range(every):
            rightwards = rng.random(cells.shape[0]) > 0.5
            fall(cells, velocity, rightwards, rng.random(cells.shape))
        yield cells.copy()


def _covered(size: tuple[int, int], stroke: Stroke) -> np.ndarray:
    """(h, w) the cells that a stroke covers: discs about whole cells, about one a cell of the way
    along the longer axis."""
    h, w = size
    covered = np.zeros(size, bool)
    reach = int(stroke.radius)
    dy, dx = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disc = dx * dx + dy * dy <= stroke.radius**2
    for start, end in stroke.segments():
        steps = np.abs(end - start).max()
        for i in range(int(steps) + 1):
            at = start + (end - start) * (i / steps if steps > 0 else 0.0)
            x, y = np.floor(at + 0.5).astype(int)
            rows, columns = y + dy[disc], x + dx[disc]
            inside = (rows >= 0) & (rows < h) & (columns >= 0) & (columns < w)
            covered[rows[inside], columns[inside]] = True
    return covered

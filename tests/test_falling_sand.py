"""Falling sand: no grain is lost or made, and one seed is one sequence."""

import json

import numpy as np
import pytest

from tests.support.paths import DATA_SYNTHETIC
from tests.support.synthetic import canvases, sand


def run(cells, steps, seed=0):
    return list(sand.frames(cells, steps + 1, 1, seed))


def random_cells(shape, seed):
    rng = np.random.default_rng(seed)
    return rng.choice(np.int8([0, 0, 0, 1, 2, 3]), shape)


@pytest.mark.parametrize("shape", [(20, 30), (31, 17), (1, 9), (9, 1), (2, 2)])
def test_no_grain_is_lost_or_made(shape):
    start = random_cells(shape, 1)
    for cells in run(start, 60):
        assert sand.grains(cells) == sand.grains(start)
        np.testing.assert_array_equal(cells == sand.SOLID_CELL, start == sand.SOLID_CELL)


def test_one_seed_is_one_sequence():
    start = sand.hourglass(96, 5)
    one, same, other = (run(start, 80, seed) for seed in (7, 7, 8))
    np.testing.assert_array_equal(one, same)
    assert (one[-1] != other[-1]).any()
    np.testing.assert_array_equal(start, sand.hourglass(96, 5))


def test_a_grain_falls_straight_and_stops():
    start = np.zeros((12, 7), np.int8)
    start[0, 3] = 5
    places = [np.argwhere(cells == 5)[0] for cells in run(start, 60)]
    rows, columns = np.transpose(places)
    assert (columns == 3).all()
    assert (np.diff(rows) >= 0).all()
    assert np.diff(rows).max() == 1
    assert rows[-1] == 11


def test_solid_cells_hold_it():
    start = np.zeros((12, 9), np.int8)
    start[6, 2:7], start[0, 3:6] = sand.SOLID_CELL, 2
    end = run(start, 80)[-1]
    np.testing.assert_array_equal(np.argwhere(end == 2), [[5, 3], [5, 4], [5, 5]])


def test_a_column_becomes_a_heap():
    """Slopes of sand are at most about 45 degrees, and symmetric on the whole."""
    start = np.zeros((40, 61), np.int8)
    start[:36, 29:32] = 2
    end = run(start, 600)[-1]
    heights = (end == 2).sum(0)
    assert heights.max() <= 16
    assert np.abs(np.diff(heights)).max() <= 3
    assert abs(np.average(np.arange(61), weights=heights) - 30) < 1.5
    # At rest: what lies has something under it.
    lying = np.argwhere(end == 2)
    assert all(row == 39 or end[row + 1, column] != sand.EMPTY_CELL for row, column in lying)


def test_frames_are_the_manifest_s():
    states = canvases.sand_frames()
    manifest = json.loads((DATA_SYNTHETIC / "manifest.json").read_text())["canvases"]
    assert len(states) == canvases.SAND_FRAMES == sum("sand" in name for name in manifest)
    for i, cells in enumerate(states):
        truth = manifest[f"plane_sand_{i}"]
        assert truth["grains"] == {str(k): v for k, v in sand.grains(cells).items()}
        assert truth["seed"] == canvases.SAND_SEED
    assert all((a != b).any() for a, b in zip(states[1:], states, strict=False))

"""Falling sand: by the page's rules, without a grain lost or made, one seed one sequence."""

import json
import math

import numpy as np
import pytest

from godfit.errors import InputError
from godfit.flatland import Stroke, example_strokes, falling_sand, painted_sand
from godfit.flatland.sand import grain_counts
from godfit.flatland.sand_kernel import fall
from tests.support.paths import DATA_SYNTHETIC
from tests.support.synthetic import canvases


class Particle:
    """The page's class, its chance given."""

    def __init__(self, number, max_speed):
        self.number, self.max_speed = number, max_speed
        self.acceleration, self.velocity, self.modified = 0.4, 0, False

    def update(self):
        if self.max_speed == 0:
            self.modified = False
            return
        new = self.velocity + self.acceleration
        if abs(new) > self.max_speed:
            new = math.copysign(1, new) * self.max_speed
        self.velocity = new
        self.modified = self.velocity != 0

    def update_count(self, chance):
        whole = math.floor(abs(self.velocity))
        return whole + (1 if chance < abs(self.velocity) - whole else 0)


class Surface:
    """The page's grid of particles, numbered row by row from the top."""

    def __init__(self, cells):
        self.height, self.width = cells.shape
        self.grid = [None if n == 0 else Particle(int(n), 8 if n > 0 else 0) for n in cells.ravel()]

    def is_empty(self, i):
        return 0 <= i < len(self.grid) and self.grid[i] is None

    def update_sand(self, rightwards, chance):
        for row in range(self.height - 1, -1, -1):
            for i in range(self.width):
                index = row * self.width + (i if rightwards[row] else -i - 1 + self.width)
                particle, luck = self.grid[index], chance.ravel()[index]
                if particle is None:
                    continue
                particle.update()
                if not particle.modified:
                    continue
                v = 0
                while v < particle.update_count(luck):
                    to = self.update_pixel(index)
                    if to == index:
                        particle.velocity = 0
                        break
                    index, v = to, v + 1

    def update_pixel(self, i):
        below, column = i + self.width, i % self.width
        if self.is_empty(below):
            to = below
        elif self.is_empty(below - 1) and (below - 1) % self.width < column:
            to = below - 1
        elif self.is_empty(below + 1) and (below + 1) % self.width > column:
            to = below + 1
        else:
            return i
        self.grid[i], self.grid[to] = self.grid[to], self.grid[i]
        return to

    def cells(self):
        numbers = [0 if p is None else p.number for p in self.grid]
        return np.reshape(numbers, (self.height, self.width))


def random_cells(shape, seed):
    rng = np.random.default_rng(seed)
    return rng.choice(np.int32([0, 0, 0, -2, 1, 2, 3]), shape)


@pytest.mark.parametrize("shape", [(24, 15), (9, 30), (1, 6), (7, 1)])
def test_falls_as_on_the_page(shape):
    cells = random_cells(shape, 4)
    velocity, surface = np.zeros(shape), Surface(cells)
    rng = np.random.default_rng(1)
    for _ in range(40):
        rightwards, chance = rng.random(shape[0]) > 0.5, rng.random(shape)
        surface.update_sand(rightwards, chance)
        fall(cells, velocity, rightwards, chance)
        np.testing.assert_array_equal(cells, surface.cells())


def test_free_fall():
    """From the top of 300 rows: at most 8 rows a frame, on the floor after 46 to 48 frames."""
    cells = np.zeros((300, 3), np.int32)
    cells[0, 1] = 1
    for seed in range(5):
        places = np.array([np.argwhere(c)[0] for c in falling_sand(cells, 60, seed)])
        assert (places[:, 1] == 1).all()
        moved = np.diff(places[:, 0])
        assert moved.max() == 8
        assert moved.min() >= 0
        assert 46 <= np.argmax(places[:, 0] == 299) <= 48


@pytest.mark.parametrize("shape", [(20, 30), (31, 17), (1, 9), (9, 1), (2, 2)])
def test_no_grain_is_lost_or_made(shape):
    start = random_cells(shape, 1)
    for cells in falling_sand(start, 301):
        assert grain_counts(cells) == grain_counts(start)
        np.testing.assert_array_equal(np.minimum(cells, 0), np.minimum(start, 0))


def test_one_seed_is_one_sequence():
    start = canvases.hourglass(64).cells
    before = start.copy()
    one, same, other = (list(falling_sand(start, 60, seed)) for seed in (7, 7, 8))
    np.testing.assert_array_equal(one, same)
    assert (one[-1] != other[-1]).any()
    np.testing.assert_array_equal(start, before)
    np.testing.assert_array_equal(list(falling_sand(start, 12, 7, every=5)), one[::5])


def test_solid_cells_hold_it():
    start = np.zeros((12, 9), np.int32)
    start[6, 2:7], start[0, 3:6] = -1, 2
    *_, end = falling_sand(start, 80)
    np.testing.assert_array_equal(np.argwhere(end == 2), [[5, 3], [5, 4], [5, 5]])


def test_a_column_becomes_a_heap():
    """Slopes of sand are at most about 45 degrees."""
    start = np.zeros((40, 61), np.int32)
    start[:36, 29:32] = 2
    *_, end = falling_sand(start, 300)
    heights = (end == 2).sum(0)
    assert heights.max() <= 16
    assert np.abs(np.diff(heights)).max() <= 3
    # At rest: what lies has something under it.
    assert all(row == 39 or end[row + 1, column] != 0 for row, column in np.argwhere(end == 2))


def test_painted_sand():
    glowing, shadow = example_strokes()
    strokes = [(glowing, "sand"), (shadow, "solid")]
    sand = painted_sand((300, 300), strokes, seed=3)
    values = sand.rgba()
    np.testing.assert_array_equal(values[..., 3] == 255, sand.cells != 0)
    # Every grain has a colour of its own: no two numbers are alike.
    numbers = np.abs(sand.cells[sand.cells != 0])
    assert len(np.unique(numbers)) == len(numbers)
    assert np.count_nonzero(sand.cells > 0) > 1000
    assert np.count_nonzero(sand.cells < 0) > 1000
    assert len(np.unique(values[sand.cells > 0], axis=0)) > 100
    # Black is varied as well, to at most 4% of lightness.
    assert values[sand.cells < 0][:, :3].max() == 10
    np.testing.assert_array_equal(painted_sand((300, 300), strokes, seed=3).rgba(), values)
    assert (painted_sand((300, 300), strokes, seed=4).rgba() != values).any()


def test_painted_cells_are_the_page_s():
    """Discs about rounded points, steps of one cell along the longer axis; the last step may end
    short of the end."""
    points = np.array([[3.4, 5.0], [12.6, 9.1]])
    sand = painted_sand((20, 24), [(Stroke(points, "#f9a875", 3), "sand")])
    expected = np.zeros((20, 24), bool)
    (x0, y0), (x1, y1) = points
    for (ax, ay), (bx, by) in (((x0, y0), (x0, y0)), ((x0, y0), (x1, y1))):
        steps = max(abs(bx - ax), abs(by - ay))
        i = 0
        while i <= steps:
            t = 0 if steps == 0 else i / steps
            x, y = (math.floor(a + (b - a) * t + 0.5) for a, b in ((ax, bx), (ay, by)))
            for ry in range(-3, 4):
                for rx in range(-3, 4):
                    if rx * rx + ry * ry <= 9 and 0 <= x + rx < 24 and 0 <= y + ry < 20:
                        expected[y + ry, x + rx] = True
            i += 1
    np.testing.assert_array_equal(sand.cells > 0, expected)
    rubbed = painted_sand((20, 24), [(Stroke(points, "#f9a875", 3), "sand"),
                                     (Stroke(points[:1], "#000000", 2), "empty")])  # fmt: skip
    assert rubbed.cells[5, 3] == 0
    assert rubbed.cells[9, 12] > 0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: falling_sand(np.zeros((3, 3), np.int32), 0), "frames: expected 1 or more, got 0"),
        (lambda: falling_sand(np.zeros((3, 3), np.int32), 2, 0, 0), "every: expected 1 or more"),
        (
            lambda: painted_sand((9, 9), [(Stroke(np.zeros((1, 2)), "#000000"), "water")]),
            "particle: expected sand, solid, empty, got 'water'",
        ),
    ],
)
def test_nonsense_is_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_frames_are_the_manifest_s():
    states = canvases.sand_frames()
    manifest = json.loads((DATA_SYNTHETIC / "manifest.json").read_text())["canvases"]
    assert len(states) == canvases.SAND_FRAMES == sum("sand" in name for name in manifest)
    for i, cells in enumerate(states):
        truth = manifest[f"plane_sand_{i}"]
        assert truth["grains"] == {str(k): v for k, v in grain_counts(cells).items()}
        assert truth["seed"] == canvases.SAND_SEED
        assert truth["step"] == i * canvases.SAND_FRAME_STEPS
    assert all((a != b).any() for a, b in zip(states[1:], states, strict=False))

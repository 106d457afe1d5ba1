"""Discs of which little is seen, or nothing."""

import jax.numpy as jnp
import numpy as np
import pytest

from godfit.blind import brightness
from godfit.blind.beside import holding, nearer
from godfit.blind.brightness import NARROW, SAME, WIDE, along_density, along_gain
from godfit.blind.turns import Read, Turns
from godfit.inference.observation import Picture
from godfit.inference.solver import Point
from godfit.models.coordinates import DENSITY, EDGE, GAIN, RADIUS
from godfit.models.disc_light import DiscLight
from godfit.models.mitchell import Mitchell

SIZE = (90, 160)


def behind(shift):
    """(coordinates of the truth, turns, pixels seen): a disc behind an object as large that leaves
    so much of it, in texels, what is open of which is in doubt a texel around."""
    shading = Mitchell(0.06, 0.98, 0.8, 0.7, [0.45, 0.6], "dawntime", 40)
    model = DiscLight(shading, [0.15, 1e-4, 0.06], np.array([[0.1, 0.2, 0.3]]))
    rows, columns = np.indices(SIZE) + 0.5
    away = np.hypot(columns - 0.45 * SIZE[1] + shift, rows - 0.4 * SIZE[0])
    open_ = (away > 0.16 * SIZE[0]).astype(np.float32)
    levels = 255 * np.asarray(model(jnp.asarray(open_)))
    levels = np.round(levels).clip(0, 255).astype(np.float32)
    picture = Picture(levels, 0.5, open_ > 0, open_, None, "none", 0.02)
    truth = np.asarray(model.coordinates(), np.float32)
    held = np.full(len(truth), np.nan, np.float32)
    held[[0, EDGE]] = truth[0], truth[EDGE]
    unknown = np.abs(away - 0.16 * SIZE[0]) < 1.5
    turns = Turns(model, picture, unknown, 0.0, np.isnan(held), held, 0)
    return truth, turns, picture.observe(picture.informative(2000, 0))


@pytest.mark.usefixtures("single_precision")
@pytest.mark.parametrize("times", [4.0])
def test_a_crescent_that_was_read_far_too_bright_or_faint_is_read_right(times):
    """From where everything suits a wrong gain, and nothing leads away."""
    truth, turns, seen = behind(3.0)
    begin = truth.copy()
    begin[GAIN] *= times
    held = holding(turns, GAIN)
    read = Read.of(Point(begin, np.inf, False, 0), np.asarray(turns.picture.mask), seen)
    read = turns.turned(held.turn(held.turn(read, 2.0), 1.0), 4)
    assert abs(np.log2(read.point.coordinates[GAIN] / truth[GAIN])) > 0.5
    for step in (WIDE, NARROW):
        read, _ = along_gain(turns, read, *step)
    found = read.point.coordinates
    assert found[GAIN] == pytest.approx(truth[GAIN], rel=0.1)
    assert found[RADIUS] == pytest.approx(truth[RADIUS], rel=0.05)


@pytest.mark.usefixtures("single_precision")
def test_of_a_hidden_disc_nothing_is_asked_for_long():
    truth, turns, seen = behind(0.0)
    read = Read.of(Point(truth, np.inf, False, 0), np.asarray(turns.picture.mask), seen)
    read = turns.descended(read, turns.noise)
    same, found = along_gain(turns, read, *WIDE)
    assert same is read
    assert len(found) == 2 * SAME


def test_a_gain_that_is_held_is_not_walked_along():
    truth, turns, seen = behind(3.0)
    read = Read.of(Point(truth, np.inf, False, 0), np.asarray(turns.picture.mask), seen)
    same, found = along_gain(holding(turns, GAIN), read, *WIDE)
    assert same is read
    assert found == []


@pytest.mark.parametrize("times", [0.5, 3.0])
def test_as_bright_together_a_disc_covers_as_much_less(times):
    truth, turns, seen = behind(5.0)
    mask = np.asarray(turns.picture.mask)
    read = Read.of(Point(truth, np.inf, False, 0), mask, seen)
    rows, columns = np.indices(SIZE) + 0.5
    away = np.hypot(columns - 0.45 * SIZE[1], rows - 0.4 * SIZE[0]) / SIZE[0]
    areas = [mask[away < r].sum() for r in (truth[RADIUS], brightness._radius(read, times))]
    assert areas[0] / areas[1] == pytest.approx(times, rel=0.1)


@pytest.mark.usefixtures("single_precision")
@pytest.mark.parametrize("dips", [-3, 3])
def test_a_disc_that_was_read_some_dips_of_density_off_is_read_right(dips):
    """From where everything else suits a wrong density."""
    truth, turns, seen = behind(8.0)
    begin = truth.copy()
    begin[DENSITY] *= 1 + dips / turns.model.samples
    held = holding(turns, DENSITY)
    read = Read.of(Point(begin, np.inf, False, 0), np.asarray(turns.picture.mask), seen)
    stuck = held.turned(nearer(held, read), 4)
    read, _ = along_density(turns, stuck)
    off = read.point.coordinates[DENSITY] - truth[DENSITY]
    assert abs(off) < 0.5 * truth[DENSITY] / turns.model.samples
    assert turns.total(read) < 0.5 * turns.total(stuck)


def test_a_density_that_is_held_is_not_walked_along():
    truth, turns, seen = behind(3.0)
    read = Read.of(Point(truth, np.inf, False, 0), np.asarray(turns.picture.mask), seen)
    assert along_density(holding(turns, DENSITY), read) == (read, [])

"""What is tried before it is spoken. A small, seeded part of experiments/accuracy/hints.py."""

import dataclasses

import numpy as np
import pytest

import godfit
from godfit.inference.observation import Picture
from godfit.io.image import LEVELS
from godfit.search import suspects
from tests.support import distortions

SIZE = 96


def picture_of(levels, **fields):
    levels = np.atleast_3d(np.asarray(levels, np.float32))
    valid = np.ones(levels.shape[:2], bool)
    return Picture(levels, 0.5, valid, fields.pop("mask", valid * np.float32(1)), None, "none")


@pytest.mark.usefixtures("single_precision")
@pytest.mark.parametrize("kind", ["vertical", "reinhard", "border"])
def test_a_hint_names_the_option_that_explains_the_frame(kind):
    # Each of the others compiles a model of its own: they are in experiments/accuracy/hints.py.
    target, given, truth = distortions.made(kind, 2, SIZE)
    result = godfit.fit(target, **given)
    assert not result.converged
    (hint,) = result.warnings
    assert distortions.SAYS[kind] in hint
    if kind == "vertical":
        again = godfit.fit(target, **(given | distortions.OPTIONS[kind]))
        assert again.converged, again.message
        assert again.noise_levels < 0.05
        assert again.params["density"].value == pytest.approx(truth["density"], abs=2e-3)


def test_turning_twice_is_nothing():
    rng = np.random.default_rng(0)
    picture = picture_of(rng.uniform(0, 255, (5, 7)))
    for axes in ((0,), (1,), (0, 1)):
        turned = suspects.flipped(picture, axes)
        assert not np.array_equal(turned.levels, picture.levels)
        np.testing.assert_array_equal(suspects.flipped(turned, axes).levels, picture.levels)


def test_decoded_intervals_are_those_of_the_levels():
    levels = np.arange(256.0).reshape(16, 16)
    decoded = suspects.decoded(picture_of(levels), "reinhard")
    lo, hi = decoded.intervals(np.arange(256))
    level = np.arange(1, 255)
    below, above = ((level - 0.5) / LEVELS, (level + 0.5) / LEVELS)
    np.testing.assert_allclose(lo[1:255, 0], LEVELS * below / (1 - below), rtol=1e-5)
    np.testing.assert_allclose(hi[1:255, 0], LEVELS * above / (1 - above), rtol=1e-5)
    assert np.isinf(lo[0, 0])
    assert np.isinf(hi[255, 0])


def test_blocks_are_found_and_flat_pictures_have_none():
    rng = np.random.default_rng(1)
    small = rng.integers(0, 255, (20, 24))
    for side in suspects.BLOCKS:
        assert suspects.block_side(picture_of(small.repeat(side, 0).repeat(side, 1))) == side
    assert suspects.block_side(picture_of(small)) is None
    assert suspects.block_side(picture_of(np.zeros((40, 40)))) is None


def test_the_colour_of_a_light_is_found():
    rng = np.random.default_rng(2)
    levels = rng.uniform(0, 200, (10, 10, 1)) * np.array([1.2, 1.0, 0.5])
    picture = picture_of(levels)
    tint = suspects.tint_of(picture)
    np.testing.assert_allclose(tint, [1.2, 1, 0.5], atol=1e-6)
    even = suspects.untinted(picture, tint).levels
    np.testing.assert_allclose(even, np.broadcast_to(even[..., 1:2], even.shape), rtol=1e-5)
    assert suspects.tint_of(picture_of(levels[..., :1].repeat(3, -1))) is None
    coloured = dataclasses.replace(picture, mask=np.ones((10, 10, 3), np.float32))
    assert suspects.tint_of(coloured) is None

"""What a picture says of itself."""

import dataclasses

import numpy as np
import pytest

from godfit.inference.observation import CLIPPED, Picture
from godfit.io.filters import over_channels

RNG = np.random.default_rng(7)


def picture_of(levels, **given):
    known = np.ones(levels.shape[:2], bool)
    mask = np.ones(levels.shape[:2], np.float32)
    picture = Picture(levels.astype(np.float32), 0.5, known, mask, None, "none")
    return dataclasses.replace(picture, **given)


@pytest.mark.parametrize("channels", [1, 3])
def test_channels_are_taken_together(channels):
    image = RNG.uniform(0, 255, (9, 14, channels))
    np.testing.assert_array_equal(over_channels(np.maximum, image), image.max(-1))
    np.testing.assert_array_equal(over_channels(np.logical_and, image > 99), (image > 99).all(-1))


def test_under_another_mask_the_levels_say_the_same():
    levels = np.minimum(np.round(RNG.uniform(0, 300, (20, 30, 3))), 255)
    picture = picture_of(levels, valid=RNG.uniform(size=(20, 30)) > 0.2)
    other = picture.with_mask(np.zeros((10, 15), np.float32))
    assert other.mask.shape == (10, 15)
    afresh = dataclasses.replace(picture, mask=other.mask)
    for name in CLIPPED:
        assert getattr(other, name) is getattr(picture, name)
        np.testing.assert_array_equal(getattr(other, name), getattr(afresh, name))
        assert 0 < getattr(other, name).mean() < 1
    # What a mask does have a say in is not taken over.
    assert other.small.mask.shape == (10, 15)

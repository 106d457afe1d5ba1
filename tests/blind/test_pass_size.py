"""The size of a light pass, told from how a picture bends."""

import io

import numpy as np
import pytest
from PIL import Image

from godfit.blind import screenshot
from godfit.blind.pass_size import _bends, pass_scale_of
from godfit.inference.observation import Picture
from godfit.io.sources import read_source
from tests.support.synthetic import screens

made = screens.make_screenshot


def picture_of(levels):
    return screenshot.read(read_source(levels, "none"), None, None).picture


def doubled(texels):
    """(2 h, 2 w) read bilinearly from texels (h, w) twice as wide."""
    h, w = texels.shape
    rows, columns = (np.arange(2 * n) / 2 - 0.25 for n in (h, w))
    along = np.stack([np.interp(columns, np.arange(w), row) for row in texels])
    return np.stack([np.interp(rows, np.arange(h), column) for column in along.T], 1)


def test_texels_twice_as_wide_bend_at_every_other_pixel_only():
    texels = np.random.default_rng(0).uniform(0, 200, (20, 30))
    levels = doubled(texels)[..., None].astype(np.float32)
    known = np.ones(levels.shape[:2], bool)
    bends = _bends(Picture(levels, 0.5, known, known * 1.0, None, "none"))
    assert (bends[::2] == 0).all()
    assert (bends[1::2] > 50).all()


@pytest.mark.parametrize("kind", ["flat", "smooth"])
def test_sizes_are_told_or_left_open_and_never_wrong(kind):
    told = 0
    for seed in range(9300, 9306):
        screen = made(seed, kind)
        scale = pass_scale_of(picture_of(screen.image))
        assert scale in (None, screen.pass_scale)
        told += scale is not None
    assert told >= 3


def test_what_a_jpeg_makes_of_it_tells_nothing():
    for seed in (9300, 9304, 9308):
        for quality in (70, 85):
            file = io.BytesIO()
            Image.fromarray(made(seed, "flat").image).save(file, "JPEG", quality=quality)
            assert pass_scale_of(picture_of(np.asarray(Image.open(file)))) is None


def test_a_side_of_an_odd_number_of_pixels_is_not_asked():
    """Half of it is not half as many texels."""
    levels = doubled(np.random.default_rng(1).uniform(0, 200, (20, 30)))[:-1, :-1, None]
    known = np.ones(levels.shape[:2], bool)
    picture = Picture(levels.astype(np.float32), 0.5, known, known * 1.0, None, "none")
    assert not _bends(picture).any()
    assert pass_scale_of(picture) is None

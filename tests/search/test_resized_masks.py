"""Masks as they were before Pillow resized them, or a program that rounds once."""

import numpy as np
import pytest
from PIL import Image

from godfit.io.resampling import ROUNDED_ONCE, ROUNDED_TWICE, Resize, resize_weights
from godfit.search.registration.resized_masks import before_resize, few_values, snapped

FILTERS = {
    "box": Image.Resampling.BOX,
    "bilinear": Image.Resampling.BILINEAR,
    "bicubic": Image.Resampling.BICUBIC,
    "lanczos": Image.Resampling.LANCZOS,
}
SIZE = (96, 80)
LARGER, SMALLER = (97, 81), (95, 79)


def _resized(mask: np.ndarray, size: tuple[int, int], name: str) -> np.ndarray:
    return np.asarray(Image.fromarray(mask).resize(size[::-1], FILTERS[name]))


def _shapes(colours: tuple[int, ...]) -> np.ndarray:
    """Discs of these colours on the first of them, as bytes."""
    rng = np.random.default_rng(3)
    rows, columns = np.indices(SIZE)
    mask = np.full(SIZE, colours[0], np.uint8)
    for colour in rng.permutation(np.repeat(colours, 4)):
        y, x, radius = rng.uniform(0, 1, 3) * (*SIZE, 14)
        mask[(rows - y) ** 2 + (columns - x) ** 2 < radius**2] = colour
    return mask


@pytest.mark.parametrize("size", [LARGER, SMALLER, (192, 160), (48, 40)])
@pytest.mark.parametrize("name", ROUNDED_TWICE)
def test_weights_are_those_of_an_image_program(name, size):
    mask = np.random.default_rng(0).integers(0, 256, SIZE, np.uint8)
    rows, columns = (resize_weights(*n, name) for n in zip(SIZE, size, strict=True))
    between = np.floor(columns @ mask.T + 0.5).clip(0, 255)
    difference = np.floor(rows @ between.T + 0.5).clip(0, 255) - _resized(mask, size, name)
    # Halves, which a box makes, are rounded to either side.
    assert np.abs(difference).max() <= 1
    assert name == "box" or (difference != 0).mean() < 0.02


@pytest.mark.parametrize("size", [LARGER, SMALLER])
@pytest.mark.parametrize("name", ROUNDED_TWICE)
def test_a_mask_in_two_colours_is_found_again(name, size):
    mask = _shapes((0, 255))
    resized = np.float32(_resized(mask, size, name)) / 255
    errors = [np.abs(one.mask * 255 - mask) for one in before_resize(resized, SIZE)]
    # A box makes nothing grey, and a smaller picture lacks a row and a column.
    lost = 0.02 if (name, size) == ("box", SMALLER) else 0
    assert min((error > 0).mean() for error in errors) <= lost


@pytest.mark.parametrize("size", [LARGER, SMALLER])
@pytest.mark.parametrize("name", ROUNDED_ONCE)
def test_a_mask_that_was_rounded_once_is_found_again(name, size):
    mask = _shapes((0, 8, 255))
    rows, columns = (resize_weights(*n, name) for n in zip(SIZE, size, strict=True))
    resized = np.float32(np.round((rows @ mask @ columns.T).clip(0, 255))) / 255
    found = before_resize(resized, SIZE, once=True)
    one = min(found, key=lambda one: (np.abs(one.mask * 255 - mask) > 1).sum())
    assert one.variance is not None
    wrong, interior = np.abs(one.mask * 255 - mask) > 1, Resize.of(SIZE, size, name).interior()
    assert wrong.mean() < 0.01
    assert (one.variance[wrong & interior] > 0).all()
    assert (one.variance[interior] > 0).mean() < 0.2
    assert (one.variance[~interior] == 0).all()


@pytest.mark.parametrize("channels", [(), (3,)])
def test_a_mask_in_all_colours_is_nearly_found_again(channels):
    rng = np.random.default_rng(1)
    mask = rng.integers(0, 256, (*SIZE, *channels), np.uint8)
    resized = np.float32(_resized(mask, LARGER, "bilinear")) / 255
    found = [one.mask * 255 for one in before_resize(resized, SIZE)]
    error = min(np.sqrt(((one - mask) ** 2).mean()) for one in found)
    # Halfway between two pixels, what alternates is lost.
    assert error < 6


@pytest.mark.parametrize("size", [LARGER, SMALLER])
@pytest.mark.parametrize("name", ["bicubic", "lanczos"])
def test_what_was_clipped_is_found_or_in_doubt(name, size):
    """Beside white, a kernel that overshoots leaves black whatever dark colour was there."""
    mask = _shapes((0, 20, 255))
    resized = np.float32(_resized(mask, size, name)) / 255
    found = before_resize(resized, SIZE)
    one = min(found, key=lambda one: (np.abs(one.mask * 255 - mask) > 1).sum())
    assert one.variance is not None
    wrong = np.abs(one.mask * 255 - mask) > 1
    assert wrong.mean() < 2e-3
    assert (np.sqrt(one.variance[wrong]) * 255 > 2).all()
    assert (one.variance > 0).mean() < 0.01


def test_a_mask_of_its_size_is_as_it_was():
    assert before_resize(np.zeros(SIZE, np.float32), SIZE) == []


def test_few_values_are_those_that_many_pixels_share():
    grey = np.float32(_resized(_shapes((0, 102, 255)), LARGER, "bilinear")) / 255
    values = few_values(grey)
    assert values is not None
    np.testing.assert_allclose(values, [0, 0.4, 1], atol=1e-6)
    assert set(np.unique(snapped(grey, values))) == set(values)
    assert few_values(np.random.default_rng(2).random((40, 40))) is None

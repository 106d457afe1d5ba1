"""Masks as they were before Pillow resized them."""

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import godfit
from godfit.inference.allowances.resize_rounding import resize_variance
from godfit.models.tinted import TintedMask
from godfit.scattering.resize_kernels import KERNELS, resized_bytes
from godfit.search.resizing import before_resize, few_values, resize_weights, snapped

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
@pytest.mark.parametrize("name", KERNELS)
def test_weights_are_those_of_an_image_program(name, size):
    mask = np.random.default_rng(0).integers(0, 256, SIZE, np.uint8)
    difference = resized_bytes(mask, size, name) - _resized(mask, size, name)
    # Halves, which a box makes, are rounded to either side.
    assert np.abs(difference).max() <= 1
    assert name == "box" or (difference != 0).mean() < 0.02


@pytest.mark.parametrize("size", [LARGER, SMALLER])
@pytest.mark.parametrize("name", KERNELS)
def test_a_resized_light_pass_is_that_of_an_image_program(name, size):
    """Whole and at a few pixels, whose taps alone are summed; in float64 by products of matrices,
    which no kernel's overshoot leaves [0, 1] here."""
    mask = 0.2 + 0.6 * np.random.default_rng(0).random(SIZE)
    model = godfit.Mitchell(0.9, 0.95, 0.5, 0.02, (0.3, 0.6), "mitchell", 6)
    light = np.asarray(model(mask), float)
    rows, columns = (resize_weights(*n, name) for n in zip(SIZE, size, strict=True))
    expected = rows @ (columns @ light.T).T
    resized = model.with_pass(kernel=name)
    assert expected.min() >= 0
    assert expected.max() <= 1
    np.testing.assert_allclose(resized(mask, size=size), expected, atol=1e-6)
    pixels = np.array([0, 40, expected.size - 1])
    some = resized(mask, size=size, pixels=jnp.asarray(pixels))
    np.testing.assert_allclose(some, expected.ravel()[pixels], atol=1e-6)


def test_a_coloured_light_pass_is_resized_as_a_grey_one_is():
    mask = jnp.asarray(np.random.default_rng(0).random(SIZE))
    model = godfit.Mitchell(0.5, 0.95, 0.5, 0.02, (0.3, 0.6), "mitchell", 6)
    for settings in ({"kernel": "lanczos"}, {"full_size": True}):
        grey = np.asarray(model.with_pass(**settings)(mask, size=LARGER))
        tinted = TintedMask(model, (0.5, 0.25)).with_pass(**settings)(mask, size=LARGER)
        np.testing.assert_allclose(tinted, grey[..., None] * [0.5, 1, 0.25], atol=1e-6)


def test_noise_of_a_resize_is_that_of_the_bytes_it_mixes():
    """A box that makes a picture smaller: its values against what they were without rounding."""
    rng = np.random.default_rng(0)
    off = []
    rows, columns = (resize_weights(*n, "box") for n in zip(SIZE, SMALLER, strict=True))
    for _ in range(200):
        exact = rng.uniform(20, 230, SIZE)
        off.append(resized_bytes(np.round(exact), SMALLER, "box") - rows @ (columns @ exact.T).T)
    pixels = np.arange(SMALLER[0] * SMALLER[1])
    variance = resize_variance(pixels, SMALLER, SIZE, "box")
    assert variance is not None
    mixed = variance > 0
    assert 0 < mixed.mean() < 0.05
    # Beside the last rounding, which is that of every byte.
    measured = np.var(off, axis=0).ravel() - 1 / 12
    assert np.abs(measured[~mixed].mean()) < 1e-3
    # The mean of two bytes is a byte or a half, whose rounding is less than that of any value.
    assert 0.4 < measured[mixed].mean() / variance[mixed].mean() < 1.1
    assert resize_variance(pixels, SMALLER, SIZE, "lanczos") is None


@pytest.mark.parametrize("size", [LARGER, SMALLER])
@pytest.mark.parametrize("name", KERNELS)
def test_a_mask_in_two_colours_is_found_again(name, size):
    mask = _shapes((0, 255))
    resized = np.float32(_resized(mask, size, name)) / 255
    errors = [np.abs(one.mask * 255 - mask) for one in before_resize(resized, SIZE)]
    # A box makes nothing grey, and a smaller picture lacks a row and a column.
    lost = 0.02 if (name, size) == ("box", SMALLER) else 0
    assert min((error > 0).mean() for error in errors) <= lost


@pytest.mark.parametrize("channels", [(), (3,)])
def test_a_mask_in_all_colours_is_nearly_found_again(channels):
    rng = np.random.default_rng(1)
    mask = rng.integers(0, 256, (*SIZE, *channels), np.uint8)
    resized = np.float32(_resized(mask, LARGER, "bilinear")) / 255
    found = [one.mask * 255 for one in before_resize(resized, SIZE)]
    error = min(np.sqrt(((one - mask) ** 2).mean()) for one in found)
    # Halfway between two pixels, what alternates is lost.
    assert error < 6


def test_what_was_clipped_is_in_doubt():
    """Beside white, a kernel that overshoots leaves black whatever dark colour was there."""
    mask = _shapes((0, 20, 255))
    resized = np.float32(_resized(mask, LARGER, "bicubic")) / 255
    one = before_resize(resized, SIZE)[list(KERNELS).index("bicubic") * 2]
    assert one.variance is not None
    wrong = np.abs(one.mask * 255 - mask) > 1
    assert wrong.mean() < 0.02
    assert np.median(np.sqrt(one.variance[wrong]) * 255) > 2
    assert np.median(one.variance[~wrong]) < (1 / 255) ** 2


def test_a_mask_of_its_size_is_as_it_was():
    assert before_resize(np.zeros(SIZE, np.float32), SIZE) == []


def test_few_values_are_those_that_many_pixels_share():
    grey = np.float32(_resized(_shapes((0, 102, 255)), LARGER, "bilinear")) / 255
    values = few_values(grey)
    assert values is not None
    np.testing.assert_allclose(values, [0, 0.4, 1], atol=1e-6)
    assert set(np.unique(snapped(grey, values))) == set(values)
    assert few_values(np.random.default_rng(2).random((40, 40))) is None

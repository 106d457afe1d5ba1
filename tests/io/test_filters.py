"""Reads of small images, against scipy's."""

from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from godfit.io.filters import blurred, doubled, read_at, smoothed


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (6, 1), (5, 8)])
def test_doubled(size):
    image = np.random.default_rng(1).random(size).astype(np.float32)
    expected: Any = ndimage.zoom(image, 2, order=1, mode="nearest", grid_mode=True)
    np.testing.assert_allclose(doubled(image), expected, atol=1e-7)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (6, 1), (5, 8)])
def test_reads(size):
    rng = np.random.default_rng(2)
    image = rng.random(size).astype(np.float32)
    at = rng.uniform(-2, 10, (50, 2)).astype(np.float32)
    expected: Any = ndimage.map_coordinates(image, at[:, ::-1].T, order=1, mode="nearest")
    np.testing.assert_allclose(read_at(image, at), expected, atol=1e-6)


@pytest.mark.parametrize("size", [(40, 61), (3, 2)])
def test_smoothed_is_the_gaussian_filter(size):
    image = np.random.default_rng(3).random(size)
    np.testing.assert_allclose(
        smoothed(image, 1.0), ndimage.gaussian_filter(image, 1.0), atol=1e-14
    )


@pytest.mark.parametrize("sigma", [0.0, 1.0, 6.5])
@pytest.mark.parametrize("size", [(40, 61), (3, 2), (9, 12, 3)])
def test_blurred_is_two_boxes(size, sigma):
    image = np.random.default_rng(4).random(size).astype(np.float32)
    width = 2 * round((np.sqrt(6 * sigma**2 + 1) - 1) / 2) + 1
    # Beyond the edge its values are repeated, as far as two boxes reach.
    ends = [(2 * width, 2 * width)] * 2 + [(0, 0)] * (image.ndim - 2)
    expected = np.pad(image, ends, mode="edge")
    for axis in (0, 0, 1, 1):
        expected = ndimage.uniform_filter1d(expected, width, axis, mode="nearest")
    inside = tuple(slice(2 * width, 2 * width + n) for n in size[:2])
    np.testing.assert_allclose(blurred(image, sigma), expected[inside], atol=1e-6)
    assert blurred(image, sigma).dtype == np.float32

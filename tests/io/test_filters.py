"""Reads of small images, against scipy's."""

from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from godfit.io.filters import doubled, read_at, smoothed


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

"""Streaks of single texels, against sums over a mask with one texel more."""

import numpy as np
import pytest

from godfit.models.mitchell import Mitchell
from godfit.search.edge_pixels import _UncertainEdges
from tests.support import scattering_oracle as oracle


@pytest.mark.parametrize("density", [0.8, 1.6])
def test_a_streak_is_what_a_texel_adds(density):
    """Beyond the light the mask is mirrored, and so is the streak. No tap is at the light."""
    (h, w), light = (12, 15), (0.43, 0.58)
    rows, columns = np.array([3, 7, 9]), np.array([4, 10, 2])
    none = np.zeros((3, 1))
    uncertain = _UncertainEdges(np.zeros((h, w, 1)), rows, columns, none, none[:, 0])
    model = Mitchell(0.7, 0.9, density, 0.6, light, "mitchell", 4)
    streaks = uncertain._streaks(model).toarray()
    for row, column, streak in zip(rows, columns, streaks.T, strict=True):
        mask = np.zeros((h, w))
        mask[row, column] = 1
        expected = 255 * oracle.light_pass(mask, "mitchell", 0.7, 0.9, density, 0.6, light, 4)
        np.testing.assert_allclose(streak, expected.ravel(), rtol=0, atol=1e-9)

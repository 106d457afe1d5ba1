"""The scan of the number of samples."""

import numpy as np
import pytest

from godfit.inference.sample_count import squares_left


@pytest.mark.parametrize("shows_own", [True, False], ids=["own pixel", "rays alone"])
def test_what_spacings_leave_of_a_target_is_what_least_squares_leave(shows_own):
    rng = np.random.default_rng(8)
    target, sums = rng.random(40), rng.random((3, 40))
    own = rng.random(40) * shows_own

    found = squares_left(target, own, sums)

    for squares, one in zip(found, sums, strict=True):
        columns = np.stack([own, one] if shows_own else [one], -1)
        _, expected, _, _ = np.linalg.lstsq(columns, target)
        np.testing.assert_allclose(squares, expected[0], rtol=0, atol=1e-9)

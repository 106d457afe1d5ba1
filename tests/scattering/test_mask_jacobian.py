"""The Jacobian by the mask: with the unknowns put in it is the sum, taps beyond the light too."""

import numpy as np
import pytest
from scipy import sparse

from godfit.scattering.mask_jacobian import PartlyKnownMask, PixelTaps, mask_jacobian
from tests.support import scattering_oracle as oracle


@pytest.mark.parametrize("density", [0.8, 1.7])
@pytest.mark.parametrize("light", oracle.LIGHTS.values(), ids=oracle.LIGHTS)
def test_known_and_unknown_texels_add_up_to_the_sum(light, density):
    rng, (h, w), count = np.random.default_rng(0), (11, 13), 12
    known = rng.random(h * w) < 0.4
    # Unknowns are shared by about three texels each.
    unknown = np.where(known, -1, rng.integers(0, 30, h * w))
    solved, values = rng.random(30), rng.random(h * w)
    mask = np.where(known, values, solved[unknown])
    t, c = density * np.arange(count + 1) / count, 0.9 ** np.arange(count + 1)
    centre = np.array([light[0] * w - 0.5, (1 - light[1]) * h - 0.5])
    partly = PartlyKnownMask((h, w), values, unknown, 30, np.ones(h * w))

    rest, starts, columns, entries = mask_jacobian(
        np.arange(h * w), PixelTaps(centre, t, c), partly
    )

    jacobian = sparse.csr_array((entries, columns, starts), shape=(h * w, 30))
    expected = oracle.tap_sum(mask.reshape(h, w), light, c[0], c[1:], t[1:])
    np.testing.assert_allclose(rest + jacobian @ solved, expected.ravel(), rtol=0, atol=1e-6)

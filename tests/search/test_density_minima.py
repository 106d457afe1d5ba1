"""The right minimum in density, where short rays hardly determine it."""

import numpy as np
import pytest

import godfit
from tests.support import random_targets

SIZE = 96


@pytest.mark.usefixtures("single_precision")
@pytest.mark.parametrize("seed", [22, 41])
def test_a_wrong_density_within_rounding_is_not_the_answer(seed):
    """With a decay of .9, a tenth of a hundred taps is visible, and a density that is off by a
    tenth leaves less than rounding hides."""
    rng = np.random.default_rng(seed)
    light = rng.uniform(0.2, 0.8, 2)
    mask = random_targets.to_bytes(random_targets.triangles(rng, SIZE, light))
    truth = {
        "decay": 0.9, "density": 0.8, "weight": 0.8, "exposure": 1.0, "samples": 100,
        "light_x": float(light[0]), "light_y": float(light[1]),
    }  # fmt: skip
    rays = random_targets.render64(mask / 255, truth)
    target = random_targets.to_bytes(0.6 / np.quantile(rays, 0.98) * rays)
    result = godfit.fit(target, mask=mask, shader="dawntime", samples=100, inquire=False)
    found = result.params["density"]
    assert result.converged, result.message
    assert found.stderr is not None
    assert abs(found.value - truth["density"]) < 4 * found.stderr < 0.01

"""The right minimum in density, where short rays hardly determine it."""

import numpy as np
import pytest

import godfit
from godfit.search import rival_densities
from tests.support import random_targets

SIZE = 96


def _rays(seed: int, decay: float) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
    """(target, mask, truth): bytes of the rays of triangles."""
    rng = np.random.default_rng(seed)
    light = rng.uniform(0.2, 0.8, 2)
    mask = random_targets.to_bytes(random_targets.triangles(rng, SIZE, light))
    truth = {
        "decay": decay, "density": 0.8, "weight": 0.8, "exposure": 1.0, "samples": 100,
        "light_x": float(light[0]), "light_y": float(light[1]),
    }  # fmt: skip
    rays = random_targets.render64(mask / 255, truth)
    truth["exposure"] = 0.6 / np.quantile(rays, 0.98)
    return random_targets.to_bytes(truth["exposure"] * rays), mask, truth


@pytest.mark.usefixtures("single_precision")
@pytest.mark.parametrize("seed", [22, 41])
def test_a_wrong_density_within_rounding_is_not_the_answer(seed):
    """With a decay of .9, a tenth of a hundred taps is visible, and a density that is off by a
    tenth leaves less than rounding hides."""
    target, mask, truth = _rays(seed, 0.9)
    result = godfit.fit(target, mask=mask, shader="dawntime", samples=100, inquire=False)
    found = result.params["density"]
    assert result.converged, result.message
    assert found.stderr is not None
    assert abs(found.value - truth["density"]) < 4 * found.stderr < 0.01


@pytest.mark.usefixtures("single_precision")
def test_other_densities_that_rounding_allows_count_as_an_error():
    """By its curvature alone, a minimum is 19 errors beside the truth here."""
    target, mask, truth = _rays(59, 0.9)
    result = godfit.fit(target, mask=mask, shader="dawntime", samples=100)
    assert result.converged, result.message
    for name, one in result.params.items():
        assert one.stderr is not None
        assert abs(one.value - truth[name]) < 4 * one.stderr
    # Several minima are as likely, each a band of .8/100 wide.
    assert 0.02 < (result.params["density"].stderr or 0) < 0.2


@pytest.mark.usefixtures("single_precision")
def test_a_density_that_bands_determine_has_no_rivals(monkeypatch):
    target, mask, _ = _rays(59, 0.97)
    kept, seen = rival_densities.with_rivals, []

    def noted(found):
        seen.append((found, kept(found)))
        return seen[-1][1]

    monkeypatch.setattr(rival_densities, "with_rivals", noted)
    godfit.fit(target, mask=mask, shader="dawntime", samples=100)
    ((before, after),) = seen
    assert after is before

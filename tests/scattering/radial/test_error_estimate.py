"""The promise of a tolerance: no pixel of the picture is further off than that."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from godfit.scattering import radial
from godfit.scattering.conventions import convention
from godfit.scattering.radial import METHODS, cheapest, error
from godfit.scattering.radial.error_estimate import costs
from godfit.scattering.taps import Taps
from tests.support import scattering_oracle as oracle

radial_sum = jax.jit(radial.radial_sum, static_argnames="method")

LIGHT = jnp.array([0.37, 0.62], jnp.float32)
SMOOTH = jnp.asarray(oracle.smooth_mask(90, 130, scale=12), jnp.float32)
STRUTS = jnp.asarray(np.add.outer(2 * np.arange(90), np.arange(130)) % 31 > 2, jnp.float32)
TAPS = Taps(0.01, 0.01, 0.99, 0.85 / 200, 200)


def worst(mask, lights, taps, method):
    """The largest error over all pixels, in levels."""
    return (
        255
        * np.abs(
            sum(
                np.asarray(radial_sum(mask, light, taps, method=method))
                - np.asarray(radial_sum(mask, light, taps))
                for light in lights.reshape(-1, 2)
            )
        ).max()
    )


@pytest.mark.parametrize(
    "light", [LIGHT, jnp.array([1.4, -0.3], jnp.float32)], ids=["on screen", "off screen"]
)
@pytest.mark.parametrize("mask", [SMOOTH, STRUTS], ids=["smooth", "struts"])
def test_no_pixel_is_further_off(mask, light):
    for tolerance in (0.5, 5.0):
        method = cheapest(mask, light, TAPS, tolerance)
        assert worst(mask, light, TAPS, method) <= tolerance
        assert method != "strips" or mask is STRUTS


def test_taps_beyond_the_light_keep_the_tolerance():
    taps = Taps(0.01, 0.01, 0.99, 1.6 / 200, 200)
    for tolerance in (0.5, 5.0):
        method = cheapest(SMOOTH, LIGHT, taps, tolerance)
        assert worst(SMOOTH, LIGHT, taps, method) <= tolerance


@pytest.mark.parametrize("method", ["merged/4", "half", "polar"])
def test_estimates_are_above_and_near(method):
    for mask in (SMOOTH, STRUTS):
        true = worst(mask, LIGHT, TAPS, method)
        assert true <= error(mask, LIGHT, TAPS, method) < 3 * true


def test_exact_methods_have_no_error_and_serve_tolerance_0():
    chosen = [cheapest(STRUTS, LIGHT, TAPS, tolerance) for tolerance in (0.0, 1e-3)]
    for method in (*chosen, "auto", "pairs", "reference"):
        assert error(STRUTS, LIGHT, TAPS, method) == 0
    # Bytes are packed without loss, others are not.
    assert error(STRUTS, LIGHT, TAPS, "packed") < 0.01
    assert error(SMOOTH, LIGHT, TAPS, "packed") > 0.05


def test_lights_share_the_tolerance():
    lights = jnp.array([[0.37, 0.62], [1.4, -0.3]], jnp.float32)
    alone = [error(SMOOTH, light, TAPS, "merged/4") for light in lights]
    np.testing.assert_allclose(error(SMOOTH, lights, TAPS, "merged/4"), sum(alone))
    tolerance = 1.2 * max(alone)
    assert worst(SMOOTH, lights, TAPS, cheapest(SMOOTH, lights, TAPS, tolerance)) <= tolerance


def test_scale_channels_and_small_pictures():
    three = jnp.stack([STRUTS, SMOOTH, SMOOTH], -1)
    alone = error(STRUTS, LIGHT, TAPS, "merged/4")
    assert error(three, LIGHT, TAPS, "merged/4") > 0.4 * alone
    np.testing.assert_allclose(error(STRUTS, LIGHT, TAPS, "merged/4", scale=1.0), alone / 255)
    small = STRUTS[:30, :40]
    np.testing.assert_allclose(
        error(small, LIGHT, TAPS, "merged/4"), worst(small, LIGHT, TAPS, "merged/4"), rtol=1e-5
    )


@pytest.mark.parametrize("tolerance", [-0.1, float("nan")])
def test_bad_tolerances(tolerance):
    with pytest.raises(ValueError, match="tolerance: expected a number, 0 or more"):
        cheapest(SMOOTH, LIGHT, TAPS, tolerance)


def test_uv_taps_are_summed_exactly():
    taps = convention("three").taps(1.0, 1.0, 1.0, 1.0, 18)[0]
    assert cheapest(SMOOTH, LIGHT, taps, 100.0) == "reference"


@pytest.mark.parametrize("count", [0, 1, 150])
def test_every_method_has_a_cost(count):
    assert set(costs(90, 130, count)) == set(METHODS)
    assert jax.default_backend() != "cpu" or min(costs(512, 512, 150).values()) == 19

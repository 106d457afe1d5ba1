"""Coefficients and formulas against published numbers, limits, and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from godfit import InputError
from godfit.models import atmosphere
from godfit.models.atmosphere import Air, hoffman_preetham, zenith_angle
from tests.support.compiling import quick_jit

UP = jnp.array([0.0, 1.0, 0.0])


def test_coefficients_are_the_published_ones():
    np.testing.assert_allclose(1e6 * atmosphere.rayleigh(), [6.953, 11.757, 24.380], atol=5e-4)
    np.testing.assert_allclose(1e3 * atmosphere.mie(2.0), [5.74, 7.40, 10.51], atol=5e-3)


@pytest.mark.parametrize(
    ("degrees", "expected"),
    [(0, (0.877, 0.833, 0.738)), (60, (0.769, 0.695, 0.546)), (85, (0.257, 0.152, 0.043))],
)
def test_sunlight_is_the_published_one(degrees, expected):
    found = atmosphere.sunlight(2.0, jnp.deg2rad(degrees))
    np.testing.assert_allclose(found, expected, atol=5e-4)


@pytest.mark.parametrize("g", [-0.9, 0.0, 0.3, 0.76, 0.95])
def test_phase_functions_integrate_to_one(g):
    nodes, weights = np.polynomial.legendre.leggauss(300)
    for phase in (atmosphere.rayleigh_phase, lambda c: atmosphere.henyey_greenstein(c, g)):
        assert 2 * np.pi * weights @ phase(jnp.asarray(nodes)) == pytest.approx(1, abs=1e-6)


def test_mean_cosine_of_haze_is_g():
    nodes, weights = np.polynomial.legendre.leggauss(300)
    lobe = np.asarray(atmosphere.henyey_greenstein(jnp.asarray(nodes), 0.6))
    assert 2 * np.pi * weights @ (lobe * nodes) == pytest.approx(0.6, abs=1e-6)


def test_published_lobe_is_twice_too_large_over_k():
    cos = jnp.array(0.7)
    right, published = (Air(4.0, 0.7, phase=p).scattered(cos) for p in atmosphere.PHASES)
    molecules = Air(4.0, 0.7).beta_r * atmosphere.rayleigh_phase(cos)
    ratio = (published - molecules) / (right - molecules)
    np.testing.assert_allclose(ratio, [2.92, 2.95, 2.99], atol=5e-3)


def test_unknown_phase_is_refused():
    with pytest.raises(InputError, match="expected one of normalised, published, got 'mie'"):
        Air(phase="mie")


def test_energy_is_kept():
    """All directions together, deep air gives back all that the sun sends, and no more."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    air = Air(3.0, 0.6, 1.0, 1e9)
    around = air.inscattered(jnp.ones(200), jnp.asarray(nodes), 0.3)
    found = 2 * np.pi * weights @ np.asarray(around)
    np.testing.assert_allclose(found, atmosphere.sunlight(3.0, 0.3), rtol=1e-9)


def test_transmitted_surface_and_added_light():
    air, s = Air(2.0, 0.5, 3.0, 1e4), jnp.array([0.0, 1.0, 5.0])
    cos = jnp.array([0.3, -0.2, 0.9])
    beta = np.asarray(air.beta_ex)
    left = np.exp(-beta * np.asarray(s)[:, None])
    sun = 3 * np.asarray(atmosphere.sunlight(2.0, 1.0))
    expected = 0.4 * left + sun / beta * np.asarray(air.scattered(cos)) * (1 - left)
    np.testing.assert_allclose(hoffman_preetham(air, s, cos, 1.0, 0.4), expected, rtol=1e-12)


def test_thin_air_is_its_limit():
    """Without 0/0: at nothing in the way, light grows with path and coefficient alone."""
    thin = Air(2.0, 0.5, 3.0, 1e-9)
    cos, s = jnp.array([0.2]), jnp.array([7.0])
    sun = 3 * atmosphere.sunlight(2.0, 0.5)
    expected = sun[None] * thin.scattered(cos) * s[:, None]
    np.testing.assert_allclose(thin.inscattered(s, cos, 0.5), expected, rtol=1e-9)


def test_shortened_joins_its_series():
    x = jnp.array([0.0, 1e-12, 9.99e-4, 1.001e-3, 1.0, 50.0])
    exact = np.where(x == 0, 1.0, -np.expm1(-np.asarray(x)) / np.where(x == 0, 1.0, x))
    np.testing.assert_allclose(atmosphere.path_transmission(x), exact, rtol=1e-13)


def radiance_of(z):
    """A mean over pixels, by turbidity, g, e_sun, scale, the sun's direction and the distance."""
    sun = z[4:7] / jnp.linalg.norm(z[4:7])
    view = jnp.array([[0.0, 0.0, -1.0], [0.3, 0.1, -0.9], [0.0, 0.8, 0.6]])
    view = view / jnp.linalg.norm(view, axis=1, keepdims=True)
    lit = hoffman_preetham(
        Air(*z[:4]), jnp.full(3, z[7]), view @ sun, zenith_angle(sun, UP), jnp.array([[0.2]])
    )
    return (lit * jnp.array([[1.0, 2.0, 3.0]])).mean()


radiance, with_slopes = quick_jit(radiance_of), quick_jit(jax.value_and_grad(radiance_of))


LIMITS = {
    "usual": [3.0, 0.6, 5.0, 2e4, 0.2, 0.5, -1.0, 2.0],
    "no distance": [3.0, 0.6, 5.0, 2e4, 0.2, 0.5, -1.0, 0.0],
    "no air": [3.0, 0.6, 5.0, 0.0, 0.2, 0.5, -1.0, 2.0],
    "towards the sun": [3.0, 0.6, 5.0, 2e4, 0.0, 0.0, -1.0, 2.0],
    "away from the sun": [3.0, 0.6, 5.0, 2e4, 0.0, -0.8, -0.6, 2.0],
    "sun at the zenith": [3.0, 0.6, 5.0, 2e4, 0.0, 1.0, 0.0, 2.0],
    "sun on the horizon": [3.0, 0.6, 5.0, 2e4, 0.6, 0.0, -0.8, 2.0],
    "sun below it": [3.0, 0.6, 5.0, 2e4, 0.6, -0.3, -0.8, 2.0],
    "least turbidity": [0.995, 0.6, 5.0, 2e4, 0.2, 0.5, -1.0, 2.0],
    "isotropic haze": [3.0, 0.0, 5.0, 2e4, 0.2, 0.5, -1.0, 2.0],
}
# Where the sun stands at the zenith or on the horizon, its direction has a kink.
KINKS = ("sun at the zenith", "sun on the horizon", "towards the sun")


@pytest.mark.parametrize("name", LIMITS)
def test_derivatives_are_those_of_differences(name):
    z = jnp.array(LIMITS[name])
    value, slope = with_slopes(z)
    assert np.isfinite(value)
    assert np.isfinite(slope).all()
    for i in range(8):
        if name in KINKS and i in (4, 5, 6):
            continue
        step = 1e-5 * max(abs(float(z[i])), 1.0 if i != 3 else 1e4)
        way = jnp.zeros(8).at[i].set(step)
        # Of fourth order, so that the difference itself is not what is off.
        one, two = (float(radiance(z + k * way) - radiance(z - k * way)) for k in (1, 2))
        difference = (8 * one - two) / (12 * step)
        assert float(slope[i]) == pytest.approx(difference, rel=1e-5, abs=1e-9 * abs(float(value)))


def test_zenith_angle():
    for degrees in (0.0, 1e-9, 30.0, 89.0, 90.0):
        sun = jnp.array([jnp.sin(jnp.deg2rad(degrees)), jnp.cos(jnp.deg2rad(degrees)), 0.0])
        assert float(jnp.rad2deg(zenith_angle(sun, UP))) == pytest.approx(degrees, abs=1e-7)
    below = jnp.array([0.6, -0.8, 0.0])
    assert float(zenith_angle(below, UP)) == pytest.approx(np.pi / 2)

"""The fit against lmfit: the same picture, but another renderer (numpy and scipy), another solver,
other coordinates, and derivatives by finite differences."""

import lmfit
import numpy as np
import pytest

import godfit
from tests.support import known_truth
from tests.support import scattering_oracle as oracle

# As large as the pictures of other tests, whose programs the fit shares.
SIZE, SAMPLES, NOISE_LEVELS = 96, 30, 1.0
TRUTH = {
    "exposure": 0.1,
    "decay": 0.95,
    "density": 0.7,
    "weight": 0.5,
    "light_x": 0.4,
    "light_y": 0.6,
}


@pytest.fixture(scope="module")
def scene():
    """A smooth mask, and a picture of floats (no rounding) with Gaussian noise."""
    mask = oracle.smooth_mask(SIZE, SIZE, scale=3).astype(np.float32)
    noise = np.random.default_rng(1).normal(0, NOISE_LEVELS / 255, mask.shape)
    return mask, (_render(mask, **TRUTH) + noise).astype(np.float32)


def _render(mask, exposure, decay, density, weight, light_x, light_y):
    return oracle.light_pass(
        mask.astype(float),
        "dawntime",
        exposure,
        decay,
        density,
        weight,
        (light_x, light_y),
        SAMPLES,
    )


@pytest.fixture(scope="module")
def by_lmfit(scene):
    mask, target = scene

    def residual(parameters):
        return (255 * (_render(mask, **parameters.valuesdict()) - target)).ravel()

    start = lmfit.create_params(**TRUTH)
    return lmfit.Minimizer(residual, start).minimize("leastsq", xtol=1e-12, ftol=1e-12)


@pytest.fixture
def by_godfit(scene, single_precision):
    mask, target = scene
    return godfit.fit(target, mask=mask, shader="dawntime", samples=SAMPLES, **known_truth.ALONE)


def test_fit_is_that_of_lmfit(by_godfit, by_lmfit):
    """From no start at all against from the truth: values, errors, correlations and noise. What is
    left between the values is godfit's float32 and its stop at a gain of 1/2 in the likelihood."""
    assert by_godfit.converged
    assert list(by_godfit.params) == list(TRUTH)
    for name, estimate in by_godfit.params.items():
        theirs = by_lmfit.params[name]
        assert abs(estimate.value - theirs.value) < 0.02 * theirs.stderr, name
        assert estimate.stderr == pytest.approx(theirs.stderr, rel=0.01), name
    assert by_godfit.correlations
    for pair, correlation in by_godfit.correlations.items():
        a, b = pair.split(",")
        assert correlation == pytest.approx(by_lmfit.params[a].correl[b], abs=0.02), pair
    assert by_godfit.noise_levels == pytest.approx(by_lmfit.redchi**0.5, rel=0.02)
    assert by_godfit.noise_levels == pytest.approx(NOISE_LEVELS, rel=0.05)
    assert by_godfit.rmse_levels == pytest.approx((by_lmfit.chisqr / SIZE**2) ** 0.5, rel=1e-3)

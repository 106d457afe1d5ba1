"""The likelihood of a rounded pixel against numerical quadrature, scipy and finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import log_ndtr

from godfit.inference import likelihood

interval = jax.jit(likelihood.interval)
log_likelihood = jax.jit(likelihood.log_likelihood)
deviance_residuals = jax.jit(likelihood.deviance_residuals)

NODES, WEIGHTS = np.polynomial.legendre.leggauss(400)
WIDTHS = (1e-3, 0.015, 0.03, 0.3, 1.0, 4.0, 20.0, 40.0)
MIDDLES = np.array([0.0, 0.013, 0.4, 1.0, 2.7, 5.0, 7.99, 9.0, 14.0, 30.0, 60.0])
GRID = [np.ravel(z) for z in np.meshgrid(np.concatenate([-MIDDLES[1:], MIDDLES]), WIDTHS)]
# Widths at which godfit takes the interval for a point, and edge positions from which it takes the
# far tail's curvature.
NARROW, TAIL = 0.02, 8.0


def moments(low, high):
    """log P(low < u < high), mean and variance of u given that, of a standard normal u, by
    Gauss-Legendre quadrature from the edge nearer to 0 outwards, each to about 1e-13."""
    mirror = low + high > 0
    a, b = (-high, -low) if mirror else (low, high)
    # phi(b - s) = phi(b) exp(b s - s^2/2): as far as it falls by e^-45.
    reach = min(b - a, b + np.sqrt(b * b + 90))
    s = reach * (NODES + 1) / 2
    share = WEIGHTS * reach / 2 * np.exp(b * s - s * s / 2)
    total = share.sum()
    log = np.log(total) - b * b / 2 - np.log(2 * np.pi) / 2
    mean = (share * s).sum() / total
    variance = (share * (s - mean) ** 2).sum() / total
    return log, (mean - b if mirror else b - mean), variance


def oracle(middles, widths):
    """Log-likelihood, slope E[u] and curvature 1 - Var[u] of intervals."""
    log, mean, variance = np.transpose(
        [moments(m - w / 2, m + w / 2) for m, w in zip(middles, widths, strict=True)]
    )
    return log, mean, 1 - variance


def test_the_quadrature_is_scipys_distribution():
    for edge in (-60.0, -9.0, -1.0, 0.0, 2.0):
        np.testing.assert_allclose(moments(-200.0, edge)[0], log_ndtr(edge), rtol=1e-12)
    wide = moments(-1.3, 2.1)[0]
    np.testing.assert_allclose(wide, np.log(np.exp(log_ndtr(2.1)) - np.exp(log_ndtr(-1.3))))


def test_interval_is_the_quadrature():
    """To rounding (1e-10 near -20: JAX's log_ndtr), apart from intervals taken for points,
    with their errors of second order in the width, and from the far tail's curvature, which
    is 1 - Var[u] with 1/b^2, the open interval's, for a variance."""
    middle, width = GRID
    log, slope, curvature = oracle(middle, width)
    pixel = interval(jnp.asarray(middle - width / 2), jnp.asarray(middle + width / 2))
    size = 1 + np.abs(middle)
    point = np.where(width < NARROW, 1.01 * width**2 / 12, 0)
    edge = np.abs(middle) - width / 2
    tail = np.where((edge > TAIL) & (width >= NARROW), 1 / np.maximum(edge, TAIL) ** 2, 0)
    assert (np.abs(pixel.log - log) <= 1e-11 * size**2 + point / 2 * (1 + middle**2)).all()
    assert (np.abs(pixel.slope - slope) <= 1e-8 * size + point * size).all()
    assert (np.abs(pixel.curvature - curvature) <= 1e-11 + point + tail).all()


@pytest.mark.parametrize("side", [-1, 1])
def test_one_sided_intervals(side):
    """At least (the brightest level) and below (the darkest), in both tails."""
    edge = np.array([-60.0, -20.0, -7.9, -3.0, 0.0, 2.0, 6.0, 30.0])
    infinity = np.full_like(edge, np.inf)
    low, high = (-infinity, edge) if side < 0 else (-edge, infinity)
    pixel = interval(jnp.asarray(low), jnp.asarray(high))
    np.testing.assert_allclose(pixel.log, log_ndtr(edge), rtol=1e-10, atol=1e-15)
    # The inverse Mills ratio and what follows from it.
    mills = np.exp(-(edge**2) / 2 - np.log(2 * np.pi) / 2 - log_ndtr(edge))
    np.testing.assert_allclose(pixel.slope, side * mills, rtol=1e-8)
    exact = np.array([1 - moments(min(e - 1, -200.0), e)[2] for e in edge])
    np.testing.assert_allclose(pixel.curvature, exact, rtol=0, atol=2e-3)
    assert np.abs(pixel.curvature - exact)[edge > -8].max() < 1e-11


@pytest.mark.parametrize("width", [0.05, 0.5, 1.0, 6.0, np.inf])
def test_slope_and_curvature_are_derivatives(width):
    prediction, step = jnp.linspace(-7.5, 7.5, 61), 1e-4

    def at(f):
        low = -f - min(width / 2, 1.0)
        return interval(low, low + width)

    here, after, before = at(prediction), at(prediction + step), at(prediction - step)
    scale = np.maximum(1, np.abs(here.slope))
    slope, bend = (after.log - before.log) / (2 * step), (before.slope - after.slope) / (2 * step)
    assert (np.abs(here.slope - slope) < 1e-6 * scale).all()
    assert (np.abs(here.curvature - bend) < 1e-6 * scale**2).all()


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_finite_and_concave_everywhere(dtype):
    edges = np.array([0, 1e-6, 1e-3, 0.0199, 0.0201, 0.5, 1, 7.99, 8.01, 40, 200, 1e4, 1e7, 1e30])
    edges = np.concatenate([-edges[::-1], edges, [-np.inf, np.inf]])
    low, high = (z[np.less_equal(*np.meshgrid(edges, edges))] for z in np.meshgrid(edges, edges))
    pixel = interval(jnp.asarray(low, dtype), jnp.asarray(high, dtype))
    for name, value in zip(pixel._fields, pixel, strict=True):
        assert value.dtype == dtype
        assert np.isfinite(value).all(), name
    assert (pixel.curvature >= 0).all()
    assert (pixel.curvature <= 1).all()


def test_float32_is_close_to_float64():
    middle, width = GRID
    low, high = middle - width / 2, middle + width / 2
    single = interval(jnp.asarray(low, jnp.float32), jnp.asarray(high, jnp.float32))
    double = interval(jnp.asarray(low), jnp.asarray(high))
    size = 1 + np.abs(middle)
    assert (np.abs(single.log - double.log) < 1e-5 * size**2 + 1e-3).all()
    assert (np.abs(single.slope - double.slope) < 1e-4 * size).all()
    assert (np.abs(single.curvature - double.curvature) < 3e-3).all()


@pytest.mark.parametrize("sigma", [2.0, 4.0, 8.0])
def test_large_sigma_is_a_gaussian_of_added_variance(sigma):
    """sigma^2 + h^2/3 (Sheppard): what is left falls as (h/sigma)^4."""
    half = 0.5
    off = jnp.linspace(-sigma, sigma, 21)
    log = log_likelihood(off, jnp.full(21, -half), jnp.full(21, half), jnp.asarray(sigma))
    variance = sigma**2 + half**2 / 3
    gaussian = -(off**2) / (2 * variance)
    assert np.abs(log - log[10] - gaussian).max() < 0.05 * (half / sigma) ** 4
    # Without the added variance the error is of second order: the test can tell.
    assert np.abs(log - log[10] + off**2 / (2 * sigma**2)).max() > 0.1 * (half / sigma) ** 2


# (lo, hi) in levels: an ordinary pixel, a brightest and a darkest one, an unsafe one.
PIXELS = {
    "rounded": (99.5, 100.5),
    "brightest": (254.5, np.inf),
    "darkest": (-np.inf, 0.5),
}


def residuals(prediction, lo, hi, sigma):
    n = prediction.shape[0]
    return deviance_residuals(prediction, jnp.full(n, lo), jnp.full(n, hi), jnp.asarray(sigma))


@pytest.mark.parametrize("sigma", [0.01, 0.3, 2.0])
@pytest.mark.parametrize(("lo", "hi"), PIXELS.values(), ids=PIXELS)
class TestDevianceResiduals:
    def predictions(self, lo, hi, sigma):
        edge = lo if np.isfinite(lo) else hi
        inside = (lo + hi) / 2 if np.isfinite(lo + hi) else edge
        reach = np.linspace(-30, 30, 241) * sigma
        # As many of every pixel: each function is compiled once.
        return jnp.asarray(np.sort(np.concatenate([edge + reach, inside + reach])))

    def test_half_the_squares_is_minus_log_likelihood(self, lo, hi, sigma):
        f = self.predictions(lo, hi, sigma)
        n = f.shape[0]
        log = log_likelihood(f, jnp.full(n, lo), jnp.full(n, hi), jnp.asarray(sigma))
        constant = 0.5 * residuals(f, lo, hi, sigma) ** 2 + log
        np.testing.assert_allclose(constant, constant[0], rtol=0, atol=1e-10)

    def test_sign_and_direction(self, lo, hi, sigma):
        """Positive below the pixel's value, negative above it, falling all the way."""
        f = self.predictions(lo, hi, sigma)
        r = residuals(f, lo, hi, sigma)
        middle = np.clip((lo + hi) / 2, -1e9, 1e9)
        assert (r[f < middle] >= 0).all()
        assert (r[f > middle] <= 0).all()
        assert (np.diff(r) <= 1e-7).all()
        assert np.ptp(r) > 20

    def test_derivative(self, lo, hi, sigma):
        """Also in the middle, where the residual is a root of zero."""
        f, step = self.predictions(lo, hi, sigma), 1e-4 * sigma
        slope = jax.jvp(lambda f: residuals(f, lo, hi, sigma), (f,), (jnp.ones_like(f),))[1]
        up, down = residuals(f + step, lo, hi, sigma), residuals(f - step, lo, hi, sigma)
        difference = (up - down) / (2 * step)
        seen = np.abs(residuals(f, lo, hi, sigma)) > 1e-3
        np.testing.assert_allclose(slope[seen], difference[seen], rtol=2e-3, atol=2e-3 / sigma)
        assert np.isfinite(slope).all()


@pytest.mark.parametrize("sigma", [0.4, 1.0, 3.0])
def test_derivative_in_the_very_middle(sigma):
    """There it is minus the root of the curvature, from both sides."""
    f = jnp.array([100 - 1e-3 * sigma, 100.0, 100 + 1e-3 * sigma])
    slope = jax.jvp(lambda f: residuals(f, 99.5, 100.5, sigma), (f,), (jnp.ones(3),))[1]
    curvature = interval(jnp.array(-0.5 / sigma), jnp.array(0.5 / sigma)).curvature
    np.testing.assert_allclose(slope, np.full(3, -np.sqrt(curvature) / sigma), rtol=1e-4)


@pytest.mark.parametrize("sigma", [0.01, 1.0])
def test_points_are_gaussian(sigma):
    """A target of floats: the residual is (t - f)/sigma, the likelihood the normal density."""
    f = 100 + sigma * jnp.linspace(-50, 50, 101)
    level = jnp.full(101, 100.0)
    r = deviance_residuals(f, level, level, jnp.asarray(sigma))
    np.testing.assert_allclose(r, (100 - f) / sigma, rtol=1e-10, atol=1e-7)
    slope = jax.jvp(lambda f: residuals(f, 100.0, 100.0, sigma), (f,), (jnp.ones(101),))[1]
    np.testing.assert_allclose(slope, np.full(101, -1 / sigma), rtol=1e-10)
    log = log_likelihood(f, level, level, jnp.asarray(sigma))
    density = -(((100 - f) / sigma) ** 2) / 2 - np.log(sigma * np.sqrt(2 * np.pi))
    np.testing.assert_allclose(log, density, rtol=1e-12)

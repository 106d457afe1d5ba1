"""Errors where neighbours err together: nothing for white noise, enough for correlated noise."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from godfit.inference.observation import Observation, Picture
from godfit.inference.sandwich import neighbours, slope_covariance, white, widened
from godfit.inference.solver import Tangent
from godfit.report.verdict import is_a_line

SIZE = 96


def observed(residual, keep=1.0):
    pixels = np.flatnonzero(np.random.default_rng(0).random(SIZE * SIZE) < keep)
    values = jnp.asarray(residual.reshape(-1)[pixels])
    return Observation(
        jnp.zeros((SIZE, SIZE)), None, jnp.asarray(pixels, jnp.int32), values, values,
        (SIZE, SIZE), 1, "none", keep == 1.0,
    )  # fmt: skip


def field(seed, blur):
    noise = np.random.default_rng(seed).standard_normal((SIZE, SIZE))
    noise = ndimage.gaussian_filter(noise, blur, mode="wrap") if blur else noise
    return noise / noise.std()


@pytest.mark.parametrize("keep", [1.0, 0.5])
def test_white_noise_is_white_and_blurred_noise_is_not(keep):
    for seed in range(20):
        plain, smooth = observed(field(seed, 0), keep), observed(field(seed, 0.6), keep)
        assert white(np.asarray(plain.lo), plain)
        assert not white(np.asarray(smooth.lo), smooth)
    across, down, pairs = neighbours(np.asarray(smooth.lo), smooth)
    assert across == pytest.approx(down, abs=0.05)
    assert pairs > 1000


@pytest.mark.parametrize("blur", [0.0, 1.0, 2.0])
def test_widened_errors_cover(blur):
    """Estimates of two coefficients under noise of that blur: their quoted variance is theirs."""
    y, x = np.mgrid[:SIZE, :SIZE] / SIZE
    rows = np.stack([np.ones_like(x), np.sin(40 * x) + y]).reshape(2, -1)
    gram = rows @ rows.T
    quoted, found, grown = [], [], []
    for seed in range(60):
        noise = field(seed, blur)
        estimate = np.linalg.solve(gram, rows @ noise.ravel())
        left = noise.ravel() - estimate @ rows
        seen = observed(left)
        tangent = Tangent(np.zeros(SIZE * SIZE), rows, np.ones(2))
        slope = slope_covariance(tangent, left, 1.0, seen)
        covariance, growth = widened(np.linalg.inv(gram), slope, np.ones(2, bool))
        quoted.append(np.diag(covariance))
        found.append(estimate**2)
        grown.append(growth)
    ratio = np.mean(quoted, 0) / np.mean(found, 0)
    # A variance from 60 draws is known to 18%.
    assert (ratio > 0.6).all(), ratio
    assert (ratio < 1.9).all(), ratio
    assert np.median(grown) > 1 + 2 * blur


def test_held_coordinates_stay_held():
    covariance = np.diag([1.0, 0.0])
    out, growth = widened(covariance, np.diag([4.0, 9.0]), np.array([True, False]))
    np.testing.assert_allclose(out, np.diag([4.0, 0.0]))
    assert growth == pytest.approx(4.0)
    same, growth = widened(covariance, np.diag([0.1, 0.1]), np.array([True, True]))
    np.testing.assert_allclose(same, covariance)
    assert growth == 1.0


def test_repeated_lines_are_counted_once():
    column = np.tile(np.arange(16, dtype=np.float32)[:, None], (1, 16))
    grey = column[..., None]
    line = Picture(grey, 0.5, np.ones((16, 16), bool), column / 16, None, "none")
    assert line.repeats == 16
    assert is_a_line(line)
    empty = np.zeros((16, 16, 1), np.float32)
    empty[13:] = 255 * np.random.default_rng(1).random((3, 16, 1))
    partly = Picture(empty, 0.5, np.ones((16, 16), bool), np.zeros((16, 16)), None, "none")
    assert partly.repeats > 1
    assert not is_a_line(partly)
    other = np.random.default_rng(0).random((16, 16)).astype(np.float32)
    assert Picture(grey, 0.5, np.ones((16, 16), bool), other, None, "none").repeats == 1

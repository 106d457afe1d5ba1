"""Noise by the arithmetic of a GPU: against a loop over taps in that arithmetic."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from godfit import InputError, fit, read_image, write_image
from godfit.inference.allowances.arithmetic import (
    FRACTION_ROUNDING,
    squared_slopes,
    squared_sum,
    walk_variances,
    with_arithmetic,
)
from godfit.inference.allowances.mask_rounding import (
    TEXEL_VARIANCE,
    pull_covariance,
    rounded_texels,
)
from godfit.inference.noise import SIGMAS, noise_of
from godfit.inference.observation import EXACT, GPU, Picture
from godfit.inference.problem import Problem
from godfit.io.sidecar import read_sidecar
from godfit.io.sources import read_source
from godfit.models.mitchell import Mitchell
from godfit.models.tinted import TintedMask
from tests.support import gpu_walk, random_targets, scattering_oracle

SHADER, SIZE = "dawntime", (72, 96)
TRUTH = {
    "exposure": 0.06, "decay": 0.97, "density": 0.85, "weight": 0.7, "light_x": 0.431,
    "light_y": 0.617, "samples": 60,
}  # fmt: skip
LIGHT = TRUTH["light_x"], TRUTH["light_y"]
NUMBERS = [TRUTH[name] for name in ("exposure", "decay", "density", "weight")]


def mask(size=SIZE):
    """Bytes over 255: a disc behind bars."""
    rng = np.random.default_rng(0)
    u, v = scattering_oracle.pixel_centres(*size)
    drawn = 0.07 + 0.93 * (np.hypot(u - LIGHT[0], (v - LIGHT[1]) * 0.75) < 0.16)
    for _ in range(7):
        angle, at = rng.uniform(0, np.pi), rng.uniform(-0.5, 0.5)
        drawn[np.abs((u - 0.5) * np.cos(angle) + (v - 0.5) * np.sin(angle) - at) < 0.02] = 0
    return np.round(drawn * 255) / 255


def model(**changes):
    return dataclasses.replace(Mitchell(*NUMBERS, LIGHT, SHADER, TRUTH["samples"]), **changes)


def by_light():
    """(h, w, 2) derivatives of the light pass by the light."""
    at = model()

    def image(light):
        return dataclasses.replace(at, light=light[None]).light_pass(jnp.asarray(mask()))

    return np.asarray(jax.jacfwd(image)(at.light[0]))


def test_the_walk_without_rounding_is_the_formula():
    walked = gpu_walk.walk(mask(), SHADER, TRUTH, dtype=np.float64)
    expected = scattering_oracle.light_pass(mask(), SHADER, *NUMBERS, LIGHT, TRUTH["samples"])
    np.testing.assert_allclose(walked, expected, atol=1e-12)


def test_columns_and_rows_of_a_walk_have_lights_of_their_own():
    walked = gpu_walk.walk(mask(), SHADER, TRUTH)
    off = walked - gpu_walk.walk(mask(), SHADER, TRUTH, dtype=np.float64)
    u, v = scattering_oracle.pixel_centres(*SIZE)
    settings = TRUTH["density"], TRUTH["samples"], TRUTH["samples"] - 1
    across = gpu_walk.drifts(u[0], LIGHT[0], *settings)
    down = gpu_walk.drifts(v[:, 0], LIGHT[1], *settings)
    slopes = by_light()
    explained = slopes[..., 0] * across[None] + slopes[..., 1] * down[:, None]
    assert ((off - explained) ** 2).sum() < 0.1 * (off**2).sum()
    # And the noise that a fit allows for is of the size of these displacements.
    one = problem(random_targets.to_bytes(walked), GPU)
    whole = one.picture.observe(np.arange(walked.size))
    expected = walk_variances(whole, np.array([LIGHT]), model().walk).reshape(2, *SIZE)
    for found, allowed in ((across, expected[0, 0]), (down, expected[1, :, 0])):
        assert 0.4 < np.mean(found**2) / np.mean(allowed) < 1.3
    assert np.ptp(expected[0], 0).max() == np.ptp(expected[1], 1).max() == 0


def test_drifts_are_of_the_grid_along_the_way():
    """Between a quarter and a half float32's grid has half the spacing that it has above."""
    one = problem(np.zeros(SIZE, np.uint8), GPU)
    whole = one.picture.observe(np.arange(SIZE[0] * SIZE[1]))
    unit = (2.0**-24 * TRUTH["samples"] / TRUTH["density"]) ** 2 / 12
    lights = np.array([[0.3, 0.3], [0.9, 0.9]])
    low, lower, high, higher = walk_variances(whole, lights, model().walk).reshape(4, *SIZE)
    np.testing.assert_allclose(low[0, 30:48], unit / 4, rtol=1e-5)
    np.testing.assert_allclose(high[0, 48:], unit, rtol=1e-5)
    # Texture coordinates point up.
    np.testing.assert_allclose(lower[37:50, 0], unit / 4, rtol=1e-5)
    np.testing.assert_allclose(higher[:36, 0], unit, rtol=1e-5)


@pytest.mark.parametrize("fractions", [None, 256])
def test_the_likelier_arithmetic_is_allowed_for(fractions, single_precision):
    target = random_targets.to_bytes(gpu_walk.walk(mask(), SHADER, TRUTH, fractions))
    one = problem(target, GPU)
    whole = one.picture.observe(np.arange(target.size))
    z = np.asarray(model().coordinates(), np.float32)
    found = np.asarray(with_arithmetic(whole, one, z).own_noise)
    slopes = squared_slopes(jnp.asarray(mask()))
    rounded = 255 * FRACTION_ROUNDING * np.sqrt(np.asarray(squared_sum(model(), slopes, None)))
    # What rounded fractions add is well above the rest, or is not there.
    some = rounded.ravel() > np.median(rounded)
    share = np.mean(found[some] > 0.9 * rounded.ravel()[some])
    assert share < 0.5 if fractions is None else share > 0.95


def test_own_noise_stands_for_the_least_common_noise():
    own = np.array([1e-4, 3.0], np.float32)
    np.testing.assert_allclose(noise_of(SIGMAS[0], own), own, rtol=1e-6)
    np.testing.assert_allclose(noise_of(np.float32(4), own), np.hypot(4, own), rtol=1e-5)
    assert noise_of(SIGMAS[0], None) == SIGMAS[0]


def test_fractions_of_a_texel_are_off_by_the_slopes_of_the_mask():
    exact, rounded = (
        gpu_walk.walk(mask(), SHADER, TRUTH, fractions=f, dtype=np.float64) for f in (None, 256)
    )
    variance = FRACTION_ROUNDING**2 * squared_sum(
        model(), squared_slopes(jnp.asarray(mask())), None
    )
    measured = np.mean((rounded - exact) ** 2)
    assert 0.6 * measured < float(np.mean(variance)) < 2 * measured


def test_squared_slopes_are_those_of_the_interpolated_mask():
    """Over a texel and both its neighbours' halves, each axis has the mean of two squares."""
    image = np.random.default_rng(0).random((5, 6))
    found = np.asarray(squared_slopes(jnp.asarray(image)))
    down, along = np.diff(image, axis=0) ** 2, np.diff(image, axis=1) ** 2
    for i in range(5):
        for j in range(6):
            parts = [down[i - 1, j] if i else 0, down[i, j] if i < 4 else 0]
            parts += [along[i, j - 1] if j else 0, along[i, j] if j < 5 else 0]
            assert found[i, j] == pytest.approx(sum(parts) / 2)


def problem(target, arithmetic, **held):
    picture = Picture.make(read_source(target, "none"), mask().astype(np.float32), None, None)
    picture = dataclasses.replace(picture, arithmetic=arithmetic)
    names = list(model().parameters)
    fixed = np.array([held.get(name, np.nan) for name in names], np.float32)
    return Problem(model(), picture, np.isnan(fixed), fixed)


def test_noise_does_not_depend_on_what_is_held(single_precision):
    target = random_targets.to_bytes(gpu_walk.walk(mask(), SHADER, TRUTH))
    z = np.asarray(model().coordinates(), np.float32)
    noise = []
    for held in ({}, {"light_x": LIGHT[0], "light_y": LIGHT[1]}):
        one = problem(target, GPU, **held)
        whole = one.picture.observe(np.arange(target.size))
        noise.append(np.asarray(with_arithmetic(whole, one, z).own_noise))
        exact = one.replaced(picture=dataclasses.replace(one.picture, arithmetic=EXACT))
        assert with_arithmetic(whole, exact, z).own_noise is None
    np.testing.assert_allclose(*noise, rtol=1e-3, atol=1e-7)
    drifts = walk_variances(whole, np.array([LIGHT]), model().walk)
    lower = 255 * np.sqrt((drifts.T * by_light().reshape(-1, 2) ** 2).sum(1))
    # At kinks of the mask single precision may take the other slope.
    assert np.mean(noise[0] >= 0.999 * lower) > 0.99


@pytest.mark.parametrize("held", [False, True])
def test_a_coloured_light_has_the_noise_of_each_channel(held, single_precision):
    walked = gpu_walk.walk(mask(), SHADER, TRUTH, fractions=256)
    tint = np.array([0.5, 0.25])
    coloured = random_targets.to_bytes(walked[..., None] * [tint[0], 1, tint[1]])
    grey = problem(random_targets.to_bytes(walked), GPU)
    picture = Picture.make(read_source(coloured, "none"), grey.picture.mask, None, None, 3)
    picture = dataclasses.replace(picture, arithmetic=GPU)
    lit = TintedMask(model(), tint)
    fixed = np.full(len(lit.parameters), np.nan, np.float32)
    if held:
        fixed[4:6] = LIGHT
    noise = []
    for one in (grey, Problem(lit, picture, np.isnan(fixed), fixed)):
        whole = one.picture.observe(np.arange(walked.size))
        z = np.asarray(one.model.coordinates(), np.float32)
        noise.append(np.asarray(with_arithmetic(whole, one, z).own_noise))
    # The channels share one draw, which counts three times.
    expected = np.sqrt(3) * noise[0][:, None] * [tint[0], 1, tint[1]]
    some = noise[0] > np.median(noise[0])
    np.testing.assert_allclose(noise[1].reshape(-1, 3)[some], expected[some], rtol=0.02)


def test_errors_hold_where_the_target_walked(single_precision, tmp_path):
    # The size of most fits of the tests: their programs serve.
    drawn = mask((96, 96))
    image = gpu_walk.walk(drawn, SHADER, TRUTH, fractions=256)
    options = {"mask": drawn, "shader": SHADER, "samples": TRUTH["samples"], "pass_scale": 1.0}
    result = fit(random_targets.to_bytes(image), **options)
    assert (result.converged, result.record()["arithmetic"]) == (True, "gpu")
    off = {n: (e.value - TRUTH[n]) / e.stderr for n, e in result.params.items()}
    assert max(map(abs, off.values())) < 4, off
    # What this program renders says that it is exact, in any folder.
    write_image(tmp_path / "t.png", image, exact=True)
    stored = read_image(tmp_path / "t.png")
    exact = fit(stored, **options)
    assert (stored.exact, exact.record()["arithmetic"]) == (True, "exact")
    write_image(tmp_path / "t.png", image)
    assert not read_image(tmp_path / "t.png").exact


def test_arithmetic_is_named(tmp_path):
    with pytest.raises(InputError, match="expected gpu or exact, got 'fixed'"):
        fit(np.zeros((8, 8), np.uint8), mask=np.ones((8, 8)), arithmetic="fixed")
    (tmp_path / "x.toml").write_text('[scattering]\narithmetic = "exact"\n')
    assert read_sidecar(str(tmp_path / "x.png"))["arithmetic"] == "exact"


def test_texels_of_one_flat_value_err_together():
    rng = np.random.default_rng(0)
    drawn = rng.integers(1, 255, (5, 6)) / 255
    drawn[:3, :3] = 100 / 255
    drawn[4, 5] = 1
    variance = np.where(drawn < 1, TEXEL_VARIANCE, 0)
    slopes = rng.standard_normal((2, 5, 6))
    expected, together = np.zeros((2, 2)), np.zeros(2)
    for i in range(5):
        for j in range(6):
            if i < 2 and j < 2:
                together += slopes[:, i, j]
            else:
                expected += variance[i, j] * np.outer(slopes[:, i, j], slopes[:, i, j])
    expected += TEXEL_VARIANCE * np.outer(together, together)
    np.testing.assert_allclose(pull_covariance(drawn, variance, slopes), expected)


def test_masks_of_bytes_are_rounded_where_the_pass_read_half_floats():
    values = np.array([[0, 0, 0], [0, 0, 0.5], [1, 1, 100 / 255]], np.float32)
    target = read_source(np.zeros((3, 3), np.uint8), "none")

    def variances(shader, mask, arithmetic=GPU):
        picture = dataclasses.replace(Picture.make(target, mask, None, None), arithmetic=arithmetic)
        return rounded_texels(picture, model(shader=shader))

    grey = np.round(values * 255) / 255
    known = variances("pmndrs", grey)
    # Black and white next to grey may be the end of a blur.
    np.testing.assert_array_equal(known > 0, [[0, 1, 1], [0, 1, 1], [0, 1, 1]])
    assert variances("dawntime", grey) is None
    assert variances("pmndrs", grey, EXACT) is None
    assert variances("pmndrs", np.round(values)) is None
    # A mask of floats is known as it is.
    assert variances("pmndrs", values + np.float32(0.1 / 255)) is None

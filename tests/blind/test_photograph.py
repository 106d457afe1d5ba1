"""A photograph: rays of all that is bright in it, and nothing given with it."""

import jax.numpy as jnp
import numpy as np
import pytest

import godfit
from godfit.blind.photograph import _between, _unlit
from godfit.errors import InputError
from godfit.models.bright_pass import LUMA, BrightPass, brightness
from godfit.models.mitchell import Mitchell
from tests.support.synthetic import photographs

SHADER, taken = photographs.PHOTOGRAPH_SHADER, photographs.make_photograph

SIZE = (135, 240)


@pytest.fixture(scope="module")
def photograph():
    return taken(2, SIZE)


def fitted(image, samples, **settings):
    return godfit.fit(image, bright_pass=True, shader=SHADER, samples=int(samples), **settings)


def test_light_and_shader_are_read_off_a_photograph(photograph):
    truth, samples = photograph.truth, photograph.truth["samples"]
    result = fitted(photograph.image, samples)
    params = result.params
    assert result.converged
    assert abs(params["light_x"].value - truth["light_x"]) < 0.002
    assert abs(params["light_y"].value - truth["light_y"]) < 0.002
    assert abs(params["density"].value - truth["density"]) < 0.01
    ratio = params["decay"].value / truth["decay"]
    assert abs(ratio**samples - 1) < 0.1
    for name in ("light_x", "light_y", "density", "decay"):
        assert abs(params[name].value - truth[name]) < 3 * params[name].stderr
    # The mask of the report, as hard as it may be: the same is bright.
    found = np.asarray(result.model.occlusion(jnp.asarray(result.picture.mask)))
    assert np.mean((found > 0.5) != (photograph.mask > 0.5)) < 0.02


def test_a_picture_without_dark_parts_is_refused():
    with pytest.raises(InputError, match="bright pass: expected at least 500 pixels"):
        fitted(np.full((96, 128, 3), 200, np.uint8), 30)


def test_a_bright_pass_goes_with_nothing_else(photograph):
    mask = np.ones(SIZE, np.uint8)
    with pytest.raises(InputError, match="expected no mask"):
        fitted(photograph.image, 60, mask=mask)
    with pytest.raises(InputError, match="occluder: expected none with --bright-pass"):
        fitted(photograph.image, 60, occluder=mask)


def test_brightness_is_luma():
    pixel = np.array([[[0.2, 0.5, 0.9]]])
    np.testing.assert_allclose(brightness(pixel), [[0.2 * LUMA[0] + 0.5 * LUMA[1] + 0.9 * LUMA[2]]])
    np.testing.assert_allclose(sum(LUMA), 1)
    assert brightness(np.full((2, 3, 1), 0.7)).shape == (2, 3)


def test_a_bright_pass_is_half_at_its_threshold():
    shading = Mitchell(0.1, 0.98, 0.8, 0.7, [0.5, 0.6], "dawntime", 20)
    model = BrightPass(shading, [0.6, 0.05, 0.0], np.zeros((1, 3)), 0.4)
    mask = np.asarray(model.occlusion(jnp.array([[0.0, 0.55, 0.6, 0.65, 1.0]])))
    np.testing.assert_allclose(mask[0, 2], 0.5)
    np.testing.assert_allclose(mask[0, 1], 1 / (1 + np.e), rtol=1e-6)
    np.testing.assert_allclose(mask[0, 1] + mask[0, 3], 1)
    assert mask[0, 0] < 1e-4
    assert mask[0, 4] > 0.999
    lower, upper = model.bounds()
    assert lower[6] == 0.4
    # What is let through of the dark is not told from a background.
    assert (lower[8], upper[8]) == (0, 0)
    assert not model.used[8]


def test_rays_are_taken_off_the_picture_that_they_are_of():
    shading = Mitchell(0.1, 0.98, 0.8, 0.7, [0.5, 0.6], "dawntime", 20)
    scene = np.random.default_rng(1).uniform(0, 100, (6, 8, 3)).astype(np.float32)
    light = np.random.default_rng(2).uniform(0, 0.5, (6, 8)).astype(np.float32)
    model = BrightPass(shading, [0.6, 0.05, 0.0], np.zeros((1, 3)))
    np.testing.assert_allclose(
        _unlit(model, scene + 255 * light[..., None], light), scene, atol=1e-3
    )
    screened = Mitchell(0.1, 0.98, 0.8, 0.7, [0.5, 0.6], "pmndrs", 20)
    model = BrightPass(screened, [0.6, 0.05, 0.0], np.zeros((1, 3)))
    light = light[..., None]
    np.testing.assert_allclose(
        _unlit(model, scene + 255 * light - scene * light, light[..., 0]), scene, atol=1e-3
    )


def test_dark_and_bright_are_told_apart_between_them():
    rng = np.random.default_rng(0)
    values = np.concatenate([rng.normal(0.2, 0.03, 3000), rng.normal(0.8, 0.05, 1000)])
    between = _between(values)
    assert values[:3000].max() < between < values[3000:].min()

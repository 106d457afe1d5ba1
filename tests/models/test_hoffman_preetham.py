"""Hoffman and Preetham behind occluders: image against formulas, derivatives, fit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import godfit
from godfit.models.atmosphere import Air
from godfit.models.hoffman_preetham import HoffmanPreetham, View
from tests.support import daylight_targets, random_targets
from tests.support.compiling import quick_filter_jit, quick_jit

# The size of studies/test_compare.py, whose programs these fits share.
SIZE, SAMPLES = 96, daylight_targets.SAMPLES


def model_of(view, truth):
    air = Air(truth["turbidity"], truth["g"], truth["e_sun"], truth["scale"])
    light = (truth["light_x"], truth["light_y"])
    return HoffmanPreetham(air, light, View(view["distance"], view["fov"]), SAMPLES)


@quick_filter_jit
def render(model, *images, **options):
    return model(*images, **options)


@pytest.mark.parametrize("kind", daylight_targets.KINDS)
def test_image_is_that_of_the_formulas(kind):
    view, image, truth = daylight_targets.draw(3, kind, SIZE)
    found = render(model_of(view, truth), jnp.asarray(view["mask"]))
    np.testing.assert_allclose(found, image, rtol=1e-6, atol=1e-6 * image.max())


def test_some_pixels_are_those_of_the_whole_image():
    view, _, truth = daylight_targets.draw(4, "bars", SIZE)
    model, mask = model_of(view, truth), jnp.asarray(view["mask"])
    back = jnp.asarray(np.random.default_rng(0).uniform(0, 0.5, mask.shape))
    pixels = jnp.array([0, 17, 4000, SIZE**2 - 1])
    whole = render(model, mask, back).reshape(-1, 3)
    some = render(model, mask, back, pixels=pixels)
    np.testing.assert_allclose(some, whole[pixels], rtol=1e-9)


def test_background_is_seen_through_the_air():
    view, _, truth = daylight_targets.draw(4, "bars", SIZE)
    model, mask = model_of(view, truth), jnp.ones((8, 8))
    lit = render(model, mask, jnp.full((8, 8), 0.5)) - render(model, mask)
    # Distances are read from the nearest of their own pixels.
    each = np.arange(8) * (SIZE // 8)
    away = np.asarray(view["distance"])[each][:, each]
    np.testing.assert_allclose(lit, 0.5 * model.air.transmitted(jnp.asarray(away)), rtol=1e-6)


def test_upsampled_pass_keeps_full_distances():
    view, _, truth = daylight_targets.draw(5, "ridges", SIZE)
    model = model_of(view, truth)
    # Through an open mask the light depends on nothing but the distance.
    upsampled = np.asarray(render(model, jnp.ones((SIZE // 2, SIZE // 2)), size=(SIZE, SIZE)))
    whole = render(model, jnp.ones((SIZE, SIZE)))
    np.testing.assert_allclose(upsampled, whole, rtol=1e-9)
    low = np.repeat(np.repeat(view["distance"][::2, ::2], 2, axis=0), 2, axis=1)
    assert (low != view["distance"]).any()


def test_derivatives_are_those_of_differences():
    view, _, truth = daylight_targets.draw(6, "ridges", SIZE)
    model = model_of(view, truth)
    mask = jnp.asarray(np.random.default_rng(1).uniform(0, 1, (24, 24)))
    weights = jnp.asarray(np.random.default_rng(2).standard_normal((24, 24, 3)))

    def of_values(z):
        return (weights * model.moved(z)(mask)).sum()

    mean, z = quick_jit(of_values), model.coordinates()
    slope = quick_jit(jax.grad(of_values))(z)
    forward = quick_jit(jax.jacfwd(of_values))(z)
    np.testing.assert_allclose(slope, forward, rtol=1e-9)
    for i in range(6):
        # A bilinear mask has kinks in the light: its step is smaller than their distance.
        way = jnp.zeros(6).at[i].set((1e-7 if i > 3 else 1e-4) * max(float(z[i]), 0.1))
        one, two = (float(mean(z + k * way) - mean(z - k * way)) for k in (1, 2))
        difference = (8 * one - two) / (12 * float(way[i]))
        assert float(slope[i]) == pytest.approx(difference, rel=1e-5)


def test_coordinates_and_parameters_are_one_to_one():
    view, _, truth = daylight_targets.draw(7, "blocks", SIZE)
    model = model_of(view, truth)
    again = model.moved(model.coordinates() * 0 + 0.3).moved(model.coordinates())
    for name, value in model.values().items():
        assert float(again.values()[name]) == pytest.approx(float(value), rel=1e-9)
    held = jnp.array([2.0, 700.0, 3.0, 0.4, 0.1, 0.2])
    for name, value in zip(model.parameters, held, strict=True):
        found = model.moved(model.coordinates(), held).values()[name]
        assert float(found) == pytest.approx(float(value))


@pytest.mark.parametrize(
    ("seed", "kind", "noise"), [(0, "ridges", 0.0), (1, "bars", 1.0), (2, "blocks", 1.0)]
)
def test_truth_is_found_from_its_own_bytes(seed, kind, noise):
    found, converged, scores, words = daylight_targets.attempt(seed, kind, noise, SIZE)
    assert found, words
    assert converged, words
    assert np.nanmax(np.abs(scores)) < 4.5, words


def test_thin_air_leaves_irradiance_and_scale_open():
    # At fewer pixels the error of the scale is as large as the scale itself, and is still one.
    view, _, truth = daylight_targets.draw(8, "ridges")
    per_metre = truth["scale"]
    image = daylight_targets.radiance64(truth | {"scale": per_metre * 1e-4}, view)
    image *= 0.9 / image.max()
    result = godfit.fit(
        random_targets.to_bytes(image, 1.0, 0), mask=view["mask"], model="hoffman-preetham",
        fov=view["fov"], distance=view["distance"], samples=SAMPLES,
    )  # fmt: skip
    assert result.params["scale"].stderr is None
    assert result.params["e_sun"].stderr is None
    assert any("scale*e_sun is determined" in words for words in result.undetermined)
    assert result.params["g"].value == pytest.approx(truth["g"], abs=0.02)


def test_a_grey_picture_has_three_channels():
    view, image, _ = daylight_targets.draw(1, "bars", SIZE)
    grey = random_targets.to_bytes(image.mean(-1))
    result = godfit.fit(
        grey, mask=view["mask"], model="hoffman-preetham", fov=60.0, distance=1.0, samples=SAMPLES
    )
    assert result.picture.channels == 3
    assert result.render().shape == (SIZE, SIZE, 3)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"model": "hofman"}, "did you mean 'hoffman-preetham'"),
        ({"model": "mitchell", "fov": 60.0}, "fov: expected --model hoffman-preetham"),
        ({"fov": 180.0}, "fov: expected degrees above 0 and below 180, got 180"),
        ({"distance": -1.0}, "distance: expected a finite number above 0"),
        ({"distance": np.zeros((3, 3))}, "distance: expected a finite number above 0"),
        ({"shader": "dawntime"}, "shader: expected none with the model hoffman-preetham"),
        ({"lights": 2}, "lights: expected none"),
        ({"samples": 1}, "samples: expected a whole number from 2"),
        ({"fix": {"turbidity": 0.9}}, "expected turbidity from 0.995 to 64, got 0.9"),
        ({"fix": {"density": 0.9}}, "expected one of e_sun, scale, turbidity, g"),
    ],
)
def test_what_does_not_go_together_is_refused(options, words):
    target, mask = np.zeros((8, 8), np.uint8), np.ones((8, 8))
    with pytest.raises(godfit.InputError, match=words):
        godfit.fit(target, mask=mask, **({"model": "hoffman-preetham"} | options))

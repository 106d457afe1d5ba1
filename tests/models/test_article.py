"""The article's listings, written out line by line, against the conventions that bear their names.

A listing goes over every pixel at once: ``tc`` holds the texture coordinates of all of them.
"""

import jax.numpy as jnp
import numpy as np
import pytest

from godfit.models.mitchell import Mitchell
from tests.support import scattering_oracle as oracle

MASK = oracle.smooth_mask(11, 13)
SCENE = np.random.default_rng(1).random((11, 13))
LIGHT = (0.3, 0.8)
GLSL = {"decay": 0.96815, "exposure": 0.2, "density": 0.926, "weight": 0.58767}
HLSL = {"decay": 0.97815, "exposure": 0.92, "density": 0.966, "weight": 0.58767}
NUM_SAMPLES = 100


def listing(tex2d, tc, light, numbers):
    """The loop that the GLSL and the HLSL listing share; ``exposure`` comes after it."""
    delta_tex_coord = tc - np.reshape(light, (2, 1, 1))
    delta_tex_coord = delta_tex_coord * (1.0 / NUM_SAMPLES * numbers["density"])
    illumination_decay = 1.0
    color = tex2d(MASK, tc) * 0.4
    for _ in range(NUM_SAMPLES):
        tc = tc - delta_tex_coord
        sample = tex2d(MASK, tc) * 0.4
        sample = sample * (illumination_decay * numbers["weight"])
        color = color + sample
        illumination_decay *= numbers["decay"]
    return color


def v_up(image, tc):
    return oracle.texture(image, tc[0], tc[1])


def v_down(image, tc):
    return oracle.texture(image, tc[0], 1 - tc[1])


def fitted(shader, light=LIGHT, background=None, **numbers):
    model = Mitchell(**numbers, light=light, shader=shader, samples=NUM_SAMPLES)
    back = None if background is None else jnp.asarray(background)
    return np.asarray(model(jnp.asarray(MASK), back))


def agree(actual, expected):
    np.testing.assert_allclose(actual, expected, rtol=1e-12)


def test_the_first_listing_applies_no_exposure():
    """It is ``mitchell`` at an exposure of .4, without a background."""
    color = listing(v_up, np.stack(oracle.pixel_centres(11, 13)), LIGHT, GLSL)
    agree(fitted("mitchell", **GLSL | {"exposure": 0.4}), color)


def test_the_second_listing_adds_the_scene_as_it_is():
    """It is ``mitchell`` at an exposure of .4 on the background."""
    color = listing(v_up, np.stack(oracle.pixel_centres(11, 13)), LIGHT, GLSL)
    agree(fitted("mitchell", background=SCENE, **GLSL | {"exposure": 0.4}), SCENE + color)


def test_the_last_line_is_the_convention():
    tc = np.stack(oracle.pixel_centres(11, 13))
    color = listing(v_up, tc, LIGHT, GLSL)
    expected = color * GLSL["exposure"] + v_up(SCENE, tc) * 1.1
    agree(fitted("article-glsl", background=SCENE, **GLSL), expected)


def test_the_hlsl_listing_is_the_convention_with_v_down():
    """The light is where it is on the screen; its v is counted from the top."""
    u, v = oracle.pixel_centres(11, 13)
    tc = np.stack([u, 1 - v])
    color = listing(v_down, tc, (LIGHT[0], 1 - LIGHT[1]), HLSL)
    expected = color * HLSL["exposure"] + v_down(SCENE, tc) * 1.1
    agree(fitted("article-hlsl", background=SCENE, **HLSL), expected)


@pytest.mark.parametrize(("shader", "numbers"), [("article-glsl", GLSL), ("article-hlsl", HLSL)])
def test_several_lights_are_a_sum_over_the_loop(shader, numbers):
    """What the listing of several lights means: hoisted out of its loop, with += for its =, and
    exposure applied as in the last line."""
    lights = [LIGHT, (0.9, 0.1)]
    tc = np.stack(oracle.pixel_centres(11, 13))
    total = sum(listing(v_up, tc, light, numbers) for light in lights)
    agree(fitted(shader, light=lights, **numbers), total * numbers["exposure"])

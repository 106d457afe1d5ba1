"""Radiance cascades against the distance march of many rays."""

import jax
import numpy as np
import pytest

from godfit.flatland import Sky, canvas, render
from godfit.flatland import cascades as ways
from tests.support import flatland_oracle as oracle
from tests.support.compiling import quick_filter_jit, quick_jit

SKY = Sky(70.0, 50.0, (0.9, 0.8, 0.5), (0.1, 0.2, 0.4))


rendered = quick_filter_jit(render)
cascades = quick_jit(ways.cascades, static_argnames=("rays", "spacing"))


def rms(found, exact):
    return np.sqrt(np.mean((found - exact) ** 2) / np.mean(exact**2))


@pytest.mark.parametrize("size", [(48, 64), (64, 40), (1, 50), (1, 1), (37, 1)])
def test_nothing_drawn_is_the_mean_of_the_sky(size):
    found = np.asarray(cascades(canvas(np.zeros((*size, 3)), np.zeros(size)), SKY))
    mean = np.asarray(SKY.sky) + np.asarray(SKY.sun) * 50 / 360
    np.testing.assert_allclose(found, np.broadcast_to(mean, found.shape), rtol=1e-9)


def test_more_rays_are_nearer_to_the_march():
    size = (48, 64)
    made = canvas(*oracle.random_canvas(size, 3, share=0.01, partial=False))
    exact = np.asarray(rendered(made, SKY, rays=1024))
    clear = (1 - np.asarray(made.opacity))[..., None]
    errors = [
        rms(np.asarray(made.radiance + clear * cascades(made, SKY, rays=rays)), exact)
        for rays in (4, 16)
    ]
    one = rendered(made, SKY, rays=4, method="cascades")
    assert rms(np.asarray(one), exact) == pytest.approx(errors[0])
    assert errors[0] < 0.08
    assert errors[1] < 0.5 * errors[0]


def test_light_does_not_leak_through_a_wall():
    """The ordinary interpolation lets it: behind a closed box it is dark."""
    opacity = np.zeros((64, 64))
    opacity[20:44, 20] = opacity[20:44, 43] = opacity[20, 20:44] = opacity[43, 20:44] = 1
    made = canvas(np.zeros((64, 64, 3)), opacity)
    sky = Sky(90.0, 60.0, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    inside = np.asarray(cascades(made, sky, rays=8))[21:43, 21:43]
    assert inside.max() < 1e-12


def test_probes_apart_are_read_between():
    made = canvas(*oracle.random_canvas((50, 66), 4, share=0.005, partial=False))
    exact = np.asarray(rendered(made, SKY, rays=1024))
    clear = np.asarray(made.opacity) == 0
    found = np.asarray(cascades(made, SKY, rays=8, spacing=2.0))
    assert found.shape == (50, 66, 3)
    assert rms(found[clear], exact[clear]) < 0.2


def test_single_precision_agrees(single_precision):
    radiance, opacity = oracle.random_canvas((40, 40), 5, share=0.01, partial=False)
    found = np.asarray(cascades(canvas(radiance, opacity), Sky(), rays=8))
    with jax.enable_x64(True):
        exact = np.asarray(cascades(canvas(radiance, opacity), Sky(), rays=8))
    assert rms(found, exact) < 1e-2

"""The part of a mask about a disc: what is summed of it, and of the whole, is the same."""

import jax.numpy as jnp
import numpy as np
import pytest

from godfit.disc import DiscLight
from godfit.models import Mitchell
from godfit.upsample import columns_rows
from godfit.window import Window

SIZE = (120, 200)


def model_at(light, radius=0.1, edge=0.002, cut=1):
    shading = Mitchell(0.3, 0.97, 0.8, 0.7, [light], "dawntime", 60)
    return DiscLight(shading, [radius, edge, 0.06], np.zeros((1, 1)), (), cut)


def mask_and_points():
    rng = np.random.default_rng(0)
    mask = (rng.uniform(size=SIZE) < 0.8) * rng.uniform(0.7, 1.3, SIZE)
    pixels = np.sort(rng.choice(SIZE[0] * SIZE[1], 500, replace=False))
    return jnp.asarray(mask), columns_rows(jnp.asarray(pixels), SIZE[1], float)


@pytest.mark.parametrize(
    ("light", "cut"),
    [
        ((0.5137, 0.4921), 1),
        ((0.0213, 0.6031), 2),
        ((1.05, 0.9), 1),
        ((0.4011, -0.1013), 2),
        ((-0.5, 2.0), 1),
    ],
)
def test_a_window_and_the_whole_make_the_same_light(light, cut):
    """And the same derivatives: of lights amid the picture, at its border, and far from it."""
    model, (mask, at) = model_at(light, cut=cut), mask_and_points()
    found = model._in_a_window(mask, at, "reference", True)
    for part, whole in zip(found, model._of_the_whole(mask, at, "reference", True), strict=True):
        size = np.abs(whole).max()
        assert size > 0
        np.testing.assert_allclose(part, whole, atol=1e-12 * size)


@pytest.mark.parametrize(("radius", "edge"), [(0.4, 0.002), (0.1, 0.1)], ids=["large", "soft"])
def test_a_disc_that_no_window_holds_is_summed_whole(radius, edge):
    model, (mask, at) = model_at((0.5137, 0.4921), radius, edge), mask_and_points()
    whole = model._of_the_whole(mask, at, "reference", True)
    cut_off = model._in_a_window(mask, at, "reference", True)
    assert np.abs(cut_off[0] - whole[0]).max() > 1e-3 * np.abs(whole[0]).max()
    for found, right in zip(model._summed(mask, at, "reference", True), whole, strict=True):
        np.testing.assert_allclose(found, right, rtol=1e-12, atol=1e-12 * np.abs(right).max())


def test_a_window_lies_within_the_picture_and_is_dark_where_it_goes_on():
    window = Window.about(jnp.array([0.99, 0.5]), SIZE)
    rows, columns = window.shape
    assert window.corner[1] + columns == SIZE[1]
    part = np.asarray(window.dark_around(jnp.ones(window.shape)))
    assert not part[[0, -1]].any()
    assert not part[:, 0].any()
    assert (part[1:-1, -1] == 1).all()
    mask = jnp.arange(SIZE[0] * SIZE[1], dtype=float).reshape(SIZE)
    top, left = (int(n) for n in window.corner)
    np.testing.assert_array_equal(window.cut(mask), mask[top : top + rows, left : left + columns])

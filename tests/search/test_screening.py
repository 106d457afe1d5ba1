"""Where the search begins, and on which pixels."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from godfit.inference.observation import Picture
from godfit.io.filters import blurred, blurred_at
from godfit.models.mitchell import Mitchell
from godfit.models.tinted import TintedMask
from godfit.runtime.parallel import map_halves
from godfit.search.screening import (
    _solve,
    _View,
    distinct_starts,
    light_grid,
    mitchell_starts,
    tinted_starts,
)


@pytest.mark.parametrize("sigma", [0.3, 1.0, 3.0, 40.0])
def test_a_blur_is_the_same_at_some_pixels(sigma):
    image = np.random.default_rng(0).uniform(0, 255, (23, 31, 2)).astype(np.float32)
    pixels = np.array([0, 30, 31, 200, 23 * 31 - 1])
    whole = blurred(image, sigma).reshape(-1, 2)
    np.testing.assert_allclose(blurred_at(image, sigma, pixels), whole[pixels], atol=1e-3)
    # A mean of what is there.
    assert image.min() <= whole.min() <= whole.max() <= image.max()
    assert (whole.std() < image.std()) == (sigma >= 1)


def test_informative_pixels_are_valid_and_lie_where_the_target_varies():
    levels = np.zeros((100, 200, 1), np.float32)
    levels[:, 100:120] = 10 * np.arange(20)[None, :, None]
    valid = np.ones((100, 200), bool)
    valid[50:] = False
    picture = Picture(levels, 0.5, valid, valid * 1.0, None, "none")
    chosen = picture.informative(400, 3)
    assert len(np.unique(chosen)) == 400
    assert valid.reshape(-1)[chosen].all()
    among = (chosen % 200 >= 98) & (chosen % 200 < 122)
    assert 200 <= np.count_nonzero(among) < 260
    assert np.array_equal(picture.informative(10_000, 3), np.flatnonzero(valid))


@pytest.mark.parametrize("other", [0, 255], ids=["one", "both"])
def test_informative_pixels_lie_where_any_channel_is_not_clipped(other):
    """Beside a channel that is clipped, one that varies, or is clipped too."""
    levels = np.full((100, 200, 2), 255, np.float32)
    levels[..., 1] = other
    if other == 0:
        levels[:, 100:120, 1] = 10 * np.arange(20)
    valid = np.ones((100, 200), bool)
    chosen = Picture(levels, 0.5, valid, valid * 1.0, None, "none").informative(400, 3) % 200
    among = np.count_nonzero((chosen >= 98) & (chosen < 122))
    assert among > 200 if other == 0 else among < 80


def test_starts_are_the_cheapest_that_are_apart():
    """Against one after the other, cheapest first."""
    rng = np.random.default_rng(2)
    cost, places = rng.random((40, 12)), rng.random((40, 2))
    shapes = np.column_stack([rng.random(12), rng.choice([0.2, 0.5, 0.8], 12)])
    cost[3] = np.inf
    expected: list[tuple[int, int]] = []
    for flat in np.argsort(cost, axis=None):
        i, j = divmod(int(flat), 12)
        near = any(
            np.abs(places[i] - places[a]).max() < 0.2 and abs(shapes[j, 1] - shapes[b, 1]) < 0.25
            for a, b in expected
        )
        if np.isfinite(cost[i, j]) and not near:
            expected.append((i, j))
    assert distinct_starts(cost, places, shapes, 6) == expected[:6]
    assert distinct_starts(cost, places, shapes, 999) == expected
    assert len(light_grid(rng.random((64, 64)), 0)) % 2 == 0


def test_lights_are_solved_for_in_halves():
    rng = np.random.default_rng(3)
    rays, shapes = rng.random((6, 5, 30)), rng.random((4, 5))
    given = jnp.asarray(shapes), *(jnp.asarray(rng.random(30)) for _ in range(3))
    with jax.enable_x64(False):
        rays, given = jnp.asarray(rays, jnp.float32), [z.astype(jnp.float32) for z in given]

        def costs(places):
            return _solve(rays[places], given[0], _View(*given[1:]))

        whole = costs(np.arange(6))
        even, odd = map_halves(costs, np.arange(6)), map_halves(costs, np.arange(5), 2)
        for halves, without, expected in zip(even, odd, whole, strict=True):
            np.testing.assert_allclose(halves, expected, rtol=1e-5, atol=1e-5)
            np.testing.assert_allclose(without, expected[:5], rtol=1e-5, atol=1e-5)


@pytest.mark.usefixtures("single_precision")
def test_starts_of_a_coloured_light_are_those_of_a_grey_one_scaled_to_green():
    rng = np.random.default_rng(0)
    grey = rng.uniform(20, 200, (24, 24, 1)).astype(np.float32)
    valid, mask = np.ones((24, 24), bool), rng.random((24, 24)).astype(np.float32)
    colour = np.float32([1.0, 0.5, 0.25])
    picture = Picture(grey * colour, 0.5, valid, mask, None, "none")
    model = Mitchell(1.0, 0.9, 0.5, 0.5, [0.5, 0.5], samples=20)
    # With a density that is given the starts come from a program, whose arrays are read alone.
    search = {"given": {"density": 0.6}, "keep": 2, "seed": 0}
    found = tinted_starts(TintedMask(model), picture, **search)
    alone = mitchell_starts(model, picture, **search)
    for start, other in zip(found, alone, strict=True):
        np.testing.assert_allclose(start[6:], [2, 0.5], rtol=1e-5)
        scaled = other * np.float32([3 / 3.5, 1, 1, 3 / 3.5, 1, 1])
        np.testing.assert_allclose(start[:6], scaled, rtol=1e-5)

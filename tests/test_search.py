"""Coordinates and noise that suit each other: the steps between two renderings."""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from godfit import Mitchell, fit, search
from godfit.observation import Observation, Picture, blurred, blurred_at
from godfit.screen import _in_halves, _solve, apart, light_grid
from godfit.search import Settled, _exact, _least, tangent_at

sys.path.insert(0, str(Path(__file__).parents[1] / "experiments"))
import scenes


def test_values_that_were_left_out_have_a_say():
    """Of a picture that is only rounded, the values nearest to the ends of their intervals are
    looked at first. In this one the others must object before the answer is right."""
    samples, light = 150, (0.56, 0.6)
    mask = scenes.triangles(np.random.default_rng(6), 512, np.array(light))
    mask = np.floor(mask * 255 + 0.5).astype(np.uint8)
    model = Mitchell(0.05, 0.985, 0.85, 0.7, light, "dawntime", samples)
    image = np.asarray(model(jnp.asarray(mask, jnp.float32) / 255), np.float64)
    target = scenes.to_bytes(image * (0.9 / np.quantile(image, 0.98)))
    found = fit(target, mask=mask, shader="dawntime", samples=samples)
    assert found.converged
    for name, true in (("decay", 0.985), ("density", 0.85), ("light_x", 0.56), ("light_y", 0.6)):
        off = found.params[name].value - true
        assert abs(off) < 4 * found.params[name].stderr, (name, off)


def test_a_tangent_that_is_known_is_taken():
    model = Mitchell(0.5, 0.98, 0.8, 0.7, [0.5, 0.5], samples=20)
    rng = np.random.default_rng(1)
    mask = jnp.asarray(rng.random((24, 24)), jnp.float32)
    image = 255 * np.asarray(model(mask)).reshape(-1)
    lo = np.floor(image).astype(np.float32)
    seen = Observation(
        mask, None, jnp.arange(24 * 24), jnp.asarray(lo), jnp.asarray(lo + 1), (24, 24), 1,
        "none", True,
    )  # fmt: skip
    free, held = np.ones(6, bool), np.full(6, np.nan, np.float32)
    start = np.array(model.coordinates(), np.float32) * np.float32(1.001)
    settled, tangent = search.settle(start, model, seen, free, held)
    known = [tangent]
    again, _ = search.settle(settled.coordinates, model, seen, free, held, known=known)
    assert known == []
    assert again.log_likelihood >= settled.log_likelihood - 1e-3


@pytest.mark.parametrize("sigma", [0.3, 1.0, 3.0, 40.0])
def test_a_blur_is_the_same_at_some_pixels(sigma):
    image = np.random.default_rng(0).uniform(0, 255, (23, 31, 2)).astype(np.float32)
    pixels = np.array([0, 30, 31, 200, 23 * 31 - 1])
    whole = blurred(image, sigma).reshape(-1, 2)
    np.testing.assert_allclose(blurred_at(image, sigma, pixels), whole[pixels], atol=1e-3)
    # A mean of what is there.
    assert image.min() <= whole.min() <= whole.max() <= image.max()
    assert (whole.std() < image.std()) == (sigma >= 1)


def test_the_nearest_to_the_walls_are_found():
    slack = np.random.default_rng(1).permutation(1 << 19).astype(np.float32)
    rows = _least(slack)
    assert isinstance(rows, np.ndarray)
    assert np.array_equal(np.sort(slack[rows]), np.arange(len(rows)))
    assert _least(slack[:1000]) is None
    # However they lie among the others.
    slack = np.sort(slack)
    assert np.array_equal(_least(slack), np.arange(len(rows)))
    flat = np.zeros(1 << 19, np.float32)
    assert len(np.unique(_least(flat))) == len(rows)


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
    assert apart(cost, places, shapes, 6) == expected[:6]
    assert apart(cost, places, shapes, 999) == expected
    assert len(light_grid(rng.random((64, 64)), 0)) % 2 == 0


def test_lights_are_solved_for_in_halves():
    rng = np.random.default_rng(3)
    rays, shapes = rng.random((6, 5, 30)), rng.random((4, 5))
    given = (jnp.asarray(shapes), *(jnp.asarray(rng.random(30)) for _ in range(3)))
    with jax.enable_x64(False):
        rays, given = jnp.asarray(rays, jnp.float32), [z.astype(jnp.float32) for z in given]

        def costs(places):
            return _solve(rays[places], *given)

        whole = costs(np.arange(6))
        even, odd = _in_halves(costs, np.arange(6)), _in_halves(costs, np.arange(5))
        for halves, without, expected in zip(even, odd, whole, strict=True):
            np.testing.assert_allclose(halves, expected, rtol=1e-5, atol=1e-5)
            np.testing.assert_allclose(without, expected[:5], rtol=1e-5, atol=1e-5)


@pytest.mark.usefixtures("single_precision")
def test_a_few_pixels_say_where_a_tangent_leads():
    rng = np.random.default_rng(8)
    light, size = (0.56, 0.6), 128
    mask = scenes.ellipses(rng, size, np.array(light)).astype(np.float32)
    model = Mitchell(0.05, 0.985, 0.85, 0.7, light, "dawntime", 40)
    levels = 255 * np.asarray(model(jnp.asarray(mask)))[..., None]
    picture = Picture(np.round(levels), 0.5, np.ones((size, size), bool), mask, None, "none")
    seen, held = picture.observe(np.arange(size * size)), np.full(6, np.nan, np.float32)
    z = np.asarray(model.coordinates(), np.float32)
    tangent = tangent_at(z, held, model, seen)
    values = np.sort(rng.choice(size * size, 500, replace=False))
    few = [(values, seen.only(values))]
    np.testing.assert_allclose(few[0][1].predict(model), seen.predict(model)[values], atol=1e-4)

    def render(z, seen):
        return tangent_at(z, held, model, seen)

    def off(z, there):
        return np.sqrt(np.square(render(z, seen).prediction - there.prediction).mean())

    for share, found in ((0.003, True), (0.3, False)):
        goal = z * np.array([1 + share, 1, 1, 1 - share, 1, 1], np.float32)
        goal[1] *= 1 + 2 * share
        there = tangent._replace(prediction=tangent.moved(goal - z))
        at = Settled(goal, 0.005, 0.0, False)
        exact = _exact(at, there, few, render, np.ones(6, bool), model)
        assert (exact is not None) == found
        if exact is not None:
            # What is left is what float32 leaves; the tangent itself was off by several times that.
            assert off(exact.coordinates, there) < 2e-4 < 8e-4 < off(goal, there)

"""Coordinates and noise that suit each other: the steps between two renderings."""

import jax.numpy as jnp
import numpy as np
import pytest

from godfit import Mitchell, fit
from godfit.inference.observation import Picture
from godfit.inference.problem import Problem
from godfit.inference.settle import Settled, _corrected_on_spots, _tightest, settle
from godfit.inference.solver import tangent_at
from tests.support import random_targets


def test_values_that_were_left_out_have_a_say():
    """Of a picture that is only rounded, the values nearest to the ends of their intervals are
    looked at first. In this one the others must object before the answer is right."""
    samples, light = 150, (0.56, 0.6)
    mask = random_targets.triangles(np.random.default_rng(6), 512, np.array(light))
    mask = np.floor(mask * 255 + 0.5).astype(np.uint8)
    model = Mitchell(0.05, 0.985, 0.85, 0.7, light, "dawntime", samples)
    image = np.asarray(model(jnp.asarray(mask, jnp.float32) / 255), np.float64)
    target = random_targets.to_bytes(image * (0.9 / np.quantile(image, 0.98)))
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
    picture = Picture(
        (lo + 0.5).reshape(24, 24, 1), 0.5, np.ones((24, 24), bool), np.asarray(mask), None, "none"
    )
    seen = picture.observe(np.arange(24 * 24))
    free, held = np.ones(6, bool), np.full(6, np.nan, np.float32)
    start = np.array(model.coordinates(), np.float32) * np.float32(1.001)
    problem = Problem(model, picture, free, held)
    settled, tangent = settle(start, problem, seen)
    known = [tangent]
    again, _ = settle(settled.coordinates, problem, seen, known=known)
    assert known == []
    assert again.log_likelihood >= settled.log_likelihood - 1e-3


def test_the_nearest_to_the_walls_are_found():
    slack = np.random.default_rng(1).permutation(1 << 19).astype(np.float32)
    rows = _tightest(slack)
    assert isinstance(rows, np.ndarray)
    assert np.array_equal(np.sort(slack[rows]), np.arange(len(rows)))
    assert _tightest(slack[:1000]) is None
    # However they lie among the others.
    slack = np.sort(slack)
    assert np.array_equal(_tightest(slack), np.arange(len(rows)))
    flat = np.zeros(1 << 19, np.float32)
    assert len(np.unique(_tightest(flat))) == len(rows)


@pytest.mark.usefixtures("single_precision")
def test_a_few_pixels_say_where_a_tangent_leads():
    rng = np.random.default_rng(8)
    light, size = (0.56, 0.6), 128
    mask = random_targets.ellipses(rng, size, np.array(light)).astype(np.float32)
    model = Mitchell(0.05, 0.985, 0.85, 0.7, light, "dawntime", 40)
    levels = 255 * np.asarray(model(jnp.asarray(mask)))[..., None]
    picture = Picture(np.round(levels), 0.5, np.ones((size, size), bool), mask, None, "none")
    seen, held = picture.observe(np.arange(size * size)), np.full(6, np.nan, np.float32)
    z = np.asarray(model.coordinates(), np.float32)
    problem = Problem(model, picture, np.ones(6, bool), held)
    tangent = tangent_at(z, problem, seen)
    values = np.sort(rng.choice(size * size, 500, replace=False))
    few = [(values, seen.only(values))]
    np.testing.assert_allclose(few[0][1].predict(model), seen.predict(model)[values], atol=1e-4)

    def render(z, seen):
        return tangent_at(z, problem, seen)

    def off(z, there):
        return np.sqrt(np.square(render(z, seen).prediction - there.prediction).mean())

    for share, found in ((0.003, True), (0.3, False)):
        goal = z * np.array([1 + share, 1, 1, 1 - share, 1, 1], np.float32)
        goal[1] *= 1 + 2 * share
        there = tangent._replace(prediction=tangent.moved(goal - z))
        at = Settled(goal, 0.005, 0.0, False)
        exact = _corrected_on_spots(at, there, few, render, problem)
        assert (exact is not None) == found
        if exact is not None:
            # What is left is what float32 leaves; the tangent itself was off by several times that.
            assert off(exact.coordinates, there) < 2e-4 < 8e-4 < off(goal, there)

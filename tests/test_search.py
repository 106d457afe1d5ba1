"""Coordinates and noise that suit each other: the steps between two renderings."""

import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from godfit import Mitchell, fit, search
from godfit.observation import Observation

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

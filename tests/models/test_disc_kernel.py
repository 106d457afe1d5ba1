"""The light pass of a disc in one call: the same as from a mask for everything."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from godfit.models.disc_light import DiscLight
from godfit.models.mitchell import Mitchell
from godfit.scattering.upsample import columns_rows

SIZE = (120, 200)
by_kernel = eqx.filter_jit(DiscLight._sum_by_kernel)
over_mask = eqx.filter_jit(DiscLight._sum_over_mask)


def model_at(light, radius=0.1, edge=0.002, cut=1, shader="dawntime"):
    shading = Mitchell(0.3, 0.97, 0.8, 0.7, [light], shader, 60)
    return DiscLight(shading, [radius, edge, 0.06], np.zeros((1, 1)), (), cut)


def mask_and_points(most=1.3):
    """Some of the mask is more than open; points by themselves, in rows, and at the border."""
    rng = np.random.default_rng(0)
    mask = (rng.uniform(size=SIZE) < 0.8) * rng.uniform(0.7, most, SIZE)
    pixels = np.sort(rng.choice(SIZE[0] * SIZE[1], 500, replace=False))
    pixels = np.concatenate([pixels, np.arange(7000, 7040), [0, SIZE[1] - 1, mask.size - 1]])
    return jnp.asarray(mask), columns_rows(jnp.asarray(pixels), SIZE[1], float)


# Light, radius, edge, cut, and the mask's largest value.
CASES = {
    "amid": ((0.5137, 0.4921), 0.1, 0.002, 1, 1.3),
    "border": ((0.0213, 0.6031), 0.1, 1e-5, 2, 1.3),
    "large": ((0.3713, 0.2031), 0.4, 0.003, 1, 1.0),
    "hard": ((0.4713, 0.4031), 0.3, 1e-5, 2, 1.0),
    "over": ((0.4713, 0.4031), 0.3, 1e-5, 1, 1.3),
    "soft": ((0.6713, 0.7031), 0.1, 0.1, 1, 1.0),
    "beside": ((1.05, 0.9), 0.1, 0.002, 1, 1.3),
    "below": ((0.4011, -0.1013), 0.15, 0.004, 2, 1.0),
    "far": ((-0.5, 2.0), 0.1, 0.002, 1, 1.3),
}
# A shader is nothing to the kernel but the numbers of its taps.
SHADERS = {"dawntime": CASES, "mitchell": ("amid", "beside"), "pmndrs": ("amid", "beside")}


@pytest.mark.parametrize(
    ("shader", "case"), [(s, c) for s, cases in SHADERS.items() for c in cases]
)
def test_it_is_the_sum_over_the_whole_mask(shader, case):
    """And so are its derivatives, wherever the light and however large and soft the disc is."""
    light, radius, edge, cut, most = CASES[case]
    model, (mask, at) = model_at(light, radius, edge, cut, shader), mask_and_points(most)
    (value,) = by_kernel(model, mask, at, False)
    found = by_kernel(model, mask, at, True)
    right = over_mask(model, mask, at, "reference", True)
    np.testing.assert_allclose(value, right[0], rtol=0, atol=1e-12 * np.abs(right[0]).max())
    for part, whole in zip(found, right, strict=True):
        size = np.abs(whole).max()
        assert size > 0
        np.testing.assert_allclose(part, whole, rtol=0, atol=1e-12 * size)


def test_it_is_what_a_model_of_some_points_uses(monkeypatch):
    """In single precision too, and many at a time."""
    used, in_one = [], DiscLight._sum_by_kernel

    def recorded(self, open_, at, slopes):
        used.append(open_.dtype)
        return in_one(self, open_, at, slopes)

    monkeypatch.setattr(DiscLight, "_sum_by_kernel", recorded)
    model, (mask, _) = model_at((0.5137, 0.4921), 0.3, 0.001), mask_and_points(1.0)
    pixels = jnp.arange(5, 5800)

    @functools.partial(jax.jit, static_argnames="method")
    def shown(light, mask, method):
        here = model._with_numbers(jnp.concatenate([model._pass_numbers[:4], light, model.shape]))
        return here.light_pass(mask, size=SIZE, pixels=pixels, method=method)

    lights = jnp.array([[0.5137, 0.4921], [0.2, 0.9], [1.04, 0.5]])
    found = jax.vmap(lambda light: shown(light, mask, "auto"))(lights)
    for light, each in zip(lights, found, strict=True):
        right = shown(light, mask, "reference")
        np.testing.assert_allclose(each, right, atol=1e-12)
        single = shown(light.astype(jnp.float32), mask.astype(jnp.float32), "auto")
        assert single.dtype == jnp.float32
        np.testing.assert_allclose(single, right, rtol=3e-6)
    assert set(used) == {jnp.dtype("float32"), jnp.dtype("float64")}


def test_what_is_no_number_gives_none():
    model, (mask, at) = model_at((np.nan, 0.5)), mask_and_points()
    assert np.isnan(by_kernel(model, mask, at, True)[0]).all()


def test_a_light_without_an_end_adds_nothing():
    """Far beyond what a whole number holds."""
    model, (mask, at) = model_at((1e30, 0.5)), mask_and_points()
    assert np.isfinite(by_kernel(model, mask, at, False)[0]).all()

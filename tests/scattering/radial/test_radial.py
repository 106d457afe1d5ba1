"""The radial sum: the reference against scipy's interpolation, the other methods against it."""

import functools
import importlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from godfit.scattering import radial
from godfit.scattering.conventions import convention
from godfit.scattering.radial.strips import sums_of_rays
from godfit.scattering.taps import Taps
from tests.support import scattering_oracle as oracle
from tests.support.compiling import quick_jit

# The module; the package has a function of that name.
pairs_module = importlib.import_module("godfit.scattering.radial.pairs")

radial_sum = jax.jit(radial.radial_sum, static_argnames="method")

TAPS = Taps(0.3, 0.21, 0.93, 0.0739, 13)
MASKS = {
    "random": np.random.default_rng(0).random((11, 13)),
    "hard": oracle.hard_mask(11, 13),
    "single texel": np.array([[0.7]]),
    "row": np.random.default_rng(1).random((1, 9)),
    "column": np.random.default_rng(2).random((9, 1)),
    "3x5": oracle.hard_mask(3, 5, seed=3),
    "wide": np.random.default_rng(4).random((6, 29)),
}
# Columns and rows: inside, on texels, on the border, far outside.
AT = np.array([[3.25, 4.5], [0.0, 0.0], [7.0, 2.0], [-0.5, 10.5], [-40.0, 3.0], [12.9, 99.0]])


def agree(actual, expected, tolerance):
    np.testing.assert_allclose(actual, expected, rtol=0, atol=tolerance)


@pytest.mark.parametrize("light", oracle.LIGHTS.values(), ids=oracle.LIGHTS)
@pytest.mark.parametrize("mask", MASKS.values(), ids=MASKS)
class TestEveryMaskAndLight:
    def test_reference_is_the_definition(self, mask, light):
        expected = oracle.tap_sum(mask, light, float(TAPS.own), np.asarray(TAPS.c), TAPS.t)
        actual = radial_sum(jnp.asarray(mask), jnp.array(light), TAPS, method="reference")
        agree(actual, expected, 1e-12)

    @pytest.mark.parametrize("method", ["pairs", "strips"])
    def test_others_are_the_reference(self, mask, light, method):
        mask, light = jnp.asarray(mask), jnp.array(light)
        expected = radial_sum(mask, light, TAPS, method="reference")
        agree(radial_sum(mask, light, TAPS, method=method), expected, 1e-12)


@pytest.mark.parametrize("light", oracle.LIGHTS.values(), ids=oracle.LIGHTS)
@pytest.mark.parametrize("mask", ["random", "hard", "row", "single texel"])
@pytest.mark.parametrize("method", ["reference", "pairs", "strips"])
def test_float32(mask, light, method):
    mask = MASKS[mask]
    expected = radial_sum(jnp.asarray(mask), jnp.array(light), TAPS, method="reference")
    single = radial_sum(jnp.asarray(mask, jnp.float32), jnp.array(light), TAPS, method=method)
    assert single.dtype == jnp.float32
    agree(single, expected, 1e-5)


@pytest.mark.parametrize("method", ["reference", "pairs", "strips"])
@pytest.mark.parametrize("light", oracle.LIGHTS.values(), ids=oracle.LIGHTS)
def test_points_anywhere(light, method):
    """The sum at points on and off the image, each tap a texture read of its own."""
    mask = MASKS["random"]
    h, w = mask.shape
    u, v = (AT[:, 0] + 0.5) / w, 1 - (AT[:, 1] + 0.5) / h
    expected = 0.3 * oracle.texture(mask, u, v)
    for c, t in zip(np.asarray(TAPS.c), np.asarray(TAPS.t), strict=True):
        expected += c * oracle.texture(mask, u + t * (light[0] - u), v + t * (light[1] - v))
    at = jnp.asarray(AT)
    actual = radial_sum(jnp.asarray(mask), jnp.array(light), TAPS, at=at, method=method)
    agree(actual, expected, 1e-12)
    stacked = at.reshape(3, 2, 2)
    shaped = radial_sum(jnp.asarray(mask), jnp.array(light), TAPS, at=stacked, method=method)
    agree(shaped, expected.reshape(3, 2), 1e-12)


# Densities 1.06 and 1.9: the last taps lie beyond the light, where the mask is mirrored.
BEYOND = {"1.06": Taps(0.3, 0.07, 0.95, 1.06 / 24, 24), "1.9": Taps(0.3, 0.07, 0.95, 1.9 / 24, 24)}
SEVERAL_TILES = np.kron(oracle.hard_mask(9, 19, seed=2), np.ones((8, 8)))


@pytest.mark.parametrize("taps", BEYOND.values(), ids=BEYOND)
@pytest.mark.parametrize("light", oracle.LIGHTS.values(), ids=oracle.LIGHTS)
@pytest.mark.parametrize("method", radial.EXACT)
def test_taps_beyond_the_light(method, light, taps):
    """Every exact method in float32 against the definition in float64, whose total is below 2."""
    for mask in (np.round(255 * MASKS["random"]) / 255, SEVERAL_TILES):
        expected = oracle.tap_sum(mask, light, 0.3, np.asarray(taps.c), np.asarray(taps.t))
        double = radial_sum(jnp.asarray(mask), jnp.array(light), taps, method=method)
        agree(double, expected, 1e-12)
        single = jnp.asarray(mask, jnp.float32)
        # A tap on the edge between two texels falls on either side, far from the light by more.
        off = np.abs(radial_sum(single, jnp.array(light), taps, method=method) - expected)
        assert np.median(off) < 1e-6
        assert off.max() < 2e-5


@functools.partial(quick_jit, static_argnames="method")
def sum_and_slopes(numbers, mask, at, method):
    """The sum at points, and its derivatives by the light and the taps' four numbers."""

    def summed(numbers):
        taps = Taps(*numbers[2:], TAPS.count)
        return radial.radial_sum(mask, numbers[:2], taps, at=at, method=method)

    return summed(numbers), jax.jacfwd(summed)(numbers)


@pytest.mark.parametrize("light", oracle.LIGHTS.values(), ids=oracle.LIGHTS)
def test_taps_that_read_a_dark_border_add_nothing(light):
    """Points in and far off a mask, most of whose rays miss what is not dark: sums and their
    derivatives are those of the reference, which reads all of them."""
    mask = np.zeros((40, 60))
    mask[15:22, 20:41] = np.random.default_rng(0).random((7, 21))
    rng = np.random.default_rng(1)
    at = jnp.asarray(rng.uniform((-30, -30), (90, 70), (300, 2)))
    numbers = jnp.array([*light, TAPS.own, TAPS.first, TAPS.ratio, TAPS.step])
    found, expected = (
        sum_and_slopes(numbers, jnp.asarray(mask), at, method) for method in ("strips", "reference")
    )
    for actual, right in zip(found, expected, strict=True):
        assert np.count_nonzero(right) > 20
        agree(actual, right, 1e-12 * np.abs(right).max())


@pytest.mark.parametrize("method", ["reference", "pairs", "strips"])
def test_whole_pixels_are_met_exactly(method):
    mask = jnp.asarray(MASKS["random"])
    everywhere = radial_sum(mask, jnp.array([0.2, 1.3]), TAPS, method=method)
    rows, columns = np.array([0, 5, 10]), np.array([12, 7, 0])
    at = jnp.asarray(np.stack([columns, rows], -1).astype(float))
    agree(
        radial_sum(mask, jnp.array([0.2, 1.3]), TAPS, at=at, method=method),
        everywhere[rows, columns],
        1e-15,
    )


@functools.partial(quick_jit, static_argnames="method")
def row_and_slopes(light, ratio, mask, at, method):
    """The sum of 40 taps at points, and its derivatives by the light and the ratio."""

    def image(light, ratio):
        taps = Taps(0.3, 0.21, ratio, 0.0239, 40)
        return radial.radial_sum(mask, light, taps, at=at, method=method)

    return image(light, ratio), *jax.jacfwd(image, (0, 1))(light, ratio)


@pytest.mark.parametrize("light", oracle.LIGHTS.values(), ids=oracle.LIGHTS)
def test_points_in_a_row(light):
    """Runs shorter and longer than a tile, on and between rows, over the border, among others."""
    rng = np.random.default_rng(9)
    mask = np.kron(oracle.hard_mask(5, 20, seed=6), np.ones((8, 8)))
    runs = [(0, 160, 3.0), (10, 31, 4.0), (-3, 40, 4.0), (20.25, 70, 20.5), (100, 64, 39.0)]
    at = [np.stack([start + np.arange(n), np.full(n, row)], -1) for start, n, row in runs]
    at = jnp.asarray(np.concatenate([at[0], rng.uniform(0, 40, (7, 2)), *at[1:]]))
    found, expected = (
        row_and_slopes(jnp.array(light), jnp.asarray(0.93), jnp.asarray(mask), at, method)
        for method in ("strips", "reference")
    )
    for actual, right in zip(found, expected, strict=True):
        agree(actual, right, 1e-11 * np.abs(right).max())


@pytest.mark.parametrize("block", [10, 13])
def test_pairs_beyond_one_block(monkeypatch, block):
    """Blocks that do not and that do divide the 143 points, in value and derivative."""
    mask, light = jnp.asarray(MASKS["random"]), jnp.array([0.2, 1.3])
    at = jnp.asarray(AT[:5])

    def everything(light):
        whole = radial.radial_sum(mask, light, TAPS, method="pairs")
        return whole, radial.radial_sum(mask, light, TAPS, at=at, method="pairs")

    def compiled():
        # A function of its own: no cache would notice that POINTS_PER_BLOCK has changed.
        return quick_jit(lambda light: (everything(light), jax.jacfwd(everything)(light)))(light)

    expected = compiled()
    monkeypatch.setattr(pairs_module, "POINTS_PER_BLOCK", block)
    actual = compiled()
    jax.tree.map(lambda a, e: agree(a, e, 1e-13), actual, expected)


@pytest.mark.parametrize("method", ["reference", "pairs", "strips"])
def test_channels_are_summed_each_by_itself(method):
    mask = jnp.asarray(np.random.default_rng(5).random((6, 7, 3)))
    light, at = jnp.array([0.4, 0.1]), jnp.asarray(AT)
    together = radial_sum(mask, light, TAPS, method=method)
    points = radial_sum(mask, light, TAPS, at=at, method=method)
    assert together.shape == (6, 7, 3)
    assert points.shape == (6, 3)
    for c in range(3):
        agree(together[..., c], radial_sum(mask[..., c], light, TAPS, method=method), 1e-15)
        agree(points[:, c], radial_sum(mask[..., c], light, TAPS, at=at, method=method), 1e-15)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("method", ["reference", "pairs", "strips"])
def test_dtype_follows_the_mask(dtype, method):
    mask = jnp.asarray(MASKS["random"], dtype)
    assert radial_sum(mask, jnp.array([0.2, 0.3]), TAPS, method=method).dtype == dtype


def test_uv_steps_stop_at_the_light():
    """Steps in texture coordinates are of equal length for every pixel; none goes past the light,
    and at the light itself there is none."""
    mask, light = np.random.default_rng(6).random((11, 13)), (4.5 / 13, 1 - 6.5 / 11)
    taps = Taps(0.5, 0.25, 0.8, 0.09, 7, "uv")
    u, v = oracle.pixel_centres(*mask.shape)
    distance = np.hypot(light[0] - u, light[1] - v)
    direction_u, direction_v = (
        np.divide(z, distance, out=np.zeros_like(z), where=distance > 1e-12)
        for z in (light[0] - u, light[1] - v)
    )
    expected = 0.5 * mask
    for k in range(1, 8):
        reach = 0.09 * k
        read = oracle.texture(mask, u + reach * direction_u, v + reach * direction_v)
        expected = expected + np.where(reach <= distance, 0.25 * 0.8 ** (k - 1) * read, 0)
    agree(radial_sum(jnp.asarray(mask), jnp.array(light), taps), expected, 1e-12)


@pytest.mark.parametrize("method", ["pairs", "strips"])
def test_others_refuse_uv_steps(method):
    taps = convention("three").taps(1.0, 1.0, 1.0, 1.0, 18)[0]
    with pytest.raises(ValueError, match="'reference' for uv taps"):
        radial_sum(jnp.ones((3, 3)), jnp.array([0.5, 0.5]), taps, method=method)


def test_unknown_method():
    with pytest.raises(ValueError, match=r"expected auto or one of reference, pairs, .* got 'fft'"):
        radial_sum(jnp.ones((3, 3)), jnp.array([0.5, 0.5]), TAPS, method="fft")


def test_sums_of_several_rays_are_those_of_each():
    rng, (h, w) = np.random.default_rng(8), (11, 13)
    mask, light = rng.random((h, w)), np.array([0.3, 0.6])
    at = rng.uniform(0, 10, (2, 40))
    counts, steps, ratios = [7, 12, 30], [0.12, 0.07, 0.031], [0.9, 0.97, 0.99]
    place = light[0] * w - 0.5, (1 - light[1]) * h - 0.5
    rays = np.array([[*place, r, s, 0.0] for r, s in zip(ratios, steps, strict=True)])

    found = sums_of_rays(jnp.asarray(mask), jnp.asarray(rays), jnp.asarray(counts), jnp.asarray(at))

    for sums, count, step, ratio in zip(found, counts, steps, ratios, strict=True):
        agree(sums, radial_sum(mask, light, Taps(0.0, 1.0, ratio, step, count), at=at.T), 1e-12)

"""Approximate methods, and packed: their errors, where they are exact, and their derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from godfit.scattering import radial
from godfit.scattering.conventions import CONVENTIONS, convention
from godfit.scattering.radial.merged_taps import merge
from godfit.scattering.taps import Taps
from tests.support import scattering_oracle as oracle
from tests.support.compiling import quick_jit

# One of every algorithm: others of its name are the same code with another number.
ALGORITHMS = ["merged/4", "quarter", "polar", "gauss/16"]
APPROXIMATE = [name for name in radial.METHODS if name not in radial.EXACT]
radial_sum = jax.jit(radial.radial_sum, static_argnames="method")
slope = quick_jit(jax.jacfwd(radial.radial_sum, argnums=1), static_argnames="method")

# A total near 2: as bright as pictures get.
TAPS = Taps(0.02, 0.021, 0.985, 0.85 / 60, 60)
SOFT = jnp.asarray(oracle.smooth_mask(40, 56, scale=4))
HARD = jnp.asarray(np.kron(oracle.hard_mask(5, 7, seed=1), np.ones((8, 8))))
LIGHTS = {"on screen": jnp.array([0.37, 0.62]), "off screen": jnp.array([-0.3, 1.4])}
BYTES = jnp.asarray(np.random.default_rng(0).integers(0, 256, (11, 13)) / 255)


def levels(mask, light, method, taps=TAPS):
    """Root mean square and largest error, in 8-bit levels."""
    exact = radial_sum(mask, light, taps, method="reference")
    error = 255 * np.abs(radial_sum(mask, light, taps, method=method) - exact)
    return np.sqrt(np.mean(error**2)), error.max()


@pytest.mark.parametrize("light", oracle.LIGHTS.values(), ids=oracle.LIGHTS)
class TestPacked:
    def test_exact_for_bytes(self, light):
        taps, light = Taps(0.3, 0.21, 0.93, 0.0739, 13), jnp.array(light)
        exact = radial_sum(BYTES, light, taps, method="reference")
        packed = radial_sum(BYTES, light, taps, method="packed")
        np.testing.assert_allclose(packed, exact, rtol=0, atol=1e-12)
        actual = slope(BYTES, light, taps, method="packed")
        expected = slope(BYTES, light, taps, method="reference")
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-11)

    def test_at_points_and_single(self, light):
        taps, light = Taps(0.3, 0.21, 0.93, 0.0739, 13), jnp.array(light)
        at = jnp.array([[3.25, 4.5], [0.0, 0.0], [-40.0, 3.0]])
        exact = radial_sum(BYTES, light, taps, at=at, method="reference")
        packed = radial_sum(BYTES, light, taps, at=at, method="packed")
        np.testing.assert_allclose(packed, exact, rtol=0, atol=1e-12)
        at = at.astype(jnp.float32)
        single = radial_sum(BYTES.astype(jnp.float32), light, taps, at=at, method="packed")
        assert single.dtype == jnp.float32
        np.testing.assert_allclose(single, exact, rtol=0, atol=1e-5)


# Root mean square and largest error in levels, measured x 1.5: of the soft mask with the light on
# screen and off screen, then of the hard mask.
BOUNDS = {
    "merged/2": ((0.01, 0.071), (0.044, 0.16), (0.29, 1.7), (1.7, 8.7)),
    "merged/4": ((0.05, 0.45), (0.15, 0.56), (1.9, 8.9), (6.6, 37.0)),
    "merged/8": ((0.17, 1.5), (0.65, 2.2), (6.1, 32.0), (18.0, 58.0)),
    "half": ((1.1, 5.8), (1.9, 6.9), (11.0, 66.0), (2.5, 12.0)),
    "quarter": ((4.0, 18.0), (5.0, 18.0), (25.0, 120.0), (7.1, 33.0)),
    "polar": ((0.21, 1.3), (0.14, 0.75), (3.9, 31.0), (2.3, 9.8)),
    "gauss/16": ((0.025, 0.12), (0.17, 0.58), (2.2, 9.9), (10.0, 37.0)),
    "gauss/32": ((0.012, 0.081), (0.05, 0.19), (0.43, 1.8), (3.0, 11.0)),
}


def test_every_approximation_is_bounded():
    assert set(BOUNDS) == set(APPROXIMATE)
    assert {name.partition("/")[0] for name in APPROXIMATE} - {"half"} == {
        name.partition("/")[0] for name in ALGORITHMS
    }


@pytest.mark.parametrize("method", APPROXIMATE)
class TestErrors:
    @pytest.mark.parametrize("light", LIGHTS)
    @pytest.mark.parametrize("mask", ["soft", "hard"])
    def test_stated(self, method, mask, light):
        rms, worst = levels({"soft": SOFT, "hard": HARD}[mask], LIGHTS[light], method)
        bound = BOUNDS[method][2 * (mask == "hard") + (light == "off screen")]
        assert rms < bound[0]
        assert worst < bound[1]

    def test_flat_masks_are_exact(self, method):
        """Weights add up to those of all taps, and reads at the border to the border's value."""
        flat = jnp.full(SOFT.shape, 0.7)
        for light in oracle.LIGHTS.values():
            _, worst = levels(flat, jnp.array(light), method)
            assert worst < 1e-9

    def test_every_convention(self, method):
        for shader in CONVENTIONS.values():
            # 61 and 60 samples are 60 taps, as TAPS: compiled once.
            if shader.plain and shader.own_scaled:
                # As bright as the others where the weight is not .5 but fixed.
                exposure = 0.033 * 0.5 / shader.absent.get("weight", 0.5)
                taps = shader.taps(exposure, 0.98, 0.8, 0.5, TAPS.count + shader.drop)[0]
                _, worst = levels(SOFT, LIGHTS["on screen"], method, taps)
                assert worst < (13 if method == "quarter" else 4), shader.name

    def test_uv_taps_are_refused(self, method):
        taps = convention("three").taps(1.0, 1.0, 1.0, 1.0, 18)[0]
        with pytest.raises(ValueError, match="'reference' for uv taps"):
            radial.radial_sum(SOFT, LIGHTS["on screen"], taps, method=method)


@pytest.mark.parametrize("method", ALGORITHMS)
class TestAlgorithms:
    def test_one_tap_or_none(self, method):
        """Where there is nothing to save, what does not resample is exact."""
        for samples in (1, 2):
            taps = convention("dawntime").taps(0.3, 0.9, 0.7, 0.5, samples)[0]
            _, worst = levels(SOFT, LIGHTS["on screen"], method, taps)
            assert worst < {"quarter": 19, "polar": 4}.get(method, 1e-9)

    def test_channels_points_and_single(self, method):
        light = LIGHTS["on screen"]
        three = jnp.stack([SOFT, HARD, 1 - SOFT], -1).astype(jnp.float32)
        at = jnp.array([[3.25, 4.5], [55.0, 0.0], [-4.0, 3.0]], jnp.float32)
        picture = radial_sum(three, light, TAPS, method=method)
        points = radial_sum(three, light, TAPS, at=at, method=method)
        assert picture.dtype == points.dtype == jnp.float32
        assert picture.shape == (40, 56, 3)
        assert points.shape == (3, 3)
        alone = radial_sum(HARD, light, TAPS, method=method)
        np.testing.assert_allclose(picture[..., 1], alone, rtol=0, atol=5e-5)
        exact = radial_sum(three, light, TAPS, at=at, method="reference")
        np.testing.assert_allclose(points, exact, rtol=0, atol=0.1)


@pytest.mark.parametrize("method", APPROXIMATE)
def test_taps_beyond_the_light(method):
    """A flat mask is exact, and a soft one no worse than five times the bound for shorter rays: the
    taps there mirror the mask and enlarge its errors."""
    taps = Taps(0.02, 0.021, 0.985, 1.8 / 60, 60)
    for name, light in LIGHTS.items():
        assert levels(jnp.full(SOFT.shape, 0.7), light, method, taps)[1] < 1e-9
        rms, _ = levels(SOFT, light, method, taps)
        assert rms < 5 * BOUNDS[method][name == "off screen"][0]


@pytest.mark.parametrize(
    ("worse", "better", "light"),
    [
        ("merged/8", "merged/4", "on screen"),
        ("merged/4", "merged/2", "on screen"),
        ("merged/8", "merged/4", "off screen"),
        ("merged/4", "merged/2", "off screen"),
        ("quarter", "half", "on screen"),
        ("quarter", "half", "off screen"),
        ("gauss/16", "gauss/32", "off screen"),
    ],
)
def test_more_work_is_less_error(worse, better, light):
    for mask in (SOFT, HARD):
        assert levels(mask, LIGHTS[light], better)[0] < levels(mask, LIGHTS[light], worse)[0] / 1.8


def test_polar_converges_with_the_picture():
    """Twice the picture is twice the grid: the error of a soft mask falls with its square."""
    fine = jnp.asarray(oracle.smooth_mask(80, 112, scale=8))
    assert levels(fine, LIGHTS["on screen"], "polar")[0] < 0.1


@pytest.mark.parametrize("ratio", [0.0, 1e-9, 0.5, 0.99, 1.0])
@pytest.mark.parametrize("count", [2, 7, 60])
@pytest.mark.parametrize("m", [2, 4, 8])
def test_merged_taps_keep_two_moments(ratio, count, m):
    taps = Taps(0.3, 0.2, ratio, 0.01, count, lag=0.1)
    few = merge(taps, m)
    assert few.count == -(-count // m)
    np.testing.assert_allclose(few.c.sum(), taps.c.sum(), rtol=1e-13)
    np.testing.assert_allclose((few.c * few.t).sum(), (taps.c * taps.t).sum(), rtol=1e-12)


def values(z, mask, method):
    taps = Taps(z[2], z[3], z[4], z[5], 40)
    out = radial.radial_sum(mask, z[:2], taps, method=method)
    return out, out


VALUES = quick_jit(lambda z, mask, method: values(z, mask, method)[0], static_argnames="method")
# With the values themselves.
SLOPES = quick_jit(jax.jacfwd(values, has_aux=True), static_argnames="method")


@pytest.mark.parametrize("method", ALGORITHMS)
def test_forward_is_the_slope_of_the_values(method):
    """Against central differences of the approximation itself, on nearly every pixel: a texel line
    or an interval between radii that a tap crosses is a kink."""
    for light in LIGHTS.values():
        z = jnp.array([*light, 0.02, 0.021, 0.97, 0.0142])
        actual = np.asarray(SLOPES(z, SOFT, method)[0])
        for i, step in enumerate(1e-7 * np.eye(6)):
            up, down = VALUES(z + step, SOFT, method), VALUES(z - step, SOFT, method)
            difference = np.asarray(up - down) / 2e-7
            scale = np.abs(actual[..., i]).max()
            # How merged taps' lag moves with the ratio is left out.
            near = 2e-2 if method.startswith("merged") and i == 4 else 1e-5
            assert (np.abs(actual[..., i] - difference) < near * scale).mean() > 0.95, i


@pytest.mark.parametrize("method", ALGORITHMS)
def test_reverse_is_forward(method):
    z = jnp.array([*LIGHTS["on screen"], 0.02, 0.021, 0.97, 0.0142])
    pull = jnp.asarray(np.random.default_rng(3).normal(size=SOFT.shape))
    reverse = quick_jit(jax.grad(lambda z: jnp.vdot(pull, values(z, SOFT, method)[0])))(z)
    forward = jnp.einsum("hw,hwz->z", pull, SLOPES(z, SOFT, method)[0])
    np.testing.assert_allclose(reverse, forward, rtol=1e-9)


@pytest.mark.parametrize("method", ["packed", *ALGORITHMS])
def test_finite_at_every_edge(method):
    """Light on a pixel's centre, on the border, a corner; no decay, no density; tiny masks."""
    numbers = ((0.97, 0.0142), (1.0, 0.0142), (0.0, 0.0142), (0.97, 0.0))
    # Of the picture that other tests have compiled.
    lights = oracle.LIGHTS | {"texel centre": (22.5 / 56, 1 - 17.5 / 40)}
    cases = [(SOFT, light, numbers[0]) for light in lights.values()]
    cases += [(SOFT, lights["texel centre"], pair) for pair in numbers[1:]]
    pictures = [SOFT[:1, :1], SOFT[:1, :9]] if method == "polar" else [SOFT[:1, :1]]
    for mask in pictures:
        cases += [(mask, light, numbers[0]) for light in ((0.5, 0.5), (-0.6, 0.5), (3.0, -2.0))]
    for mask, light, (ratio, step) in cases:
        slopes, out = SLOPES(jnp.array([*light, 0.3, 0.21, ratio, step]), mask, method)
        assert np.isfinite(out).all(), (mask.shape, light, ratio, step)
        assert np.isfinite(slopes).all(), (mask.shape, light, ratio, step)

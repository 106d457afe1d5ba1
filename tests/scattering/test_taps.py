"""Shader conventions: each against its published formula, its defaults, and the identities between
them (formulas.md, section 1)."""

import jax.numpy as jnp
import numpy as np
import pytest

from godfit.models.mitchell import Mitchell
from godfit.scattering.conventions import CONVENTIONS, convention
from godfit.scattering.radial import radial_sum
from godfit.scattering.taps import Taps
from tests.support import scattering_oracle as oracle
from tests.support.compiling import quick_filter_jit

MASK = oracle.smooth_mask(11, 13)
LIGHT = (0.3, 0.8)
DEFAULTS = {
    "dawntime": (0.05, 0.99, 0.8, 0.8, 200),
    "vesper": (0.05, 0.99, 0.8, 0.8, 150),
    "article-glsl": (0.2, 0.96815, 0.926, 0.58767, 100),
    "article-hlsl": (0.92, 0.97815, 0.966, 0.58767, 100),
    "babylon": (0.3, 0.96815, 0.926, 0.58767, 100),
    "pmndrs": (0.6, 0.9, 0.96, 0.4, 60),
}
BLENDS = {"article-glsl": 1.1, "article-hlsl": 1.1, "babylon": 1.1}


@quick_filter_jit
def light_pass(model, mask):
    return model.light_pass(mask)


def render(shader, exposure, decay, density, weight, samples, mask=MASK, light=LIGHT):
    model = Mitchell(exposure, decay, density, weight, light, shader, samples)
    return np.asarray(light_pass(model, jnp.asarray(mask)))


def rms(image):
    return np.sqrt(np.mean(image**2))


@pytest.mark.parametrize("samples", [2, 7, 30])
@pytest.mark.parametrize("shader", oracle.FACTORS)
def test_convention_is_its_formula(shader, samples):
    point = (0.13, 0.93, 0.77, 0.6)
    expected = oracle.light_pass(MASK, shader, *point, LIGHT, samples)
    np.testing.assert_allclose(render(shader, *point, samples), expected, rtol=1e-12, atol=1e-14)


def fragment(shader, mask, point, light, samples):
    """The loop of a fragment shader, statement by statement, for every pixel at once: DawnTime
    lowers its running decay before a tap (slide "Volumetric scattering fragment shader"), Vesper
    after it (slide "LightScatteringShader")."""
    exposure, decay, density, weight = point
    u, v = oracle.pixel_centres(*mask.shape)
    delta_u, delta_v = (
        (x - to) * (1 / samples) * density for x, to in zip((u, v), light, strict=True)
    )
    colour, illumination_decay = oracle.texture(mask, u, v), 1.0
    for _ in range(1, samples):
        u, v = u - delta_u, v - delta_v
        sample = oracle.texture(mask, u, v)
        if shader == "dawntime":
            illumination_decay *= decay
        colour = colour + sample * illumination_decay * weight
        if shader == "vesper":
            illumination_decay *= decay
    return colour * exposure


@pytest.mark.parametrize("shader", ["dawntime", "vesper"])
def test_slides_shaders_statement_by_statement(shader):
    point = tuple(CONVENTIONS[shader].defaults.values())[:4]
    expected = fragment(shader, MASK, point, LIGHT, 30)
    np.testing.assert_allclose(render(shader, *point, 30), expected, rtol=1e-12)


def test_which_shaders_halve_their_light_pass():
    halved = {name for name, shader in CONVENTIONS.items() if shader.pass_scale == 0.5}
    assert halved == {"dawntime", "vesper", "sun-shafts", "light-shafts", "godot4"}
    assert {shader.pass_scale for shader in CONVENTIONS.values()} == {0.5, 1.0}


@pytest.mark.parametrize("shader", DEFAULTS)
def test_defaults_are_the_published_ones(shader):
    names = ("exposure", "decay", "density", "weight", "samples")
    assert CONVENTIONS[shader].defaults == dict(zip(names, DEFAULTS[shader], strict=True))
    assert CONVENTIONS[shader].samples == DEFAULTS[shader][-1]


def test_mitchell_publishes_no_defaults():
    assert CONVENTIONS["mitchell"].defaults == {}
    assert CONVENTIONS["mitchell"].samples == 100


@pytest.mark.parametrize("shader", oracle.FACTORS)
def test_blend_and_background_gain(shader):
    assert CONVENTIONS[shader].blend == ("screen" if shader == "pmndrs" else "add")
    assert CONVENTIONS[shader].background_gain == BLENDS.get(shader, 1.0)


def test_shaders_without_a_tap_of_their_own_pixel():
    without = {name for name, shader in CONVENTIONS.items() if not shader.own_pixel}
    assert without == {
        "additive", "glsl-godrays", "moonshine", "pmndrs", "radial-blur", "reshade", "godot3"
    }  # fmt: skip


def test_three_is_three_passes_of_six_box_taps():
    passes = convention("three").taps(0.3, 0.5, 0.5, 0.5, 18)
    assert [taps.unit for taps in passes] == ["uv"] * 3
    for p, taps in enumerate(passes, start=1):
        np.testing.assert_allclose([taps.own, *taps.c], np.full(6, 1 / 6), rtol=1e-15)
        np.testing.assert_allclose(taps.t, np.arange(1, 6) / 6**p, rtol=1e-15)
    assert convention("three").defaults["exposure"] == 0.69


# Identities: equal to rounding.


def test_decay_before_use_is_a_smaller_weight():
    dawntime = render("dawntime", 0.2, 0.9, 0.8, 0.6, 20)
    vesper = render("vesper", 0.2, 0.9, 0.8, 0.6 * 0.9, 20)
    np.testing.assert_allclose(dawntime, vesper, rtol=1e-13)


def test_vesper_is_mitchell_with_a_sample_less_and_a_shorter_ray():
    n, density = 20, 0.8
    vesper = render("vesper", 0.2, 0.9, density, 0.6, n)
    mitchell = render("mitchell", 0.2, 0.9, density * (n - 1) / n, 0.6, n - 1)
    np.testing.assert_allclose(vesper, mitchell, rtol=1e-12)


def test_babylon_is_mitchell_at_two_fifths_on_a_brighter_background():
    background = np.random.default_rng(1).random(MASK.shape)
    babylon = Mitchell(0.5, 0.9, 0.8, 0.6, LIGHT, "babylon", 20)
    together = quick_filter_jit(babylon)(jnp.asarray(MASK), jnp.asarray(background))
    apart = render("mitchell", 0.4 * 0.5, 0.9, 0.8, 0.6, 20) + 1.1 * background
    np.testing.assert_allclose(together, apart, rtol=1e-13)


def test_without_an_own_pixel_only_exposure_times_weight_enters():
    dark = oracle.hard_mask(11, 13)
    once = render("vesper", 0.2, 0.9, 0.8, 0.6, 20, dark)
    again = render("vesper", 0.1, 0.9, 0.8, 1.2, 20, dark)
    np.testing.assert_allclose(once[dark == 0], again[dark == 0], rtol=1e-13, atol=1e-16)
    assert np.abs(once - again)[dark == 1].min() > 0.05
    pmndrs = [render("pmndrs", e, 0.9, 0.8, 0.12 / e, 20, dark) for e in (0.2, 0.1)]
    np.testing.assert_allclose(*pmndrs, rtol=1e-13, atol=1e-16)


def test_samples_trade_with_decay_and_weight_to_first_order():
    """(n, d, w) ~ (n', d^(n/n'), w n/n'): 60 -> 120 differs by about 1.3% rms, and each doubling
    halves the difference."""
    n, decay, weight, mask = 60, 0.97, 0.5, oracle.smooth_mask(48, 48, scale=3)

    def at(k):
        return render("mitchell", 0.1, decay ** (1 / k), 0.9, weight / k, n * k, mask)

    steps = [rms(at(2 * k) - at(k)) / rms(at(k)) for k in (1, 2, 4)]
    assert 0.007 < steps[0] < 0.02
    np.testing.assert_allclose([steps[0] / steps[1], steps[1] / steps[2]], 2, rtol=0.1)


def test_disc_light_without_occluder_is_a_geometric_series():
    """Outside a disc of radius R taps count from i0 = ceil(n (1 - R/r)/rho) on. Exact where no tap
    is read within a texel of the disc's edge; elsewhere out by at most those taps' weights."""
    size, radius, n, decay, density, weight = 129, 20.0, 16, 0.95, 0.9, 0.7
    offset = np.arange(size) - size // 2
    r = np.hypot(*np.meshgrid(offset, offset))
    disc = (r <= radius).astype(float)
    image = render("mitchell", 1.0, decay, density, weight, n, disc, (0.5, 0.5))
    outside = r > radius + 2
    r, image = r[outside], image[outside]
    first = np.maximum(np.ceil(n * (1 - radius / r) / density), 1)
    series = weight * np.maximum(decay ** (first - 1) - decay**n, 0) / (1 - decay)
    read_at = r * (1 - np.arange(1, n + 1)[:, None] * density / n)
    edge_taps = (np.abs(read_at - radius) < np.sqrt(2)).sum(0)
    assert (edge_taps == 0).sum() > 1000
    assert (np.abs(image - series) <= weight * edge_taps + 1e-12).all()


def test_total_is_the_sum_over_a_white_mask():
    taps = Taps(0.3, 0.2, 0.9, 0.05, 12)
    white = radial_sum(jnp.ones((5, 6)), jnp.array([0.2, 0.7]), taps)
    np.testing.assert_allclose(white, np.full((5, 6), taps.total), rtol=1e-13)
    np.testing.assert_allclose(taps.total, 0.3 + 0.2 * (1 - 0.9**12) / 0.1, rtol=1e-13)


@pytest.mark.parametrize(
    ("typed", "meant"),
    [("vespr", "vesper"), ("babylom", "babylon")],
)
def test_unknown_shader_names_the_nearest(typed, meant):
    with pytest.raises(ValueError, match=f"got '{typed}'; did you mean '{meant}'") as caught:
        convention(typed)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("typed", "meant"),
    [("GodRaysEffect", "pmndrs"), ("three.js", "three"), ("babylonjs", "babylon"),
     ("Babylon.js", "babylon"), ("GPU Gems 3", "mitchell"), ("DawnTime", "dawntime")],
)  # fmt: skip
def test_engines_and_effects_are_found_by_their_own_names(typed, meant):
    assert convention(typed).name == meant

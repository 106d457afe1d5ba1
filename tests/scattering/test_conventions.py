"""Every engine's sum against loops over its formula: value, Jacobian, blend, defaults; and shaders
from files."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from godfit.errors import InputError
from godfit.models.mitchell import Mitchell
from godfit.scattering.conventions import CONVENTIONS, convention, families
from godfit.scattering.conventions.shader_file import read_shader, shader_text
from tests.support import convention_oracle, scattering_oracle
from tests.support.compiling import quick_filter_jit, quick_jit

NAMES = ("exposure", "decay", "density", "weight", "light_x", "light_y")
POINT = {"exposure": 0.13, "decay": 0.93, "density": 0.77, "weight": 0.6}
MASK = scattering_oracle.smooth_mask(11, 13)
LIGHT = (0.31, 0.83)
SAMPLES = 7
STEP = 1e-7


def at(shader, point, mask=MASK, samples=SAMPLES):
    """godfit's light pass at (p,) values in the order of NAMES."""
    exposure, decay, density, weight, u, v = point
    model = Mitchell(1.0, 1.0, 1.0, 1.0, LIGHT, shader, samples)
    fields = ("exposure", "decay", "density", "weight", "light")
    for name, value in zip(fields, (exposure, decay, density, weight, [[u, v]]), strict=True):
        object.__setattr__(model, name, jnp.asarray(value))
    return model.light_pass(jnp.asarray(mask))


def point_of(shader):
    values = POINT | CONVENTIONS[shader].absent
    return np.array([*(values[name] for name in NAMES[:4]), *LIGHT])


def oracle(shader, point, mask=MASK, samples=SAMPLES, **how):
    p = dict(zip(NAMES[:4], point[:4], strict=True)) | {"samples": samples, "light": point[4:]}
    return convention_oracle.LIGHT_PASSES[shader](mask, p, **how)


@pytest.mark.parametrize("shader", convention_oracle.LIGHT_PASSES)
def test_sum_and_jacobian_are_those_of_the_formula(shader):
    point = point_of(shader)
    # The steps of Blender's sum are pixels, of which the small mask has fewer than 20.
    samples = 20 if shader == "sun-beams" else SAMPLES
    point[2] = 0.3 if shader == "sun-beams" else point[2]

    def evaluated(point):
        return at(shader, point, samples=samples)

    value, jacobian = quick_jit(lambda z: (evaluated(z), jax.jacfwd(evaluated)(z)))(
        jnp.array(point)
    )
    expected = oracle(shader, point, samples=samples)
    np.testing.assert_allclose(value, expected, rtol=1e-6, atol=1e-9)
    used = {*CONVENTIONS[shader].parameters, "light_x", "light_y"}
    if shader == "jmonkey":
        used -= {"exposure"}
    for i, name in enumerate(NAMES):
        moved = np.zeros(len(NAMES))
        moved[i] = STEP
        # The nearest texel has no slope by its place: that of its mean over a texel stands for it.
        how = {"mean": True} if CONVENTIONS[shader].jumps and name != "exposure" else {}
        up, down = (
            oracle(shader, point + sign * moved, samples=samples, **how) for sign in (1, -1)
        )
        slope = (up - down) / (2 * STEP) if name in used else np.zeros(MASK.shape)
        allowed = 1e-6 * max(1, np.abs(slope).max())
        np.testing.assert_allclose(jacobian[..., i], slope, 1e-6, allowed, err_msg=name)
        assert name not in used or np.abs(slope).max() > 0


def test_lengths_in_pixels_are_shorter_on_a_copy():
    """The pass of godot4 on a smooth mask, and that of a copy at half the size, are one picture."""
    model = Mitchell(1.0, 1.0, 0.8, 1.0, LIGHT, "godot4", 16)
    mask = scattering_oracle.smooth_mask(160, 192)
    copy = mask.reshape(80, 2, 96, 2).mean((1, 3))
    whole = np.asarray(model(mask)).reshape(80, 2, 96, 2).mean((1, 3))
    small, same = model.on_copy(0.5), np.asarray(model(copy))
    error = np.abs(np.asarray(small(copy)) - whole).max()
    assert error < 0.1 * np.abs(same - whole).max()
    assert small.convention.name == "godot4"
    other = Mitchell(1.0, 1.0, 0.8, 1.0, LIGHT, "jmonkey", 16)
    assert other.on_copy(0.5) is other


def test_every_convention_has_a_formula():
    assert {*CONVENTIONS} == {
        *convention_oracle.LIGHT_PASSES, *scattering_oracle.FACTORS, "three"
    }  # fmt: skip


def test_a_loop_of_at_most_a_hundred_taps():
    """index.glsl: for (int i = 0; i < 100; i++) { if (numSamples < i) break; ... }"""
    for samples, count in ((60, 61), (99, 100), (100, 100), (130, 100)):
        (taps,) = convention("glsl-godrays").taps(1.0, 1.0, 1.0, 0.01, samples)
        assert taps.count == count
        np.testing.assert_allclose(taps.t[0], 1 / samples)


def test_a_saturated_sum_at_a_decay_of_one():
    """S is n there, and the derivative by decay is that of the formula on either side."""
    point = point_of("reshade")
    point[1] = 1.0

    @quick_jit
    def by_decay(decay):
        return jax.jvp(lambda d: at("reshade", jnp.array(point).at[1].set(d)), (decay,), (1.0,))

    value, slope = by_decay(1.0)
    np.testing.assert_allclose(value, oracle("reshade", point), rtol=1e-9)
    below = point.copy()
    below[1] -= 1e-6
    expected = (oracle("reshade", point) - oracle("reshade", below)) / 1e-6
    np.testing.assert_allclose(slope, expected, atol=1e-5)


@quick_filter_jit
def pass_and_picture(model, mask, background):
    return model.light_pass(mask), model(mask, background)


@pytest.mark.parametrize("shader", ["additive", "babylon", "sun-shafts", "godot4", "jmonkey"])
def test_blend(shader):
    rng = np.random.default_rng(0)
    mask, background = rng.random((2, 6, 7, 3))
    point = POINT | CONVENTIONS[shader].absent
    numbers = [point[name] for name in NAMES[:4]]
    model = Mitchell(*numbers, LIGHT, shader, 6)
    light, picture = map(np.asarray, pass_and_picture(model, mask, background))
    expected = convention_oracle.composite(shader, light, background, POINT["exposure"])
    np.testing.assert_allclose(picture, expected, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("shader", CONVENTIONS)
def test_every_convention_has_its_source_names_and_family(shader):
    found = CONVENTIONS[shader]
    assert found.source
    assert found in families()[found.family]
    assert {"light", *found.parameters} <= {*found.names}
    assert not {*found.defaults} & {*found.absent}


@pytest.mark.parametrize("shader", CONVENTIONS)
def test_a_printed_convention_is_the_same_from_its_file(shader, tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(shader_text(CONVENTIONS[shader]))
    again = read_shader(file)
    assert again.definition() == CONVENTIONS[shader].definition()
    assert convention(str(file)).key.startswith(f"{shader}#")


# Written from the description of the convention, without its printed form.
DESCRIBED = {
    "dawntime": "drop = 1\norder = 0\npass_scale = 0.5\ndensity_slider = 1.0",
    "babylon": "gain = 0.4\nbackground_gain = 1.1",
    "pmndrs": 'own = 0\nblend = "screen"',
    "panda3d": "most_density = 10\n[absent]\nweight = 1",
}


@pytest.mark.parametrize("shader", DESCRIBED)
def test_a_users_file_gives_the_shippeds_sum_exactly(shader, tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(DESCRIBED[shader])
    point = POINT | CONVENTIONS[shader].absent
    numbers = [point[name] for name in NAMES[:4]]
    images = [
        np.asarray(Mitchell(*numbers, LIGHT, name, 9)(MASK, 0.5 * MASK))
        for name in (shader, str(file))
    ]
    np.testing.assert_array_equal(*images)
    model = Mitchell(*numbers, LIGHT, str(file), 9)
    assert model.settings["shader"] == "mine"
    assert model.convention.own_file


def test_another_content_is_another_shader(tmp_path):
    file, keys = tmp_path / "mine.toml", []
    for gain in ("1", "2", "1.0"):
        file.write_text(f"gain = {gain}")
        keys.append(Mitchell(0.1, 0.9, 0.8, 0.5, LIGHT, str(file)).shader)
    assert keys[0] == keys[2] != keys[1]


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("own = -1", "own"), ("gain = 0", "gain"), ("drop = 0.5", "drop"),
        ("order = true", "order"),
        ('blend = "mix"', "blend"), ("box = [0.1, 0]", "box"), ('passes = "fog"', "passes"),
        ("box = [0.1]\nblurs = [1]", "one of box"), ("[absent]\nexposure = 1", "exposure"),
        ("[defaults]\nsamples = 1", "samples"), ("[defaults]\ndecay = 2", "decay"),
        ("colour = 1", "colour"), ("own =", "TOML"), ("power = 0", "power"),
        ('passes = "godot4"', "radius"), ("[names]\nexposure = 1", "exposure"),
    ],
)  # fmt: skip
def test_a_bad_file_is_one_line_that_names_file_and_key(text, names, tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(text)
    with pytest.raises(InputError) as caught:
        convention(str(file))
    message = str(caught.value)
    assert "mine.toml" in message
    assert names in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("Unreal", "light-shafts"), ("Blender", "sun-beams"), ("jMonkeyEngine", "jmonkey"),
        ("PPFX_Godrays", "reshade"), ("SunShafts", "sun-shafts"), ("radialBlur", "radial-blur"),
        ("VolumetricLightScattering", "mean"), ("Panda3D", "panda3d"),
    ],
)  # fmt: skip
def test_engines_are_found_by_their_own_names(typed, meant):
    assert convention(typed).name == meant


@pytest.mark.parametrize("typed", ["unity", "Godot"])
def test_an_engine_with_two_sums_names_both(typed):
    with pytest.raises(InputError, match=r"'.*' .* or '.*'") as caught:
        convention(typed)
    assert "\n" not in str(caught.value)

"""The published shaders against their transcription, and their defects one by one."""

import math

import imagecodecs
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from godfit.__main__ import main
from godfit.errors import InputError
from godfit.flatland import (
    Canvas,
    GlobalIllumination,
    NaiveMarch,
    accumulated,
    canvas,
    effective_frames,
    from_rgba,
    read_canvas,
    render,
    render_published,
    weights,
)
from godfit.flatland.jump_flood import jump_flood
from godfit.flatland.published import distance_texture, flood_passes, hash_noise
from tests.support import published_shaders as source

DARK = (0.0, 0.0, 0.0)
WHITE = (1.0, 1.0, 1.0)


def bytes_of(size, seed):
    """Lamps, occluders and pixels of every sort of alpha: below .1, below .5, above, whole."""
    rng = np.random.default_rng(seed)
    h, w = size
    values = np.zeros((h, w, 4), np.uint8)
    for _ in range(3):
        row, column = rng.integers(0, h - 4), rng.integers(0, w - 4)
        colour = rng.integers(60, 256, 3) * (rng.random() < 0.7)
        values[row : row + 3, column : column + 4] = (*colour, 255)
    for alpha in (13, 26, 100, 128, 200):
        row, column = rng.integers(0, h - 2), rng.integers(0, w - 2)
        values[row, column : column + 2] = (*rng.integers(0, 256, 3), alpha)
    return values


CANVASES = {
    "square": bytes_of((26, 26), 1), "wide": bytes_of((17, 30), 2), "high": bytes_of((31, 15), 3)
}  # fmt: skip


def empty(h, w):
    return canvas(np.zeros((h, w, 3)), np.zeros((h, w)))


def published(folder, values, *options):
    """The picture by the command line."""
    (folder / "c.png").write_bytes(imagecodecs.png_encode(values))
    out = folder / "o.npy"
    command = ["render", "--model", "flatland", str(folder / "c.png"), "-o", str(out)]
    assert main([*command, *map(str, options)]) == 0
    return np.load(out)


def assert_same(found, texels):
    expected = source.image_of(texels)
    assert found.shape == expected.shape
    # A texel on whose border a ray ends may fall either way.
    off = np.abs(found - expected).max(-1)
    assert np.mean(off > 1e-5) <= 0.01, off.max()
    assert expected.std() > 0.02


@pytest.mark.parametrize("name", CANVASES)
@pytest.mark.parametrize("noise", [True, False])
def test_naive_is_the_source_s(name, noise, tmp_path):
    values = CANVASES[name]
    options = [] if noise else ["--no-noise"]
    expected = source.naive(source.texels_of(values), source.Naive(showNoise=noise))
    assert_same(published(tmp_path, values, "--published", "naive", *options), expected)


@pytest.mark.parametrize(
    ("options", "uniforms"),
    [
        (["--steps", 7], {"maxSteps": 7}),
        (["--steps", 6, "--no-accumulate"], {"maxSteps": 6, "accumRadiance": False}),
        (["--rays", 3], {"rayCount": 3}),
    ],
)
def test_naive_switches(options, uniforms, tmp_path):
    values = CANVASES["wide"]
    expected = source.naive(source.texels_of(values), source.Naive(**uniforms))
    assert_same(published(tmp_path, values, "--published", "naive", *options), expected)


@pytest.mark.parametrize("name", CANVASES)
@pytest.mark.parametrize("grain", [True, False])
@pytest.mark.parametrize("noise", [True, False])
def test_gi_is_the_source_s(name, noise, grain, tmp_path):
    values = CANVASES[name]
    options = [*([] if noise else ["--no-noise"]), *([] if grain else ["--no-grain"])]
    uniforms = source.Gi(showNoise=noise, showGrain=grain)
    expected = source.gi(source.texels_of(values), uniforms)
    assert_same(published(tmp_path, values, "--published", "gi", *options), expected)


@pytest.mark.parametrize(
    ("options", "uniforms", "slider"),
    [
        (["--no-sun"], {"enableSun": False}, None),
        (["--rays", 5, "--steps", 9], {"rayCount": 5, "maxSteps": 9}, None),
        (["--steps", 1], {"maxSteps": 1}, None),
        (["--sun-angle", math.degrees(-1.3)], {"sunAngle": 1.3}, None),
        (["--passes", 2], {}, 2),
        (["--passes", 0], {}, 0),
    ],
)
def test_gi_switches(options, uniforms, slider, tmp_path):
    values = CANVASES["high"]
    expected = source.gi(source.texels_of(values), source.Gi(**uniforms), slider)
    assert_same(published(tmp_path, values, "--published", "gi", *options), expected)


def test_frames_are_mixed_as_in_the_source(tmp_path):
    """Time counts from 0, and the first frame is not mixed with what was there."""
    values = CANVASES["wide"]
    texels, last = source.texels_of(values), None
    for time in range(3):
        uniforms = source.Gi(rayCount=6, useTemporalAccum=True, time=float(time))
        last = source.gi(texels, uniforms, last=last)
    options = ["--published", "gi", "--rays", 6]
    mixed = published(tmp_path, values, *options, "--frames", 3)
    assert_same(mixed, last)
    # One frame: what a mix with darkness leaves a tenth of.
    dark = source.pixels(texels, lambda uv: (0.0, 0.0, 0.0, 1.0))
    later = source.Gi(rayCount=6, useTemporalAccum=True, time=2.0)
    tenth = source.image_of(source.gi(texels, later, last=dark))
    single = published(tmp_path, values, *options, "--time", 2)
    np.testing.assert_allclose(single, 10 * tenth, atol=1e-5)


def test_one_pixel_is_a_seed_whatever_it_is():
    """The flood of one pixel has no pass, which the source takes for its slider at 0."""
    one = source.texels_of(np.uint8([[[0, 0, 0, 0]]]))
    assert source.df_pass(source.jfa_pass(source.seed_pass(one)))[0][0][0] == 0
    np.testing.assert_array_equal(distance_texture(np.zeros((1, 1))), [[0.0]])
    np.testing.assert_array_equal(render_published(empty(1, 1), GlobalIllumination()), 0)


def test_an_array_has_the_colours_that_its_alpha_was_multiplied_into():
    values = CANVASES["square"]
    shares = values / 255
    made = canvas(shares[..., :3] * shares[..., 3:], shares[..., 3])
    expected = source.naive(source.texels_of(values), source.Naive())
    np.testing.assert_allclose(
        render_published(made, NaiveMarch()), source.image_of(expected), atol=1e-9
    )


def test_the_hash_is_in_double_precision(single_precision):
    expected = [[source.rand(((i + 0.5) / 8 + 2, (4.5 - j) / 5 + 2)) for i in range(8)]
                for j in range(5)]  # fmt: skip
    np.testing.assert_allclose(hash_noise((5, 8), 2.0), expected, atol=1e-9)
    assert hash_noise((64, 64)).std() == pytest.approx(1 / math.sqrt(12), rel=0.03)


def test_defect_of_naive_rays_are_a_radian_apart_and_uneven():
    """A lamp far away lights the pixel from the directions 2 pi / R + i + .1 alone."""
    rays, size = 8, 61
    y, x = np.indices((size, size)) - size // 2
    ring = np.abs(np.hypot(x, y) - 28) < 1.5
    clockwise = np.arctan2(y, x)

    def lit(angle):
        apart = np.abs((clockwise - angle + math.pi) % (2 * math.pi) - math.pi)
        opacity = (ring & (apart < 0.06)).astype(float)
        made = canvas(np.repeat(opacity[..., None], 3, -1), opacity)
        return render_published(made, NaiveMarch(noise=False))[size // 2, size // 2, 0]

    angles = np.sort((2 * math.pi / rays + np.arange(rays) + 0.1) % (2 * math.pi))
    gaps = np.diff(np.append(angles, angles[0] + 2 * math.pi))
    assert gaps.max() > 2 * gaps.min()
    np.testing.assert_allclose([lit(angle) for angle in angles], 1 / rays)
    widest = gaps.argmax()
    assert lit(angles[widest] + gaps[widest] / 2) == 0


def test_gi_rays_are_even():
    """Wherever a narrow sun stands, one ray in as many meets it, and only at its own angle."""
    for angle in (0.0, 77.0, 200.0):
        shader = GlobalIllumination(
            noise=False, sun_angle=angle, sun_width=0.5, sun=WHITE, sky=DARK
        )
        np.testing.assert_allclose(render_published(empty(3, 3), shader), 1 / 32)


def test_defect_of_gi_the_sun_fades_to_one_side():
    """With one ray a pixel its angle past the sun is 2 pi times the noise: light jumps to all of
    the sun at 0 and is gone after a radian. Nothing is on the other side."""
    size = 40, 50
    made = empty(*size)
    # No distance to a corner that a ray could creep along.
    shader = GlobalIllumination(rays=1, grain=False, sun=WHITE, sky=DARK, steps=1)
    past = 2 * math.pi * hash_noise(size)
    expected = [source.smoothstep(1.0, 0.0, p) for p in past.ravel()]
    found = render_published(made, shader)[..., 0].ravel()
    np.testing.assert_allclose(found, expected, atol=1e-7)
    assert found[past.ravel() > 1].max() == 0
    assert found[past.ravel() < 0.05].min() > 0.9


def test_the_sun_stands_where_its_angle_says():
    """Counterclockwise from the right: a wall to the right hides a sun at 0 and none at 180."""
    opacity = np.zeros((40, 40))
    opacity[:, 30:32] = 1
    made = canvas(np.zeros((40, 40, 3)), opacity)

    def middle(angle):
        shader = GlobalIllumination(noise=False, sun=WHITE, sky=DARK, sun_angle=angle, steps=99)
        return render_published(made, shader)[20, 20, 0]

    assert middle(0.0) < 0.2 * middle(180.0)
    # It fades clockwise: below the wall's middle there is the wall, above it is not reached.
    assert middle(110.0) > middle(70.0)


def test_defect_an_empty_canvas_has_a_distance_to_the_corner():
    far = distance_texture(np.zeros((30, 40)))
    u, v = (np.arange(40) + 0.5) / 40, 1 - (np.arange(30) + 0.5) / 30
    np.testing.assert_allclose(far, np.minimum(np.hypot(u[None], v[:, None]), 1), atol=1e-12)
    nothing = jnp.zeros((30, 40), bool)
    assert (np.asarray(jump_flood(nothing).distance) == np.inf).all()


def test_defect_distances_are_not_metric_where_the_canvas_is_not_square():
    seed = np.zeros((50, 100))
    seed[25, 50] = 1
    far = distance_texture(seed)
    assert far[45, 50] / far[25, 70] == pytest.approx(2.0)
    ours = np.asarray(jump_flood(jnp.asarray(seed > 0)).distance)
    assert ours[45, 50] == ours[25, 70] == 20


def test_defect_a_semi_transparent_seed_is_elsewhere():
    """At half its texture coordinates: the pixel itself is far from it."""
    alpha = np.zeros((40, 40))
    alpha[9, 30] = 0.5
    far = distance_texture(alpha)
    u, v = 30.5 / 40, 30.5 / 40
    assert far[9, 30] == pytest.approx(math.hypot(u / 2, v / 2))
    row, column = np.unravel_index(far.argmin(), far.shape)
    assert abs(column + 0.5 - 20 * u) <= 1
    assert abs(39.5 - row - 20 * v) <= 1


def test_defect_epsilon_is_under_a_pixel_and_rays_starve_beside_a_wall():
    """Above a long black floor the lower half of the circle is dark. The published rays that run
    beside the floor use up their steps, and the sky shines through it."""
    h, w = 60, 240
    opacity = np.zeros((h, w))
    opacity[42:] = 1
    made = canvas(np.zeros((h, w, 3)), opacity)

    def near(steps):
        shader = GlobalIllumination(rays=96, grain=False, steps=steps, sun=DARK, sky=WHITE)
        return render_published(made, shader)[41, 90:150, 0].mean()

    # Beside a seed the field is one pixel: a ray that falls by less than that in 32 steps.
    assert near(8) > near(32) > near(300)
    assert near(300) == pytest.approx(0.5 + math.atan(0.5 / 120) / math.pi, abs=0.02)


def test_defect_accumulation_forgets():
    """Eleven frames mixed as published are worth 5.96; the running mean keeps all eleven."""
    assert effective_frames(weights(11, "mix")) == pytest.approx(5.96, abs=5e-3)
    assert effective_frames(weights(11)) == pytest.approx(11)
    assert effective_frames(weights(1000, "mix")) == pytest.approx(19, abs=1e-6)
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(11, 40_000))
    for how, frames in (("mix", 5.96), ("mean", 11.0)):
        kept = accumulated(iter(noise), how)
        np.testing.assert_allclose(kept, weights(11, how) @ noise, atol=1e-12)
        assert 1 / kept.var() == pytest.approx(frames, rel=0.05)


def test_gi_finds_a_disc():
    """Many even rays in many steps find the share of the circle that a disc fills. It is half a
    pixel larger than drawn: pixels stick out."""
    y, x = np.indices((80, 80)) - 39.5
    away = np.hypot(x, y)
    opacity = (away < 14).astype(float)
    made = canvas(np.repeat(opacity[..., None], 3, -1), opacity)
    shader = GlobalIllumination(rays=256, steps=300, grain=False, enable_sun=False)
    far = away > 20
    found = render_published(made, shader)[..., 0][far]
    expected = np.arcsin(14.5 / away[far]) / math.pi
    assert abs(found.mean() / expected.mean() - 1) < 0.02


def test_a_drawing_s_sky_is_that_of_the_gi_pass(tmp_path):
    """And no matter to the naive march, which has none."""
    file, out = tmp_path / "s.toml", tmp_path / "o.npy"
    file.write_text(
        "[image]\nwidth = 18\nheight = 12\n[sky]\nsun_angle = 60\nsun = [2, 1, 1]\n"
        '[[shape]]\nkind = "disc"\ncentre = [0.7, 0.5]\nradius = 0.2\nradiance = "#ff8000"\n'
    )
    gi = GlobalIllumination(sun_angle=60.0, sun=(2.0, 1.0, 1.0), time=3.0)
    for name, shader, options in (("gi", gi, ["--time", "3"]), ("naive", NaiveMarch(), [])):
        command = ["render", str(file), "--model", "flatland", "-o", str(out), "--published", name]
        assert main([*command, *options]) == 0
        expected = render_published(read_canvas(file), shader)
        np.testing.assert_allclose(np.load(out), expected, atol=1e-6)
    # Not clamped: the sun is brighter than white.
    assert render_published(read_canvas(file), gi).max() > 1


def test_only_passes_that_the_flood_has():
    assert [flood_passes(size) for size in ((1, 1), (2, 1), (300, 300), (64, 65))] == [0, 1, 9, 7]
    with pytest.raises(InputError, match="passes: expected a whole number from 0 to 5 on a canvas"):
        render_published(empty(20, 30), GlobalIllumination(passes=6))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: weights(0), "frames: expected 1 or more, got 0"),
        (lambda: weights(3, "sum"), "accumulation: expected mean or mix, got 'sum'"),
        (lambda: weights(3, "mix", 1.0), "history: expected a share from 0 to below 1"),
        (lambda: accumulated([]), "frames: expected 1 or more, got none"),
        (lambda: NaiveMarch(rays=0), "rays: expected a whole number from 1 to"),
        (lambda: GlobalIllumination(steps=-1), "steps: expected a whole number from 0 to"),
        (lambda: GlobalIllumination(time=math.inf), "time: expected a finite number, got inf"),
        (lambda: GlobalIllumination(sun_width=0.0), "sun width: expected degrees above 0"),
        (
            lambda: render(empty(2, 2), published=True),
            r"published: expected a call of render_published\(canvas, NaiveMarch\(\)\) .* got True",
        ),
    ],
)
def test_nonsense_is_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_no_derivative():
    made = empty(3, 4)

    def by_canvas(radiance):
        return render_published(Canvas(radiance, made.opacity), NaiveMarch()).sum()

    with pytest.raises(ValueError, match="'published' has no derivative"):
        jax.grad(by_canvas)(made.radiance)


def test_bytes_are_a_canvas():
    made = from_rgba(np.uint8([[[255, 0, 51, 102]]]))
    np.testing.assert_allclose(made.radiance, [[[0.4, 0, 0.08]]], atol=1e-7)
    np.testing.assert_allclose(made.opacity, [[0.4]], atol=1e-7)

"""Models: from parameters and a mask to the image on its background."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from godfit.models.coordinates import DENSITY
from godfit.models.disc_light import DiscLight
from godfit.models.mitchell import Mitchell
from godfit.runtime import xla_ffi
from godfit.scattering import upsample
from godfit.scattering.radial import radial_sum
from tests.support import scattering_oracle as oracle
from tests.support.compiling import quick_filter_jit

RNG = np.random.default_rng(0)
MASK = jnp.asarray(oracle.smooth_mask(11, 13))
COLOURS = jnp.asarray(RNG.random((11, 13, 3)))
BACKGROUND = jnp.asarray(RNG.random((11, 13)))
LIGHT = (0.3, 0.8)
POINT = (0.13, 0.93, 0.77, 0.6)
# Others are compared with their formulas, blend included, in scattering/test_conventions.py.
OWN_SUMS = (*oracle.FACTORS, "three")


def model(shader="mitchell", light=LIGHT, point=POINT, samples=9):
    return Mitchell(*point, light, shader, samples)


@quick_filter_jit
def render(model, mask, background=None, **options):
    return model(mask, background, **options)


def texture(image, size):
    """The image read at the pixel centres of another size, as a shader reads a texture."""
    u, v = oracle.pixel_centres(*size)
    channels = np.moveaxis(np.atleast_3d(np.asarray(image)), -1, 0)
    out = np.stack([oracle.texture(c, u, v) for c in channels], -1)
    return out if image.ndim == 3 else out[..., 0]


def test_values_are_in_the_order_of_the_table():
    three = Mitchell(*POINT, [[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]])
    names = "exposure decay density weight light_x light_y light2_x light2_y light3_x light3_y"
    assert list(three.parameters) == names.split()
    assert list(three.values()) == names.split()
    numbers = [float(v) for v in three.values().values()]
    assert numbers == [*POINT, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    assert [p.name for p in three.parameters.values()] == names.split()
    assert [len(b) for b in three.bounds()] == [10, 10]


def test_density_goes_on_beyond_the_light_but_for_bare_pictures():
    shading = Mitchell(*POINT, LIGHT)
    bare = DiscLight(shading, [0.1, 0.01, 0.0], np.zeros((1, 1)))
    for one, most in ((shading, 2.0), (bare, 1.0)):
        assert one.bounds()[1][DENSITY] == most
        assert one.parameters["density"].upper == most


@pytest.mark.parametrize(
    ("shader", "density", "free", "count"),
    [
        ("dawntime", 1.0, ["density"], 1),
        ("vesper", 0.9995, ["decay", "density"], 1),
        ("dawntime", 1.0, ["decay"], 0),
        ("dawntime", 1.01, ["density"], 0),
        ("babylon", 1.0, ["density"], 0),
    ],
)
def test_the_end_of_a_slider_is_noted(shader, density, free, count):
    """Of shaders whose slider is published, where density was fitted."""
    notes = Mitchell(0.1, 0.9, density, 0.6, LIGHT, shader).notes(free)
    assert notes == (f"density is 1, where the slider of {shader} ends",) * count


def test_a_decay_of_zero_has_coordinates():
    model = Mitchell(0.1, 0.0, 0.8, 0.5, (0.5, 0.5))
    z = model.coordinates()
    assert np.isfinite(np.asarray(z)).all()
    assert float(model.moved(z).decay) < 1e-9


def test_samples_default_to_the_shaders_own():
    assert Mitchell(*POINT, LIGHT, "vesper").samples == 150
    assert Mitchell(*POINT, LIGHT).samples == 100


@pytest.mark.parametrize("shader", OWN_SUMS)
def test_several_lights_are_a_sum_over_lights(shader):
    lights = [(0.3, 0.8), (1.4, 0.1), (0.5, -0.3)]
    together = render(model(shader, lights), MASK)
    apart = sum(render(model(shader, light), MASK) for light in lights)
    np.testing.assert_allclose(together, apart, rtol=1e-13)


@pytest.mark.parametrize("shader", OWN_SUMS)
def test_composite(shader):
    """The light pass on the background: added, 1.1 times it for the article's and Babylon's, and
    screened, 1 - (1 - a)(1 - b), for pmndrs."""
    light = np.asarray(render(model(shader), MASK))
    image = render(model(shader), MASK, BACKGROUND)
    if shader == "pmndrs":
        expected = 1 - (1 - BACKGROUND) * (1 - light)
    else:
        gain = 1.1 if shader in ("article-glsl", "article-hlsl", "babylon") else 1.0
        expected = gain * BACKGROUND + light
    np.testing.assert_allclose(image, expected, rtol=1e-12)


@pytest.mark.parametrize("shader", ["mitchell", "pmndrs"])
def test_colours(shader):
    """Each channel of mask and background by itself; grey is all three channels."""
    background = jnp.asarray(np.random.default_rng(1).random((11, 13, 3)))
    both, mask_only, background_only = (
        render(model(shader), COLOURS, background),
        render(model(shader), COLOURS, BACKGROUND),
        render(model(shader), MASK, background),
    )
    assert both.shape == mask_only.shape == background_only.shape == (11, 13, 3)
    for c in range(3):
        each = [
            render(model(shader), COLOURS[..., c], background[..., c]),
            render(model(shader), COLOURS[..., c], BACKGROUND),
            render(model(shader), MASK, background[..., c]),
        ]
        for image, expected in zip((both, mask_only, background_only), each, strict=True):
            np.testing.assert_allclose(image[..., c], expected, rtol=1e-13)


# A bright point, so that the light pass is over 1 in places.
BRIGHT = (0.5, 0.98, 0.9, 0.5)


@pytest.mark.parametrize("mask", [MASK, COLOURS], ids=["grey", "colour"])
def test_half_resolution_is_jax_linear_resize(mask):
    bright = model(point=BRIGHT)
    low = render(bright, mask)
    assert (low > 1).mean() > 0.05
    size = (22, 26)
    expected = jax.image.resize(jnp.clip(low, 0, 1), (*size, *mask.shape[2:]), "linear")
    np.testing.assert_allclose(render(bright, mask, size=size), expected, rtol=1e-12)


@pytest.mark.parametrize("size", [(22, 26), (25, 31), (12, 13)])
@pytest.mark.parametrize("mask", [MASK, COLOURS], ids=["grey", "colour"])
def test_upsampling_is_a_texture_read(mask, size):
    """Also at odd ratios: the light pass at the mask's size, clamped as its 8-bit texture is, then
    read bilinearly."""
    bright = model(point=BRIGHT)
    expected = texture(np.clip(render(bright, mask), 0, 1), size)
    np.testing.assert_allclose(render(bright, mask, size=size), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("size", "mask", "background"),
    [
        ((11, 13), MASK, None),
        ((11, 13), COLOURS, "colour"),
        ((25, 31), MASK, None),
        ((25, 31), COLOURS, "grey"),
        ((25, 31), MASK, "colour"),
    ],
    ids=["full, grey", "full, colour", "grey", "colour on grey", "grey on colour"],
)
def test_pixels_are_those_of_the_whole_image(size, mask, background):
    """A few pixels and many take different ways when the pass is smaller than the image."""
    rng = np.random.default_rng(2)
    channels = {None: None, "grey": (), "colour": (3,)}[background]
    back = None if channels is None else jnp.asarray(rng.random((*size, *channels)))
    bright = model("pmndrs", point=BRIGHT)
    image = render(bright, mask, back, size=size)
    flat = np.asarray(image).reshape(-1, *image.shape[2:])
    corners = [0, size[1] - 1, len(flat) - size[1], len(flat) - 1]
    for count in (9, len(flat) // 2):
        chosen = np.concatenate([corners, rng.permutation(len(flat))[:count]])
        assert (4 * len(chosen) < mask.shape[0] * mask.shape[1]) == (count == 9)
        some = render(bright, mask, back, size=size, pixels=jnp.asarray(chosen))
        np.testing.assert_allclose(some, flat[chosen], rtol=1e-12)


@pytest.mark.parametrize("mask", [MASK, COLOURS], ids=["grey", "colour"])
@pytest.mark.parametrize("size", [(25, 31), (47, 64)])
def test_texels_are_read_once(size, mask, monkeypatch):
    """A block of neighbours, from the texels that it needs, is that of the whole image."""
    monkeypatch.setattr(upsample, "POINT_COST", 0)
    monkeypatch.setattr(upsample, "MIN_PADDED_TEXELS", 5)
    bright = model(point=BRIGHT)
    image = render(bright, mask, size=size)
    rows, columns = np.mgrid[size[0] - 6 : size[0], 0:9]
    chosen = (rows * size[1] + columns).ravel()
    texels = upsample.Texels.of(chosen, size, mask.shape[:2])
    assert texels is not None
    assert len(texels.at) < len(chosen)
    read = render(bright, mask, size=size, pixels=jnp.asarray(chosen), texels=texels)
    expected = np.asarray(image).reshape(-1, *image.shape[2:])[chosen]
    # Shares are kept in single precision.
    np.testing.assert_allclose(read, expected, rtol=1e-6)


def test_whole_pass_is_rendered_where_that_costs_less():
    pixels = np.arange(4000)
    assert upsample.Texels.of(pixels, (200, 200), (50, 50)) is None
    assert upsample.Texels.of(pixels, (100, 120), (99, 119)) is None
    assert upsample.Texels.of(pixels, (1000, 1000), (500, 500)) is not None


def test_both_methods_give_the_same_image():
    images = [render(model(), MASK, BACKGROUND, method=m) for m in ("pairs", "reference")]
    np.testing.assert_allclose(*images, rtol=1e-13)


def test_three_is_three_box_blurs_towards_the_light():
    """Passes of six taps, own pixel and five at steps of 6^-p in texture coordinates; those beyond
    the light count nothing; on the inverted mask, shown inverted."""
    mask, (light_u, light_v) = oracle.hard_mask(11, 13), LIGHT
    h, w = mask.shape
    image = 1 - mask
    for p in (1, 2, 3):
        blurred = np.zeros_like(image)
        for row in range(h):
            for column in range(w):
                u, v = (column + 0.5) / w, 1 - (row + 0.5) / h
                distance = np.hypot(light_u - u, light_v - v)
                for k in range(6):
                    if k / 6**p <= distance:
                        at = u + k / 6**p / distance * (light_u - u)
                        up = v + k / 6**p / distance * (light_v - v)
                        read = oracle.texture(image, np.array([at]), np.array([up]))
                        blurred[row, column] += read[0] / 6
        image = blurred
    expected = 0.69 * (1 - image)
    actual = render(model("three", point=(0.69, 1.0, 1.0, 1.0)), jnp.asarray(mask))
    np.testing.assert_allclose(actual, expected, rtol=1e-11)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int64, np.float64, ">f4", np.float32])
def test_a_mask_of_any_type_is_its_light(dtype):
    """Compiled code reads a mask's bytes as floats: every type is converted before."""
    levels = np.random.default_rng(4).integers(0, 256, (14, 11))
    model = Mitchell(0.08, 0.97, 0.9, 0.6, light=(0.56, 0.6), shader="dawntime", samples=30)
    mask = (levels / 255).astype(dtype) if np.dtype(dtype).kind == "f" else levels.astype(dtype)
    if dtype == np.uint16:
        mask *= 257
    expected = np.asarray(model(jnp.asarray(levels / 255, jnp.float32)))
    for given in (mask, np.asfortranarray(mask), np.repeat(mask, 2, 0)[::2]):
        np.testing.assert_allclose(model(given), expected, rtol=1e-5, atol=1e-7)
    taps = model.taps[0]
    np.testing.assert_allclose(
        radial_sum(mask, model.light[0], taps), model.light_pass(mask), rtol=1e-5, atol=1e-7
    )


def test_compiled_code_refuses_other_types_and_ranks():
    shaped = jax.ShapeDtypeStruct((1, 3, 4), jnp.float32)
    for mask, words in (
        (jnp.zeros((3, 4), jnp.uint8), "got 2 in uint8"),
        (jnp.zeros((3, 4, 3), jnp.float32), "got 3 in float32"),
        (jnp.zeros((3, 4), jnp.float64), "got 2 in float64"),
    ):
        with pytest.raises(TypeError, match=words):
            xla_ffi.call("any", shaped, mask, ranks="2")


@pytest.mark.parametrize(
    ("shader", "size"),
    [("dawntime", (5, 6)), ("dawntime", (11, 6)), ("dawntime", (22, 29)), ("pmndrs", (22, 29))],
)
def test_a_pass_of_the_picture_s_size_reads_the_mask_between_its_texels(shader, size):
    """A larger mask always, a smaller one where the pass has the picture's size."""
    own, dropped, order, gain = oracle.FACTORS[shader]
    exposure, decay, density, weight = POINT
    u, v = oracle.pixel_centres(*size)
    total = own * oracle.texture(MASK, u, v)
    for i in range(1, 9 - dropped + 1):
        t = i * density / 9
        read = oracle.texture(MASK, u + t * (LIGHT[0] - u), v + t * (LIGHT[1] - v))
        total = total + weight * decay ** (i - order) * read
    expected = exposure * gain * total
    at = Mitchell(*POINT, LIGHT, shader, 9, full_size=True)
    np.testing.assert_allclose(render(at, MASK, size=size), expected, atol=1e-12)
    some = jnp.asarray([3, 7, 20])
    np.testing.assert_allclose(
        render(at, MASK, size=size, pixels=some), expected.reshape(-1)[some], atol=1e-12
    )
    if size[0] <= MASK.shape[0]:
        same = eqx.tree_at(lambda m: m.exposure, model(shader), at.exposure)
        np.testing.assert_allclose(render(same, MASK, size=size), expected, atol=1e-12)

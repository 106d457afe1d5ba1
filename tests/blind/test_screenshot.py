"""A picture that comes with nothing: each step against what made the picture, and all of them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import godfit
from godfit.blind import beginnings, beside, first_look, screen_disc, screenshot, unaided
from godfit.blind.explained import explained, grain
from godfit.blind.no_rays import CLEAR_RAYS, RAYS, objection
from godfit.blind.occluders import asked
from godfit.blind.segment import light_colour, panels, segments
from godfit.blind.turns import Read
from godfit.inference.estimates import Estimate
from godfit.inference.likelihood import ANY_LEVEL, deviance_residuals, interval
from godfit.inference.observation import Picture
from godfit.inference.problem import Problem
from godfit.inference.solver import Point, solve
from godfit.io.sources import read_source, shrink_mask
from godfit.models.background import DARKEST_BACKGROUND, TERM_COUNTS
from godfit.models.bare_picture import DERIVATIVE_EDGE
from godfit.models.bright_pass import BrightPass
from godfit.models.coordinates import FIRST_BACKGROUND, GAIN, LIGHT_X, LIGHT_Y, VEIL
from godfit.models.disc_light import DiscLight
from godfit.models.mitchell import Mitchell
from godfit.report.verdict import _undetermined_place
from tests.support.synthetic import screens

made = screens.make_screenshot

SIZE = (90, 160)


ORANGE = (1.4, 0.6)


def disc_model(terms=1, samples=40, tint=()):
    shading = Mitchell(0.05, 0.98, 0.8, 0.7, [0.4513, 0.6071], "dawntime", samples)
    background = np.zeros((terms, 3))
    background[0] = 0.1, 0.2, 0.3
    background[1:] = 0.02
    return DiscLight(shading, [0.15, 0.01, 0.06], background, tint)


def beside_panels(screen):
    """(h, w) where no panel lies on top."""
    valid = np.ones(screen.image.shape[:2], bool)
    for x, y, w, h in screen.panels:
        valid[y : y + h, x : x + w] = False
    return valid


@pytest.mark.parametrize("foreign", [0.01, 0.3])
def test_heavy_tails_are_a_mixture(foreign):
    """Of the Gaussian's interval and of any level alike; slope and residuals are its own."""
    f = jnp.linspace(-30.0, 30.0, 121)
    lo, hi, sigma = -0.5, 0.5, 0.7
    pixel = interval((lo - f) / sigma, (hi - f) / sigma, foreign)
    own = norm.cdf((hi - f) / sigma) - norm.cdf((lo - f) / sigma)
    np.testing.assert_allclose(
        pixel.log, np.log((1 - foreign) * own + foreign * ANY_LEVEL), rtol=1e-10
    )

    def log(f):
        return interval((lo - f) / sigma, (hi - f) / sigma, foreign).log.sum()

    np.testing.assert_allclose(pixel.slope / sigma, jax.grad(log)(f), atol=1e-10)
    ends = jnp.full(121, lo), jnp.full(121, hi)
    r = deviance_residuals(f, *ends, jnp.asarray(sigma), foreign)
    np.testing.assert_allclose(r**2 / 2, pixel.log.max() - pixel.log, atol=1e-9)
    # What is far off pulls no more.
    assert abs(float(pixel.slope[0])) < 1e-12


def test_mask_is_a_disc_on_a_veil_behind_what_is_open():
    model = disc_model()
    open_ = jnp.ones(SIZE).at[:, :40].set(0.0)
    mask = np.asarray(model.occlusion(open_))
    h, w = SIZE
    x, y = np.meshgrid((np.arange(w) + 0.5) / h, 1 - (np.arange(h) + 0.5) / h)
    away = np.hypot(x - 0.4513 * w / h, y - 0.6071)
    assert (mask[:, :40] == 0).all()
    inside, outside = mask[:, 40:][away[:, 40:] < 0.05], mask[:, 40:][away[:, 40:] > 0.3]
    np.testing.assert_allclose(inside, 1, atol=1e-4)
    np.testing.assert_allclose(outside, 0.06, atol=1e-4)


def test_derivatives_agree_with_differences():
    """Of every coordinate, the background's and the tint, that the light pass does not depend on,
    among them."""
    model, open_ = disc_model(6, tint=ORANGE), jnp.ones(SIZE).at[30:60, 60:75].set(0.0)
    pixels = jnp.asarray(np.random.default_rng(0).permutation(90 * 160)[:200])
    z = np.asarray(model.coordinates(), np.float64)

    @jax.jit
    def predict(z):
        return model.moved(z)(open_, size=SIZE, pixels=pixels, method="reference").reshape(-1)

    found = np.asarray(jax.jit(jax.jacfwd(predict))(jnp.asarray(z)))
    for i in range(len(z)):
        step = np.zeros(len(z))
        step[i] = 1e-7 if i < FIRST_BACKGROUND else 1e-4
        central = (predict(z + step) - predict(z - step)) / (2 * step[i])
        size = np.abs(found[:, i]).max()
        np.testing.assert_allclose(found[:, i], central, atol=2e-4 * size + 1e-9)


def test_a_hard_edge_has_the_derivatives_of_a_softer_one():
    """A disc steps from texel to texel; its derivatives are those of what it does on average."""
    shading = disc_model().shading
    open_ = jnp.ones(SIZE)
    pixels = jnp.asarray(np.random.default_rng(0).permutation(90 * 160)[:2000])

    @jax.jit
    def light(radius, edge):
        model = DiscLight(shading, [radius, edge, 0.06], np.zeros((1, 3)))
        return model.light_pass(open_, size=SIZE, pixels=pixels, method="reference")

    _, slope = jax.jvp(lambda radius: light(radius, 1e-6), (0.15,), (1.0,))
    away = np.arange(-8, 9) / 8 / SIZE[0]
    steps = np.array([light(0.15 + d, 1e-6) for d in away])
    average = np.polyfit(away, steps, 1)[0]
    assert np.unique(np.round(steps, 9), axis=0).shape[0] > 8
    size = np.abs(average).max()
    assert np.abs(np.asarray(slope) - average).mean() < 0.05 * size
    np.testing.assert_allclose(slope.mean(), average.mean(), rtol=0.1)


@pytest.mark.parametrize("edge", [1e-6, 0.02])
def test_slopes_of_the_mask_are_those_of_dual_numbers(edge):
    """In closed form, also where what is more than open is clamped; and those of a bright-pass."""
    rng = np.random.default_rng(2)
    open_ = jnp.asarray(rng.uniform(0, 1.6, SIZE))
    disc = disc_model()
    models = [
        DiscLight(disc.shading, [0.15, edge, 0.06], np.zeros((1, 3))),
        BrightPass(disc.shading, [0.6, 0.05, 0.1], np.zeros((1, 3)), 0.2),
    ]
    for model in models:
        place = jnp.concatenate([model.light[0], model.shape])

        def mask(place, model=model):
            numbers = jnp.concatenate([jnp.stack([*model.shading.values().values()])[:4], place])
            least = () if isinstance(model, BrightPass) else (DERIVATIVE_EDGE,)
            return model._with_numbers(numbers).occlusion(open_, *least)

        expected = jax.jit(jax.jacfwd(mask))(place)
        found = np.stack(model.occlusion_slopes(open_, DERIVATIVE_EDGE), -1)
        size = np.abs(expected).max((0, 1))
        assert (size[2 * isinstance(model, BrightPass) :] > 0)[[0, 2]].all()
        np.testing.assert_allclose(found, expected, atol=1e-9 * (1 + size.max()))


def test_the_picture_is_linear_in_what_disc_and_veil_add():
    model, open_ = disc_model(), jnp.ones(SIZE).at[30:60, 60:75].set(0.0)
    z = np.array(model.coordinates())
    # A pixel's own value, which exposure alone scales, knows the veil's share and not its light.
    z[0] = 1e-9
    z[FIRST_BACKGROUND:] = 0

    def picture(disc, veil):
        at = model.moved(np.concatenate([z[:GAIN], [disc], z[4:VEIL], [veil], z[9:]]))
        return np.asarray(at(open_, method="reference"))

    both = 2 * picture(0.3, 0.0) + 3 * picture(0.0, 0.05)
    np.testing.assert_allclose(picture(0.6, 0.15), both, atol=1e-6)


@pytest.mark.parametrize("name", ["veil", "weight", "blue"])
def test_what_is_held_stays_and_the_rest_comes_back(name):
    model = disc_model(tint=ORANGE)
    held = np.full(len(model.parameters), np.nan)
    held[list(model.parameters).index(name)] = float(model.values()[name])
    again = model.moved(model.coordinates(), held).values()
    for key, value in model.values().items():
        np.testing.assert_allclose(again[key], value, rtol=1e-9, err_msg=key)


@pytest.mark.parametrize("colour", [(1, 1, 1), (1.4, 1, 0.6), (0.3, 1, 0.9)])
def test_another_colour_and_panels_are_told_from_the_background(colour):
    """Light changes channels in its own ratio, objects do not; a clipped channel only bounds
    them."""
    rng = np.random.default_rng(1)
    x, y = np.meshgrid(np.linspace(0, 1, 160), np.linspace(0, 1, 90))
    ground = np.stack([40 + 20 * x, 70 + 10 * y, 90 - 15 * x], -1)
    light = 400 * np.exp(-((x - 0.6) ** 2 + (y - 0.5) ** 2) / 0.05)
    solid = np.hypot(x - 0.3, (y - 0.5) * 0.6) < 0.1
    picture = np.where(solid[..., None], (60.0, 40, 30), ground) + light[..., None] * colour
    picture = np.floor(picture + rng.uniform(0, 1, (90, 160, 1))).clip(0, 255)
    picture[5:45, 120:155] = 33
    picture[10:14, 125:150] = 200
    known = np.ones(SIZE, bool)
    read = light_colour(picture, 0.5, known)
    np.testing.assert_allclose(read, colour, atol=0 if colour == (1, 1, 1) else 0.01)
    found = segments(picture, 0.5, known, read)
    expected = solid.copy()
    expected[5:45, 120:155] = True
    glare = picture.min(-1) >= 254
    assert (found.other & ~expected).mean() < 1e-3
    assert (expected & ~found.other & ~glare).mean() < 2e-3
    ((left, top, wide, tall),) = panels(found.other, picture)
    assert np.abs(np.array([left, top, wide, tall]) - [120, 5, 35, 40]).max() <= 1


@pytest.mark.parametrize("seed", [9018, 9034, 9061, 9062])
def test_a_background_that_varies_as_the_light_does_gives_it_no_colour(seed):
    screen = made(seed, "smooth")
    colour = light_colour(screen.image.astype(np.float32), 0.5, beside_panels(screen))
    np.testing.assert_array_equal(colour, 1)


@pytest.mark.parametrize(("kind", "varies"), [("flat", False), ("smooth", True)])
def test_a_background_that_hardly_varies_is_no_constant(kind, varies):
    """By little more than a level (rms) in one channel against another: rounding makes less."""
    screen = made(9289, kind)
    reading = screenshot.read(read_source(screen.image, "none"), beside_panels(screen), None)
    assert (reading.degree > 0) == varies


@pytest.mark.parametrize(
    ("scale", "tint"), [(1.0, ()), (0.5, ()), (1.0, ORANGE)], ids=["whole", "half", "coloured"]
)
def test_shadows_give_away_an_object_that_nothing_else_does(scale, tint):
    """An object of the background's own colour: with the light known, its shadow places it, in a
    light pass of the picture's size or of half, of white light or of another."""
    model, h, w = disc_model(tint=tint), *SIZE
    open_ = np.ones(SIZE, np.float32)
    open_[28:46, 76:88] = 0
    unknown = np.zeros(SIZE, np.float32)
    unknown[15:60, 60:100] = 1
    open_, unknown = shrink_mask(open_, scale), shrink_mask(unknown, scale) > 0
    every = jnp.arange(h * w)
    levels = 255 * np.asarray(model(jnp.asarray(open_), size=SIZE, pixels=every)).reshape(h, w, 3)
    levels = np.round(levels).clip(0, 255).astype(np.float32)
    nothing_known = np.ones_like(open_)
    picture = Picture(levels, 0.5, np.ones(SIZE, bool), nothing_known, None, "none")
    question = asked(model, picture, unknown, nothing_known, 4000, 0)
    assert question is not None
    found = question.answered().mask
    inner = slice(int(32 * scale), int(42 * scale)), slice(int(78 * scale), int(84 * scale))
    assert found[inner].mean() < 0.25
    assert found[unknown & (open_ == 1)].mean() > 0.85


@pytest.fixture(scope="module")
def looks():
    """What was seen of every picture that was looked at, in order."""
    return []


@pytest.fixture(scope="module", autouse=True)
def fewer_starts(looks):
    """Of clear pictures half as many say the same; as many pixels and taps at every look are one
    program to compile instead of three."""
    look = first_look.look

    def kept(*args):
        looks.append(look(*args))
        return looks[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(first_look, "STARTS", 3)
        patch.setattr(first_look, "FEW", first_look.MORE)
        patch.setattr(first_look, "COARSE_TAPS", first_look.TAPS)
        patch.setattr(beside, "BESIDE", {})
        patch.setattr(first_look, "look", kept)
        yield


@pytest.fixture(scope="module")
def screen():
    """One light before which nothing glares, and its fit."""
    screen = made(1022, "flat", SIZE)
    samples = int(screen.truth["samples"])
    return screen, godfit.fit(
        screen.image, shader="dawntime", samples=samples, valid=beside_panels(screen)
    )


def test_light_and_shader_are_read_off_a_screenshot(screen):
    screen, result = screen
    assert result.converged, result.message
    params, truth = result.params, screen.truth
    for name, tolerance in (("light_x", 0.005), ("light_y", 0.005), ("density", 0.05)):
        assert params[name].value == pytest.approx(truth[name], abs=tolerance)
    # A picture so small says little of decay, and says how little.
    off = params["decay"].value - truth["decay"]
    assert abs(off) < 3 * params["decay"].stderr < 0.05
    assert result.starts_agreed is not None
    assert result.starts_agreed[0] >= 2
    # What stands in the way: a grille and a lump, of other colours than the background.
    solid, truly = result.picture.mask < 0.5, screen.mask == 0
    assert (solid & ~truly).mean() < 0.005
    assert solid[truly].mean() > 0.9


def test_an_occluder_that_is_given_stands_in_the_way(screen):
    screen, _ = screen
    drawn = np.zeros(SIZE, bool)
    drawn[40:60, 100:120] = True
    reading = screenshot.read(read_source(screen.image, "none"), None, drawn)
    assert (reading.picture.mask[drawn] == 0).all()
    assert not reading.picture.valid[drawn].any()
    assert not reading.unknown[drawn].any()


def test_a_light_most_of_which_is_hidden_is_looked_for():
    """What is left of its disc lies beside it."""
    screen = made(9011, "flat")
    h, w = screen.image.shape[:2]
    picture = screenshot.read(
        read_source(screen.image, "none"), beside_panels(screen), None
    ).picture
    light = screen.truth["light_x"], screen.truth["light_y"]
    off = (screen_disc.places(picture.shrunk(2), 0) - light) * (w / h, 1)
    assert np.hypot(*off.T).min() < 0.03


def test_light_explains_rays_and_nothing_else(screen):
    screen, result = screen
    rng = np.random.default_rng(3)
    cells = np.kron(rng.integers(20, 180, (9, 16)), np.ones((10, 10)))
    # Of one colour: nothing is told apart as an object.
    picture = (cells[..., None] + [0, 20, 40]).astype(np.uint8)
    reading = screenshot.read(read_source(picture, "none"), None, None)

    shading = Mitchell(1, 0.9, 0.5, 0.5, [0.5, 0.5], "dawntime", result.model.samples)
    parameters = screenshot.template(shading, 3, reading.degree, reading.tint).parameters
    held = np.full(len(parameters), np.nan, np.float32)
    with jax.enable_x64(False):
        looked = first_look.look(reading, shading, {}, held, 0, lambda text: None)
    assert looked.explained < RAYS


def test_texture_is_not_asked_of_the_light():
    """It is told from a smooth background, and rays over it are explained by the light that made
    them and by no other."""
    screen = made(3003, "textured", (180, 320))
    picture = screenshot.read(read_source(screen.image, "none"), None, None).picture
    smooth = screenshot.read(
        read_source(made(3003, "smooth", (180, 320)).image, "none"), None, None
    )
    assert grain(picture) > 4
    assert grain(smooth.picture) < 1
    u, v = screen.truth["light_x"], screen.truth["light_y"]
    assert share_explained(screen, u, v) > 0.5
    assert share_explained(screen, 1 - u, 1 - v) < 0


def test_a_light_beside_the_picture_explains_it():
    """The few texels of a small copy, by which it is told, would be lit by another."""
    screen = made(9021, "smooth")
    assert screen.truth["light_x"] < 0
    light = screen.truth["light_x"], screen.truth["light_y"]
    assert share_explained(screen, *light) > 0.9


@jax.enable_x64(False)
def share_explained(screen, u, v):
    """By a light there, all else as it was: beside the picture, a softer edge would light it."""
    picture = screenshot.read(
        read_source(screen.image, "none"), beside_panels(screen), None
    ).picture
    mask = shrink_mask((screen.mask > 0).astype(np.float32), screen.pass_scale)
    picture = dataclasses.replace(picture, mask=mask)
    t = screen.truth
    four = (t[name] for name in ("exposure", "decay", "density", "weight"))
    shading = Mitchell(*four, [[u, v]], "dawntime", int(t["samples"]))
    model = DiscLight(
        shading, [t["radius"], 1e-5, t["veil"]], np.zeros((TERM_COUNTS[unaided.FINER], 3))
    )
    z = np.asarray(model.coordinates(), np.float32)
    held = np.full(len(z), np.nan, np.float32)
    seen = picture.observe(np.flatnonzero(picture.valid))
    z = beginnings.with_background(z, held, model, seen)
    return explained(z, held, model, picture, grain(picture))


def test_next_to_no_light_has_derivatives():
    model, open_ = disc_model(), jnp.ones(SIZE, jnp.float32)
    z = np.array(model.coordinates(), np.float32)
    z[[0, GAIN, VEIL]] = 1e-35, 0, 1e-32
    pixels = jnp.arange(100, dtype=jnp.int32)

    def picture(z):
        return model.moved(z)(open_, size=SIZE, pixels=pixels, method="reference")

    assert np.isfinite(jax.jacfwd(picture)(jnp.asarray(z, jnp.float32))).all()


@pytest.mark.parametrize("dark", [False, True], ids=["little", "dark"])
def test_without_rays_a_fit_does_not_converge(screen, looks, dark, monkeypatch):
    """And says so: here as if light explained but little of what varies, or as if its disc were no
    brighter than the veil."""
    screen, _ = screen
    lights = np.random.default_rng(0).random((12, 2))
    seen = looks[0]._replace(explained=(1.2 if dark else 0.9) * CLEAR_RAYS, lights=lights)
    if dark:
        z = seen.ends[0].coordinates.copy()
        z[LIGHT_X], z[LIGHT_Y], z[GAIN] = 0.4, 0.6, 0.05 * z[VEIL]
        seen = seen._replace(ends=(seen.ends[0]._replace(coordinates=z),))
    monkeypatch.setattr(first_look, "look", lambda *_: seen)
    samples = int(screen.truth["samples"])
    result = godfit.fit(
        screen.image, shader="dawntime", samples=samples, valid=beside_panels(screen)
    )
    assert not result.converged
    assert "no rays were found" in result.message
    assert ("nothing is brighter" in result.message) == dark


@pytest.mark.parametrize(
    ("agreed", "off", "said"),
    [((0, 12), 0.05, False), ((0, 12), 0.2, True), ((8, 12), 0.2, False), (None, 0.2, False)],
)
def test_light_from_anywhere_is_no_rays(agreed, off, said):
    """Unless other starts found the same, or none was tried."""
    params = {"light_x": Estimate(0.4, None), "light_y": Estimate(0.6, off)}
    words = _undetermined_place(agreed, params)
    assert ("no rays were found" in words and f"0.60 +- {off:.2f}" in words) == said


@pytest.mark.parametrize(
    ("kind", "degree"), [("flat", 0), ("smooth", unaided.FINER), ("textured", 2)]
)
def test_next_to_texture_the_background_is_no_finer_than_it_must_be(kind, degree):
    """It would make up for the light; elsewhere it is as in the end."""
    picture = read_source(made(3003, kind, (180, 320)).image, "none")
    assert unaided._degree(screenshot.read(picture, None, None)) == degree


@pytest.mark.parametrize(
    ("texture", "explained", "agreed", "rays"),
    [
        (4, 0.3, 0, True), (4, 0.2, 0, False), (4, 0.2, 4, False), (4, 0.03, 6, True),
        (4, 0.0, 6, False), (0, 0.8, 0, True), (0, 0.7, 0, False), (0, 0.7, 4, False),
        (0, 0.1, 6, True), (0, 0.0, 6, False),
    ],
)  # fmt: skip
def test_light_that_explains_little_is_rays_where_starts_agree(
    screen, looks, texture, explained, agreed, rays
):
    """Texture leaves little to be explained, and leads every start elsewhere where there is no
    light; of a picture without any, rays explain the most."""
    screen, _ = screen
    best = looks[0].ends[0].coordinates[LIGHT_X : LIGHT_Y + 1]
    lights = np.tile(best, (12, 1))
    lights[agreed:] += 0.1
    look = looks[0]._replace(explained=explained, lights=lights, texture=texture)
    picture = screenshot.read(
        read_source(screen.image, "none"), beside_panels(screen), None
    ).picture
    held = np.full_like(look.ends[0].coordinates, np.nan)
    assert (objection(look, held, picture) == "") == rays


@pytest.mark.usefixtures("single_precision")
def test_no_background_is_much_darker_than_black():
    """Where it would have to be, under far more veil than there is."""
    model = disc_model(samples=25)
    model = DiscLight(model.shading, model.shape, [[0, 0, 0.6]])
    open_ = np.ones(SIZE, np.float32)
    drawn = np.asarray(model(jnp.asarray(open_), size=SIZE))
    levels = np.round(255 * drawn.clip(0, 1)).astype(np.uint8)
    picture = Picture.make(read_source(levels, "none"), open_, None, None)
    start = np.array(model.coordinates(), np.float32)
    start[VEIL] *= 10
    free, held = np.arange(len(start)) >= FIRST_BACKGROUND, np.full_like(start, np.nan)
    seen = picture.observe(np.arange(0, SIZE[0] * SIZE[1], 7))
    found = solve(start, Problem(model, picture, free, held), seen, 1.0).coordinates
    assert (found[FIRST_BACKGROUND : FIRST_BACKGROUND + 2] == np.float32(DARKEST_BACKGROUND)).all()
    assert DARKEST_BACKGROUND < found[FIRST_BACKGROUND + 2] < 0.6
    anyhow = solve(start, Problem(model, picture, free, held), seen, 1.0, bounded=False).coordinates
    assert (anyhow[FIRST_BACKGROUND : FIRST_BACKGROUND + 2] < 2 * DARKEST_BACKGROUND).all()
    field = DiscLight(model.shading, model.shape, np.zeros((TERM_COUNTS[1], 3)))
    for each in (model, field):
        assert [p.lower for p in each.parameters.values()][FIRST_BACKGROUND:] == each.bounds()[0][
            FIRST_BACKGROUND:
        ]


def test_what_is_held_makes_the_same_light_of_fewer_taps():
    model = disc_model(samples=200)
    fewer = first_look._with_taps(model, 50)
    held = np.full(len(model.parameters), np.nan)
    held[1], held[3] = model.shading.decay, model.shading.weight
    open_ = jnp.ones(SIZE).at[30:60, 60:75].set(0.0)
    z = np.asarray(model.coordinates())
    at = fewer.moved(z, first_look._at_taps(held, model, fewer))
    light, same = (np.asarray(m.light_pass(open_, method="reference")) for m in (model, at))
    assert np.abs(same - light).mean() < 0.05 * light.mean()


def test_a_black_picture_has_no_rays():
    result = godfit.fit(np.zeros((64, 64, 3), np.uint8), shader="dawntime", samples=20)
    assert not result.converged
    assert "no rays were found" in result.message


@pytest.mark.parametrize(("scale", "smaller"), [(0.5, 2)], ids=["half, from a copy"])
def test_the_size_of_the_light_pass_is_found(scale, smaller, monkeypatch):
    """And, where it is smaller, its shadows: from a mask whose object is a pixel too small; also
    where the search ended on a copy that is so much smaller. Both sizes are tried, as where how the
    picture bends tells nothing."""
    monkeypatch.setattr(unaided, "pass_scale_of", lambda picture: None)
    model, h, w = disc_model(samples=25), *SIZE
    open_ = np.ones(SIZE, np.float32)
    open_[31:46, 75:89] = 0
    low = jnp.asarray(shrink_mask(open_, scale))
    levels = 255 * np.asarray(model(low, size=SIZE, pixels=jnp.arange(h * w))).reshape(h, w, 3)
    target = np.round(levels).clip(0, 255).astype(np.uint8)
    reading = screenshot.read(read_source(target, "none"), None, None)
    thought = np.ones(SIZE, np.float32)
    thought[32:45, 76:88] = 0
    unknown = np.zeros(SIZE, bool)
    unknown[25:52, 69:95] = True
    silent = np.zeros(SIZE, bool)
    silent[28:49, 72:92] = True
    picture = dataclasses.replace(reading.picture, mask=thought, valid=~silent)
    reading = reading._replace(picture=picture, unknown=unknown, degree=0)
    z = np.asarray(model.coordinates(), np.float32)
    copy = picture.shrunk(smaller)
    end = first_look.End(z, copy.mask, copy.mask)
    found = first_look.Look((end,), copy, 0.0, model, np.tile(z[4:6], (3, 1)), 0.9)
    monkeypatch.setattr(screenshot, "read", lambda *_: reading)
    monkeypatch.setattr(first_look, "look", lambda *_: found)
    held = {"edge": 0.01, "exposure": 0.05}
    result = godfit.fit(target, shader="dawntime", samples=25, fix=held)
    size = int(h * scale), int(w * scale)
    assert result.picture.mask.shape == size
    assert any("light pass" in note for note in result.notes) == (scale < 1)
    if scale < 1:
        before = np.abs(shrink_mask(thought, scale) - low).mean()
        assert np.abs(result.picture.mask - low).mean() < 0.8 * before


def test_blocks_hold_neighbours_and_are_as_many_as_asked():
    valid = np.ones((600, 800), bool)
    valid[:, :100] = False
    picture = Picture(np.zeros((600, 800, 1), np.float32), 0.5, valid, valid * 1.0, None, "none")
    chosen = unaided.blocks(picture, 0)
    assert unaided.LAST - 256 <= len(chosen) <= unaided.LAST + 256
    assert valid.reshape(-1)[chosen].all()
    assert np.mean(np.diff(chosen) == 1) > 0.9
    few = dataclasses.replace(picture, valid=valid & (np.arange(800) < 120))
    assert np.array_equal(unaided.blocks(few, 0), np.flatnonzero(few.valid))


def test_what_leaves_many_times_the_least_is_not_followed():
    def left(cost):
        mask = np.ones((2, 2), np.float32)
        return Read(Point(np.zeros(9, np.float32), cost, True, 1), mask, mask, None)

    trials = [left(cost) for cost in (30.0, 16.0, 2.0, 15.9)]
    costs = [trial.point.cost for trial in first_look._likely(trials, first_look.HOPELESS)]
    assert costs == [2.0, 15.9, 16.0]
    assert [trial.point.cost for trial in first_look._likely(trials, 1.5)] == [2.0]

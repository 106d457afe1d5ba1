"""Light in the plane: against closed forms, against an oracle that knows no step, and where it is
asked for nonsense."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from godfit.errors import InputError
from godfit.flatland import Canvas, Sky, canvas, render
from godfit.flatland.rays import (
    TraceSettings,
    angles,
    free_distance,
    gathered,
    radiance_and_transmittance,
)
from tests.support import flatland_oracle as oracle
from tests.support.compiling import quick_filter_jit, quick_jit

SKY = Sky(70.0, 50.0, (0.9, 0.8, 0.5), (0.1, 0.2, 0.4))
SIZE = (13, 17)
SIZES = [SIZE, (17, 13), (1, 30), (1, 1), (20, 1)]

# Op by op, the jump flood of every canvas is compiled anew.
compiled = quick_filter_jit(render)
compiled_gathered = quick_jit(gathered, static_argnames=("settings", "plain"))


def rendered(made: Canvas, sky=SKY, **options):
    return np.asarray(compiled(made, sky, **options))


def light(made: Canvas, sky, rays, method="distance", plain=False, steps=None):
    """What reaches every pixel, its own light apart."""
    h, w = made.size
    step, most = 0.0, steps or h + w + 2
    if method == "march":
        step = 0.01
        most = math.ceil(math.hypot(h, w) / step) + 2
    settings = TraceSettings(rays, most, step)
    return np.asarray(compiled_gathered(made, sky.over(rays), settings, None, plain))


@pytest.mark.parametrize("partial", [False, True], ids=["all or nothing", "partly opaque"])
@pytest.mark.parametrize("size", SIZES)
def test_distance_march_against_the_oracle(size, partial):
    made = canvas(*oracle.random_canvas(size, 4, partial=partial))
    at, beyond = np.asarray(angles(16, 1, float)), np.asarray(SKY.over(16))
    found = light(made, SKY, 16)
    for row, column in np.ndindex(size):
        if size[0] * size[1] > 100 and (row + 3 * column) % 5:
            continue
        expected = oracle.reached(
            np.asarray(made.radiance), np.asarray(made.opacity), row, column, at, beyond
        )
        np.testing.assert_allclose(found[row, column], expected, atol=1e-9)


@pytest.mark.parametrize(
    ("size", "method"), [(SIZE, "distance"), (SIZE, "march"), ((20, 1), "distance")]
)
def test_compiled_is_the_plain_walk(size, method):
    made = canvas(*oracle.random_canvas(size, 5))
    steps = {"march": {"steps": 40}, "distance": {}}[method]
    for options in ({"rays": 7}, {"rays": 5, "jitter": True, "seed": 3}):
        found, expected = (
            rendered(made, method=method, plain=plain, **steps, **options)
            for plain in (False, True)
        )
        np.testing.assert_allclose(found, expected, atol=1e-13)


@pytest.mark.parametrize(("method", "steps"), [("distance", 1), ("march", 5)])
def test_compiled_gives_up_where_the_plain_walk_does(method, steps):
    made = canvas(*oracle.random_canvas(SIZE, 6))
    step = 0.0 if method == "distance" else 0.37
    found, expected = (
        np.asarray(compiled_gathered(made, SKY.over(6), TraceSettings(6, steps, step), None, plain))
        for plain in (False, True)
    )
    np.testing.assert_allclose(found, expected, atol=1e-13)
    full = light(made, SKY, 6)
    assert np.abs(found - full).max() > 0.01


def test_single_precision_agrees(single_precision):
    radiance, opacity = oracle.random_canvas((40, 56), 7)
    made = canvas(radiance, opacity)
    assert made.opacity.dtype == jnp.float32
    # Not SKY, which is of float64.
    sky = (70.0, 50.0, (0.9, 0.8, 0.5), (0.1, 0.2, 0.4))
    found = rendered(made, Sky(*sky), rays=32)
    with jax.enable_x64(True):
        exact = rendered(canvas(radiance, opacity), Sky(*sky), rays=32)
    # A ray that meets a pixel's corner may pass it on the other side.
    assert np.mean(np.abs(found - exact).max(-1) > 1e-4) < 0.01
    assert found.dtype == np.float32


def test_march_converges_to_the_distance_march():
    """Within 1% rms where both are converged; the coarser, the worse."""
    made = canvas(*oracle.random_canvas((48, 64), 8))
    exact = rendered(made, rays=32)
    errors = []
    for steps in (100, 1000, 20000):
        off = rendered(made, rays=32, method="march", steps=steps) - exact
        errors.append(math.sqrt(np.mean(off**2) / np.mean(exact**2)))
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.01


class TestClosedForms:
    """Within half a percent at 256 rays."""

    def test_disc(self):
        """A disc of radius R fills asin(R / r) / pi of the circle at distance r. R is large against
        a pixel: what is drawn with pixels that stick out is seen as if it were 0.4 pixels
        larger."""
        h, w, radius = 290, 430, 140.0
        y, x = np.indices((h, w)) + 0.5
        r = np.hypot(x - 145, y - 145)
        opacity = (r < radius).astype(float)
        made = canvas(np.repeat(opacity[..., None], 3, -1), opacity)
        far = r > 1.1 * radius
        found = light(made, Sky.none(), 256)[..., 0][far]
        expected = np.arcsin(radius / r[far]) / np.pi
        rms = np.sqrt(np.mean((found - expected) ** 2) / np.mean(expected**2))
        assert abs(found.mean() / expected.mean() - 1) < 5e-3
        # Of single pixels, 256 rays can be one too many or too few.
        assert rms < 0.01

    def test_half_plane(self):
        """Over an endless dark ground at depth d below, half the circle is sky."""
        h, w = 60, 3001
        opacity = np.zeros((h, w))
        opacity[-10:] = 1
        made = canvas(np.zeros((h, w, 3)), opacity)
        sky = Sky(90.0, 30.0, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
        found = light(made, sky, 256)[:40, w // 2]
        depth = 50 - (np.arange(40) + 0.5)
        expected = 0.5 + np.arctan(depth / (w / 2)) / np.pi
        rms = np.sqrt(np.mean((found[:, 0] - expected) ** 2))
        assert rms < 5e-3 * expected.mean()

    def test_slit(self):
        """A slit of width a between two walls, seen from a distance b off its middle."""
        h, w, a = 121, 121, 31
        opacity = np.zeros((h, w))
        opacity[30, :] = 1
        opacity[30, 45 : 45 + a] = 0
        opacity[30:, 0] = opacity[30:, -1] = opacity[-1, :] = 1
        made = canvas(np.zeros((h, w, 3)), opacity)
        sky = Sky(0.0, 30.0, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
        found = light(made, sky, 256)[..., 0]
        rows, columns = np.arange(40, 110), np.arange(20, 100)
        y, x = np.meshgrid(rows + 0.5, columns + 0.5, indexing="ij")
        # The wall is one pixel thick: each ray is stopped by the nearer or the farther of its
        # faces.
        left, right = x - 45, 45 + a - x
        low = np.arctan2(left, np.where(left > 0, y - 30, y - 31))
        high = np.arctan2(right, np.where(right > 0, y - 30, y - 31))
        expected = np.maximum(low + high, 0) / (2 * np.pi)
        inside = found[40:110, 20:100]
        assert abs(inside.sum() / expected.sum() - 1) < 5e-3
        assert np.abs(inside - expected).max() < 1.5 / 256

    def test_sun_and_sky_over_nothing(self):
        """With nothing drawn, every pixel has the mean of the sky: sky + sun width / 360."""
        found = rendered(canvas(np.zeros((*SIZE, 3)), np.zeros(SIZE)), rays=3)
        mean = np.asarray(SKY.sky) + np.asarray(SKY.sun) * 50 / 360
        np.testing.assert_allclose(found, np.broadcast_to(mean, found.shape), rtol=1e-12)

    def test_an_empty_canvas_is_empty(self):
        found = rendered(canvas(np.zeros((*SIZE, 3)), np.zeros(SIZE)), None)
        assert (found == 0).all()


class TestSky:
    def test_means_are_those_of_the_radiance(self):
        for sky in (SKY, Sky(-500.0, 180.0), Sky(359.0, 0.5), Sky(10.0, 175.0)):
            fine = (np.arange(360_000) + 0.5) / 1000
            expected = np.asarray(sky.towards(jnp.asarray(fine))).reshape(12, -1, 3).mean(1)
            np.testing.assert_allclose(sky.over(12), expected, atol=1e-6)

    def test_smooth_and_symmetric(self):
        away = np.linspace(0, 180, 721)
        left, right = (np.asarray(SKY.towards(jnp.asarray(70 + s * away))) for s in (-1, 1))
        np.testing.assert_allclose(left, right, atol=1e-12)
        # No jump: a quarter of a degree changes little.
        assert np.abs(np.diff(right, axis=0)).max() < 0.01
        np.testing.assert_allclose(right[0] - right[-1], SKY.sun, atol=1e-12)


class TestWhatIsSeen:
    def test_opaque_pixels_show_themselves(self):
        made = canvas(*oracle.random_canvas(SIZE, 9, partial=False))
        found, opaque = rendered(made), np.asarray(made.opacity) == 1
        np.testing.assert_allclose(found[opaque], np.asarray(made.radiance)[opaque])

    def test_fully_opaque_and_fully_emitting(self):
        made = canvas(np.full((*SIZE, 3), 0.7), np.ones(SIZE))
        for method in ("distance", "march", "cascades"):
            np.testing.assert_allclose(rendered(made, method=method), 0.7, rtol=1e-12)

    def test_cascades_need_a_cpu(self, monkeypatch):
        made = canvas(*oracle.random_canvas(SIZE, 10))
        monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
        with pytest.raises(InputError, match="does not run on a CPU, got 'cascades'; set JAX_PLAT"):
            render(made, SKY, method="cascades")

    def test_exposure_and_radiance_above_one(self):
        radiance, opacity = oracle.random_canvas(SIZE, 10)
        found = rendered(canvas(20 * radiance, opacity), Sky.none(), exposure=0.1)
        np.testing.assert_allclose(found, 2 * rendered(canvas(radiance, opacity), Sky.none()))

    def test_turned_by_a_quarter(self):
        """The same on any aspect: nothing knows which side is the longer."""
        radiance, opacity = oracle.random_canvas(SIZE, 11)
        found = rendered(canvas(radiance, opacity), SKY, rays=16)
        turned = canvas(np.rot90(radiance), np.rot90(opacity))
        sky = Sky(160.0, 50.0, SKY.sun, SKY.sky)
        np.testing.assert_allclose(rendered(turned, sky, rays=16), np.rot90(found), atol=1e-9)

    def test_transmittance_is_all_that_a_sky_needs(self):
        """What fits stand on: the picture is linear in the sky."""
        made = canvas(*oracle.random_canvas(SIZE, 12))
        parts = quick_jit(radiance_and_transmittance, static_argnums=1)(made, TraceSettings(16, 32))
        parts = np.asarray(parts)
        found = parts[..., :3] + parts[..., 3:] @ np.asarray(SKY.over(16))
        np.testing.assert_allclose(found, light(made, SKY, 16), atol=1e-12)

    def test_free_distance_is_free(self):
        """A disc of that radius about anywhere in the pixel meets nothing; one that is half a pixel
        larger would."""
        made = canvas(*oracle.random_canvas((21, 30), 13, share=0.02))
        free = np.asarray(quick_jit(free_distance)(made))[1:-1, 1:-1]
        opacity = np.asarray(made.opacity)
        i, j = np.nonzero(opacity > 0)
        for row, column in np.argwhere(opacity == 0):
            gap = np.hypot(np.maximum(abs(i - row) - 1, 0), np.maximum(abs(j - column) - 1, 0))
            assert gap.min() - 0.5 < free[row, column] <= gap.min() + 1e-12


class TestNoise:
    MADE = canvas(*oracle.random_canvas(SIZE, 14))

    def test_seeds(self):
        one, same, other = (
            rendered(self.MADE, rays=4, jitter=True, film_grain=0.1, seed=jnp.asarray(s))
            for s in (1, 1, 2)
        )
        np.testing.assert_array_equal(one, same)
        assert (one != other).mean() > 0.9

    def test_jitter_is_unbiased(self):
        frame = functools.partial(rendered, self.MADE, rays=4, jitter=True)
        many = np.mean([frame(seed=jnp.asarray(s)) for s in range(200)], 0)
        exact = rendered(self.MADE, rays=256)
        assert abs((many - exact).mean()) < 2e-3
        assert np.abs(many - exact).max() < 0.15

    def test_film_grain_has_its_size(self):
        grain = rendered(self.MADE, film_grain=0.05) - rendered(self.MADE)
        assert grain.std() == pytest.approx(0.05, rel=0.1)
        assert abs(grain.mean()) < 0.01


NOTHING = canvas(np.zeros((4, 4, 3)), np.zeros((4, 4)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rays": 0}, "rays: expected a whole number from 1"),
        ({"rays": -3}, "rays: expected a whole number from 1"),
        ({"steps": 0}, "steps: expected a whole number from 1"),
        ({"method": "exact"}, "method: expected one of distance, march, cascades, got 'exact'"),
        ({"film_grain": -1.0}, "film grain: expected a finite number of 0 or more, got -1"),
        ({"method": "cascades", "steps": 3}, "steps: expected none"),
        ({"method": "cascades", "jitter": True}, "jitter: expected none"),
    ],
)
def test_nonsense_is_refused(options, message):
    with pytest.raises(InputError, match=message):
        render(NOTHING, SKY, **options)


@pytest.mark.parametrize(
    ("radiance", "opacity", "message"),
    [
        (np.zeros((4, 5, 3)), np.zeros((5, 4)), "expected radiance"),
        (np.zeros((4, 5)), np.zeros((4, 5)), "expected radiance"),
        (np.zeros((0, 5, 3)), np.zeros((0, 5)), "expected radiance"),
        (np.full((2, 2, 3), -0.1), np.ones((2, 2)), "0 or more .* got -0.1"),
        (np.full((2, 2, 3), np.nan), np.ones((2, 2)), "0 or more .* got nan"),
        (np.zeros((2, 2, 3)), np.full((2, 2), 1.5), "opacity from 0 to 1, got 1.5"),
        (np.zeros((2, 2, 3)), np.full((2, 2), np.nan), "opacity from 0 to 1, got nan"),
        (np.zeros((1, 16385, 3)), np.zeros((1, 16385)), "at most 16384 rows and columns"),
    ],
)
def test_no_canvas(radiance, opacity, message):
    with pytest.raises(InputError, match=message):
        canvas(radiance, opacity)

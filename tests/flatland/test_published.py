"""The published shaders' defects, one by one, and that the program's own way has none of them."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from godfit.flatland import Sky, canvas, render
from godfit.flatland import published as as_published
from godfit.flatland.accumulate import accumulated, effective_frames, weights
from godfit.flatland.jump_flood import jump_flood
from godfit.flatland.rays import angles

DARK = (0.0, 0.0, 0.0)
DAYLIGHT = Sky(90.0, 60.0, (1.0, 1.0, 1.0), (0.2, 0.2, 0.2))


def empty(h, w):
    return canvas(np.zeros((h, w, 3)), np.zeros((h, w)))


def lamp(h, w, row, column, half=2):
    opacity = np.zeros((h, w))
    opacity[row - half : row + half + 1, column - half : column + half + 1] = 1
    return canvas(np.repeat(opacity[..., None], 3, -1), opacity)


def gaps(directions):
    """Angles between neighbours around the circle."""
    ordered = np.sort(np.asarray(directions) % (2 * np.pi))
    return np.diff(np.append(ordered, ordered[0] + 2 * np.pi))


def test_defect_rays_are_a_radian_apart_and_uneven():
    """One published ray meets a narrow sun at each of the angles that are a radian apart, and none
    does in the widest gap between them."""
    rays = 32
    even = gaps(angles(rays, 1, float))
    np.testing.assert_allclose(even, 2 * np.pi / rays)
    random = float(as_published.noise((3, 3), float)[1, 1])
    published = (2 * np.pi / rays + np.arange(rays) + random) % (2 * np.pi)

    @jax.jit
    def under(angle):
        sky = Sky(jnp.rad2deg(angle), 0.5, (1.0, 1.0, 1.0), DARK)
        return render(empty(3, 3), sky, rays=rays, published=True)[1, 1, 0]

    # The published sun is brightest at its own angle, and dark below it.
    np.testing.assert_allclose([under(angle - 1e-5) for angle in published], 1 / rays, rtol=1e-3)
    widest = gaps(published).argmax()
    assert gaps(published)[widest] > 2 * gaps(published).min()
    assert under(np.sort(published)[widest] + gaps(published)[widest] / 2) == 0

    # A narrow sun (smooth in both) is seen by few or many rays as it goes round: the mean over an
    # empty canvas should not depend on where it stands.
    def spread(published):
        @jax.jit
        def mean(angle):
            sky = Sky(angle, 12.0, (1.0, 1.0, 1.0), DARK)
            return render(empty(3, 3), sky, rays=rays, published=published)[1, 1, 0]

        means = [mean(float(angle)) for angle in range(0, 360, 5)]
        return np.std(means) / np.mean(means)

    assert spread(False) < 1e-9
    assert spread(True) > 0.2


def test_defect_the_sun_jumps_at_its_own_angle():
    just = jnp.deg2rad(jnp.array([90 - 1e-6, 90.0, 90 + 1e-6]))
    below, at, above = np.asarray(as_published.sun_and_sky(DAYLIGHT, just))[:, 0]
    assert below == pytest.approx(0.2)
    assert at == pytest.approx(1.2)
    assert above == pytest.approx(1.2)
    # On one side only.
    sides = np.asarray(as_published.sun_and_sky(DAYLIGHT, jnp.deg2rad(jnp.array([60.0, 120.0]))))
    assert sides[0, 0] == pytest.approx(0.2)
    assert sides[1, 0] == pytest.approx(0.7)
    ours = np.asarray(DAYLIGHT.towards(jnp.array([90 - 1e-6, 90.0, 90 + 1e-6, 60.0, 120.0])))[:, 0]
    np.testing.assert_allclose(ours, [1.2, 1.2, 1.2, 0.7, 0.7], atol=1e-6)


def test_defect_an_empty_canvas_has_a_distance_to_the_corner():
    nothing = np.zeros((30, 40), bool)
    far = np.asarray(as_published.distances(jnp.asarray(nothing)))
    u, v = (np.arange(40) + 0.5) / 40, 1 - (np.arange(30) + 0.5) / 30
    np.testing.assert_allclose(far, np.hypot(u[None], v[:, None]))
    assert (np.asarray(jump_flood(jnp.asarray(nothing)).distance) == np.inf).all()


def test_defect_distances_are_not_metric_where_the_canvas_is_not_square():
    seed = np.zeros((50, 100), bool)
    seed[25, 50] = True
    far = np.asarray(as_published.distances(jnp.asarray(seed)))
    assert far[45, 50] / far[25, 70] == pytest.approx(2.0)
    ours = np.asarray(jump_flood(jnp.asarray(seed)).distance)
    assert ours[45, 50] == ours[25, 70] == 20


def test_defect_epsilon_is_under_a_pixel_and_rays_starve_beside_a_wall():
    """Above a long black floor the lower half of the circle is dark. The published rays that run
    beside the floor use up their steps and see the sky instead."""
    h, w = 60, 240
    assert w * as_published.PUBLISHED_EPSILON < 1
    opacity = np.zeros((h, w))
    opacity[42:] = 1
    made = canvas(np.zeros((h, w, 3)), opacity)
    sky = Sky(90.0, 60.0, DARK, (1.0, 1.0, 1.0))

    def near(steps):
        picture = jax.jit(lambda: render(made, sky, rays=96, published=True, steps=steps))()
        return np.asarray(picture)[41, 90:150, 0].mean()

    # Beside a seed the field says one pixel: a ray that falls by less than that in 32 steps.
    enough = near(300)
    assert near(8) > near(32) > enough
    ours = np.asarray(render(made, sky, rays=256))[41, 90:150, 0].mean()
    assert ours == pytest.approx(0.5 + math.atan(0.5 / 120) / math.pi, abs=0.01)


def test_defect_accumulation_forgets():
    """Eleven frames mixed as published are worth 5.96; the running mean keeps all eleven."""
    assert effective_frames(weights(11, "exponential")) == pytest.approx(5.96, abs=5e-3)
    assert effective_frames(weights(11)) == pytest.approx(11)
    assert effective_frames(weights(1000, "exponential")) == pytest.approx(19, abs=1e-6)
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(11, 40_000))
    for how, frames in (("exponential", 5.96), ("mean", 11.0)):
        kept = accumulated(iter(noise), how)
        np.testing.assert_allclose(kept, weights(11, how) @ noise, atol=1e-12)
        assert 1 / kept.var() == pytest.approx(frames, rel=0.05)


def test_the_noise_is_the_same_in_every_frame():
    made = lamp(20, 30, 10, 15)
    one, other = (render(made, DAYLIGHT, rays=8, published=True, seed=s) for s in (0, 1))
    np.testing.assert_array_equal(one, other)
    assert np.asarray(as_published.noise((64, 64), float)).std() == pytest.approx(
        1 / math.sqrt(12), rel=0.03
    )


def test_published_march_is_right_but_for_noise():
    """Its angles are even: many rays find what the program finds."""
    made = lamp(40, 40, 15, 20, 3)
    march = jax.jit(lambda: render(made, Sky.none(), rays=400, published=True, method="march"))
    exact = np.asarray(render(made, Sky.none(), rays=400))
    assert np.sqrt(np.mean((np.asarray(march()) - exact) ** 2) / np.mean(exact**2)) < 0.05


def test_published_distance_march_finds_a_lamp():
    made = lamp(64, 64, 30, 34, 4)
    found = np.asarray(
        jax.jit(lambda: render(made, Sky.none(), rays=256, published=True, steps=200))()
    )
    exact = np.asarray(render(made, Sky.none(), rays=256))
    assert np.sqrt(np.mean((found - exact) ** 2) / np.mean(exact**2)) < 0.05


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: weights(0), "frames: expected 1 or more, got 0"),
        (lambda: weights(3, "sum"), "accumulation: expected mean or exponential, got 'sum'"),
        (lambda: weights(3, "exponential", 1.0), "history: expected a share from 0 to below 1"),
        (lambda: accumulated([]), "frames: expected 1 or more, got none"),
    ],
)
def test_nonsense_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()

"""What clear rays tell of a disc: sums against a slow reference, discs against what was drawn."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from godfit.blind.clear_rays import seen_clearly
from godfit.blind.disc_sums import best_discs, disc_sums, is_clear, open_sums
from godfit.blind.turns import Read, Turns
from godfit.inference.observation import Picture
from godfit.inference.solver import Point
from godfit.io.filters import shrink
from godfit.io.sources import read_source
from godfit.models.coordinates import DENSITY, KAPPA, LIGHT_X, LIGHT_Y, RADIUS
from godfit.models.disc_light import DiscLight
from godfit.models.mitchell import Mitchell

SIZE = (108, 192)
LIGHT, RADIUS_THERE, VEIL, COLOUR = (0.43, 0.56), 0.11, 0.05, (0.2, 0.25, 0.3)


def drawn(size, cut, light=LIGHT, radius=RADIUS_THERE):
    """(h, w) the share of every texel's parts that lie in a disc."""
    h, w = size[0] * cut, size[1] * cut
    x, y = np.meshgrid((np.arange(w) + 0.5) / h, 1 - (np.arange(h) + 0.5) / h)
    disc = np.hypot(x - light[0] * w / h, y - light[1]) < radius
    return shrink(disc.astype(np.float64), size)


@pytest.mark.parametrize("cut", [1, 2])
def test_a_hard_disc_is_cut_as_it_is_drawn(cut):
    """By as many parts a side."""
    shading = Mitchell(0.03, 0.985, 0.8, 0.7, [LIGHT], "dawntime", 60)
    model = DiscLight(shading, [RADIUS_THERE, 1e-7, VEIL], [COLOUR]).cut_into(cut)
    mask = model.occlusion(jnp.ones(SIZE))
    np.testing.assert_allclose(mask, VEIL + (1 - VEIL) * drawn(SIZE, cut), atol=1e-6)


@pytest.mark.parametrize("shaded", [False, True])
@pytest.mark.parametrize("cut", [1, 2])
@pytest.mark.parametrize("place", [(30.3, 21.8), (-4.2, 50.1)], ids=["inside", "outside"])
def test_sums_of_discs_are_those_of_their_masks(place, cut, shaded):
    """Of every radius, with every power of the way, where rays leave the pass too, and where
    something is in their way."""
    h, w, n = 40, 60, 30
    rng = np.random.default_rng(2)
    x, y = rng.uniform(-0.5, w - 0.5, 50), rng.uniform(-0.5, h - 0.5, 50)
    t, c = 0.83 * np.arange(n + 1) / n, rng.uniform(0.5, 1, n + 1)
    radii = 7 + 0.35 * np.arange(12)
    open_ = np.ones((h, w))
    if shaded:
        open_[18:27, 26:33], open_[36:, :9] = 0.25, 0
    clear = is_clear(
        x, y, np.array(place), 0.83, n, ndimage.binary_dilation(open_ < 1, np.ones((3, 3)))
    )
    assert shaded or clear.all()
    found = disc_sums(x, y, clear, open_, np.array(place), t, c, radii, cut, 2)
    light = (place[0] + 0.5) / w, 1 - (place[1] + 0.5) / h
    at = [a[:, None] + t * (b - a[:, None]) for a, b in ((y, place[1]), (x, place[0]))]
    read = ndimage.map_coordinates(open_, at, order=1, mode="nearest")
    np.testing.assert_allclose(open_sums(x, y, open_, np.array(place), t, c), read @ c, atol=1e-9)
    for i, radius in enumerate(radii):
        mask = drawn((h, w), cut, light, radius / h)
        read = ndimage.map_coordinates(open_ * mask, at, order=1, mode="nearest")
        for power in range(3):
            expected = (read * c * (t - t[-1]) ** power).sum(1)
            np.testing.assert_allclose(found[:, i, power], expected, atol=1e-9)


def test_the_best_disc_is_that_of_least_squares():
    """Of all radii and attenuations, each fitted beside a background."""
    h, w, n = 40, 60, 30
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0, w - 1, 80), rng.uniform(0, h - 1, 80)
    t, c = 0.83 * np.arange(n + 1) / n, rng.uniform(0.5, 1, n + 1)
    radii, lights = 7 + 0.35 * np.arange(12), np.array([[30.3, 21.8], [28.1, 22.4]])
    expanded = np.stack([[1.0, -a, a**2 / 2] for a in (-0.4, 0.0, 0.5)])
    background = np.column_stack([np.ones(80), x])
    basis = np.linalg.qr(background)[0].T.copy()
    open_, clear = np.ones((h, w)), np.ones(80, bool)

    def sums_of(light, powers):
        return disc_sums(x, y, clear, open_, light, t, c, radii, 1, powers)

    levels = rng.normal(size=80) + sums_of(lights[0], 0)[:, 4, 0]
    goal = levels - basis.T @ (basis @ levels)
    found = best_discs(x, y, clear, open_, lights, t, c, radii, 1, goal, basis, expanded)
    for light, best in zip(lights, found, strict=True):
        sums = sums_of(light, 2) @ expanded.T
        fits = {}
        for r, q in np.ndindex(sums.shape[1:]):
            design = np.column_stack([background, sums[:, r, q]])
            by, left, *_ = np.linalg.lstsq(design, levels)
            fits[r, q] = left[0], by[-1]
        r, q = min(fits, key=fits.get)
        left, by = fits[r, q]
        np.testing.assert_allclose(best, [goal @ goal - left, by, r, q], rtol=1e-8)


def test_rays_that_meet_something_are_not_clear():
    blocked = np.zeros((20, 30), bool)
    blocked[8:12, 15] = True
    x, y = np.array([25.0, 25.0, 5.0]), np.array([10.0, 0.0, 10.0])
    assert is_clear(x, y, np.array([10.0, 10.0]), 0.9, 40, blocked).tolist() == [False, True, True]
    # One that ends before it is.
    assert is_clear(x, y, np.array([10.0, 10.0]), 0.5, 40, blocked).all()


@pytest.mark.parametrize(("cut", "blue"), [(1, 0.3), (2, 0.3), (1, 0.95)])
def test_the_disc_is_told_to_a_fraction_of_a_texel(cut, blue):
    """From one that is seen from as far, a third larger, its light half a texel off; also where
    whatever the disc lights is clipped in some channel."""
    colour = np.array([*COLOUR[:2], blue])
    open_ = np.ones(SIZE)
    open_[40:60, 96:120] = 0
    mask = open_ * np.maximum(drawn(SIZE, cut), VEIL)
    shading = Mitchell(0.03, 0.985, 0.8, 0.7, [LIGHT], "dawntime", 60)
    levels = 255 * (colour + np.asarray(shading(jnp.asarray(mask)))[..., None])
    target = np.round(levels).clip(0, 255).astype(np.uint8)
    picture = Picture.make(read_source(target, "none"), open_.astype(np.float32), None, None)
    silent = ndimage.binary_dilation(open_ == 0, iterations=2)
    picture = dataclasses.replace(picture, valid=picture.valid & ~silent)
    with jax.enable_x64(False):
        shading = Mitchell(0.03, 0.985, 0.8, 0.7, [LIGHT], "dawntime", 60)
        model = DiscLight(shading, [RADIUS_THERE, 1e-3, VEIL], [colour])
        free = np.ones(len(model.parameters), bool)
        held = np.full(len(free), np.nan, np.float32)
        turns = Turns(model, picture, open_ == 0, 0.0, free, held, 0)
        true = np.asarray(model.coordinates(), np.float32)
        z = true.copy()
        z[LIGHT_X] += 0.5 / SIZE[1]
        z[LIGHT_Y] -= 0.4 / SIZE[0]
        z[RADIUS] *= 1.33
        z[DENSITY] = 1 - 1.33 * (1 - z[DENSITY])
        z[KAPPA] *= 0.8
        seen = picture.observe(picture.informative(1000, 0))
        begin = Read.of(Point(z, np.inf, False, 0), open_.astype(np.float32), seen)
        found, shaded = seen_clearly(turns, begin, cut, clear=True, shaded=True)
        if blue > 0.5:
            alone = dataclasses.replace(picture, valid=picture.valid & ~picture.clipped)
            alone = dataclasses.replace(turns, picture=alone)
            assert seen_clearly(alone, begin, cut, clear=True, shaded=False) == []
    for each in (found, shaded):
        off = np.abs(each - true)
        assert off[LIGHT_X] * SIZE[1] < 0.1
        assert off[LIGHT_Y] * SIZE[0] < 0.1
        # Of what is clipped in one channel there are fewer rays.
        assert off[RADIUS] < (0.01 if blue < 0.5 else 0.02) * true[RADIUS]
        assert off[DENSITY] < 0.005
        assert off[KAPPA] < 0.1 * true[KAPPA]


def found_from_the_middle(target, open_, channels):
    """What clear rays of a target (h, w, 3) of bytes show, with ``open_`` (h, w) the mask."""
    picture = Picture.make(read_source(target, "none"), open_, None, None)
    with jax.enable_x64(False):
        shading = Mitchell(0.03, 0.985, 0.8, 0.7, [LIGHT], "dawntime", 20)
        model = DiscLight(shading, [RADIUS_THERE, 1e-3, VEIL], np.zeros((1, channels)))
        free = np.ones(len(model.parameters), bool)
        held = np.full(len(free), np.nan, np.float32)
        turns = Turns(model, picture, open_ == 0, 0.0, free, held, 0)
        z = np.asarray(model.coordinates(), np.float32)
        begin = Read.of(Point(z, np.inf, False, 0), open_, picture.observe(np.arange(200)))
        return seen_clearly(turns, begin, 1, clear=True, shaded=True)


def test_where_nothing_is_clear_nothing_is_told():
    shut = np.zeros(SIZE, np.float32)
    assert found_from_the_middle(np.zeros((*SIZE, 3), np.uint8), shut, 1) == []


@pytest.mark.parametrize("spread", [0.0, 6.0], ids=["even", "noise"])
def test_a_disc_that_does_not_stand_out_is_none(spread):
    """Rays are clear, but show nothing, or nothing of a disc."""
    rng = np.random.default_rng(4)
    target = np.array([90, 100, 110]) + spread * rng.normal(size=(*SIZE, 3))
    target = np.round(target).astype(np.uint8)
    assert found_from_the_middle(target, np.ones(SIZE, np.float32), 3) == []

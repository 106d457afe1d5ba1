"""The search for a light in a finished picture, on pictures small enough to be searched in a
second."""

import dataclasses
import math
import os
import signal

import numpy as np
import pytest

import godfit
from godfit.blind import (
    bare_fit,
    choice,
    exact,
    hypotheses,
    misfit_kernel,
    pairs,
    reduced,
    search,
)
from godfit.blind.certainty import certainty
from godfit.blind.panels import panels
from godfit.inference.observation import Picture
from godfit.io.image import encode
from godfit.io.sources import read_source
from godfit.models.build import mitchell_template
from godfit.models.coordinates import DENSITY, LIGHT_X, LIGHT_Y, RADIUS
from godfit.runtime import interrupts
from godfit.scattering.conventions import convention
from tests.support.blind_search import fewer_pairs  # noqa: F401
from tests.support.synthetic import photographs

SIZE = 90, 160
LIGHT = 0.4, 0.55
VEIL = 0.06
# Of the smaller side: the pictures are made of nearest texels, which the model interpolates.
HALF_A_TEXEL = 0.65 / SIZE[0]
DAWN = convention("dawntime")


def light_pass(mask, light, kappa, density, samples=60):
    """The sum over nearest texels, tap by tap; ``kappa`` along the ray, gain 1."""
    h, w = mask.shape
    row, column = np.mgrid[:h, :w]
    out = np.zeros(mask.shape)
    for k in range(samples):
        t = density * (k + 0.5) / samples
        x = column + 0.5 + t * (light[0] * w - column - 0.5)
        y = row + 0.5 + t * ((1 - light[1]) * h - row - 0.5)
        inside = np.clip(y, 0, h - 1).astype(int), np.clip(x, 0, w - 1).astype(int)
        out += mask[inside] * np.exp(-kappa * t / density) / samples
    return out


def scene(texture=0.0, gain=0.9, light=LIGHT, stretched=1.0):
    """Bytes of a black box and a disc on a veil, over a ground of one colour; and its mask. The
    disc may be an ellipse, ``stretched`` along x."""
    h, w = SIZE
    row, column = np.mgrid[:h, :w]
    away = np.hypot((column + 0.5 - light[0] * w) / stretched, row + 0.5 - (1 - light[1]) * h)
    box = (abs(column - 82) < 14) & (abs(row - 40) < 18)
    mask = np.where(box, 0.0, np.where(away < 8, 1.0, VEIL))
    lit = gain * (light_pass(mask, light, 2.0, 0.8) + 0.3 * mask)
    ground = np.where(box[..., None], 0.0, [0.05, 0.3, 0.4])
    noise = np.random.default_rng(0).normal(0, texture, (h, w, 1))
    return np.round(255 * np.clip(ground + lit[..., None] + noise, 0, 1)).astype(np.uint8), mask


def copy_of(image, shader=DAWN):
    return reduced.reduced(image.astype(np.float32), np.ones(image.shape[:2], bool), shader)


def test_the_kernels_sums_are_those_of_a_loop_over_texels():
    rng = np.random.default_rng(1)
    maps = rng.random((2, 12, 20)).astype(np.float32)
    x, y = rng.uniform(0, 20, (2, 5)), rng.uniform(0, 12, (2, 5))
    light_x, light_y, kappa, density, radius = point = np.array([7.3, 4.1, 2.5, 0.7, 4.0])
    out = np.empty((2, 2, 5))
    misfit_kernel.radial_sums(x, y, point, maps, np.array([0, 1]), out)
    for k, half, i in np.ndindex(out.shape):
        dx, dy = x[half, i] - light_x, y[half, i] - light_y
        last = 1.0 if k == 0 else min(1.0, radius / np.hypot(dx, dy))
        step = max(last - (1 - density), 0) / misfit_kernel.TAPS
        total = 0.0
        for j in range(misfit_kernel.TAPS):
            at = 1 - density + (j + 0.5) * step
            row, column = int(np.clip(light_y + dy * at, 0, 11)), int(light_x + dx * at)
            weight = np.exp(-kappa / density * (1 - at)) * step / density
            total += maps[k, row, np.clip(column, 0, 19)] * weight
        assert out[k, half, i] == pytest.approx(total, rel=1e-9, abs=1e-12)


def test_the_misfit_is_that_of_reweighted_least_squares():
    rng = np.random.default_rng(2)
    light, free = rng.random((1, 2, 60)), rng.normal(size=(60, 2))
    design = np.column_stack([light[0, 0] - light[0, 1], free])
    goal = design @ [0.7, 0.2, -0.1] + rng.standard_t(2, 60) * 0.05
    widths, spread = np.array([8.0, 2.0, 1.0]), 0.05
    unlimited = np.full((2, 60), 9.0)
    got, found = misfit_kernel.misfit(
        free, goal, np.zeros(60), light, unlimited, spread, 0.3, widths
    )
    weight = np.ones(60)
    for turn, width in enumerate(widths):
        root = np.sqrt(weight)
        expected = np.linalg.lstsq(design * root[:, None], goal * root, rcond=None)[0]
        left = goal - design @ expected
        if turn + 1 < len(widths):
            weight = 1 / (1 + (left / (spread * widths[turn + 1])) ** 2)
        assert width > 0
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-7)
    assert got == pytest.approx(np.log1p((left / spread) ** 2).sum(), rel=1e-5)


def test_no_gain_is_negative_and_bounds_count_on_one_side_only():
    rng = np.random.default_rng(3)
    light = rng.random((1, 2, 40))
    falls = -(light[0, 0] - light[0, 1])
    limits = np.full((2, 40), 9.0)
    none = np.zeros((40, 0))
    arguments = light, limits, 0.01, 0.3, np.array([1.0, 1.0])
    _, found = misfit_kernel.misfit(none, falls, np.zeros(40), *arguments)
    assert found[0] == 0
    # What is known to be at least so much is explained by any light that is brighter.
    cost, _ = misfit_kernel.misfit(none, -falls - 1, np.ones(40), *arguments)
    assert cost == 0


def test_a_screen_blend_adds_in_the_copys_scale():
    scene_, light = np.array([[[0.2]]]), np.array([[[0.5]]])
    both = 1 - (1 - scene_) * (1 - light)
    shader = convention("pmndrs")
    parts = [reduced.additive(encode(z, "srgb"), shader) for z in (both, scene_, light)]
    assert parts[0] == pytest.approx(parts[1] + parts[2], rel=1e-5)


def test_the_calmest_channel_keeps_white_light_and_drops_coloured_texture():
    rng = np.random.default_rng(4)
    texture = rng.normal(0, 0.2, (60, 80, 1)) * [1.0, 0.5, 0.05]
    weights = hypotheses.calmest_channel(texture + 0.4, np.ones((60, 80), bool))
    assert weights.sum() == pytest.approx(1)
    assert (texture @ weights).std() < 0.4 * texture.mean(-1).std()


@pytest.mark.parametrize("place", [-2.0, -0.3, 0.0, 0.4, 1.0, 1.2, 3.0])
def test_places_off_the_picture_have_a_number(place):
    assert search.place_of(search.number_of(place)) == pytest.approx(place)


def test_the_light_of_a_disc_behind_a_box_is_found_from_near_by_and_again():
    copy = copy_of(scene()[0])
    hypothesis = hypotheses.colour(copy, np.zeros(SIZE, bool))
    near = search.searched(hypothesis, (LIGHT[0] + 0.03, LIGHT[1] - 0.03), 0)
    assert np.abs(np.subtract(near.place, LIGHT)).max() < HALF_A_TEXEL
    assert near.cost < -0.3
    again = search.searched(hypothesis, (LIGHT[0] + 0.03, LIGHT[1] - 0.03), 0)
    np.testing.assert_array_equal(again.point, near.point)
    sure = certainty(near, LIGHT, 0)
    assert sure.apart < 0.01
    assert 0 < sure.place_error < 0.02


def test_a_veil_must_explain_more_than_a_bright_mask():
    copy = copy_of(scene()[0])
    occluded = np.zeros(SIZE, bool)
    plain, veil = hypotheses.bright(copy, occluded), hypotheses.colour(copy, occluded)
    point = np.zeros(5)
    for cost, chosen in ((-0.6, "colour"), (-0.25, "bright"), (-0.37, "bright")):
        both = [search.Candidate(plain, point, -0.3), search.Candidate(veil, point, cost)]
        assert choice.ordered(both)[0].hypothesis.name == chosen


@pytest.mark.parametrize(
    ("bright_at", "veil_at", "cost", "chosen"),
    [
        ((0.5, 0.5), (0.3, 0.5), -0.8, "bright"),
        ((0.5, 0.5), (0.3, 0.5), -1.0, "colour"),
        ((0.5, 0.5), (0.51, 0.5), -0.4, "colour"),
        ((0.5, 0.97), (0.3, 0.5), -0.4, "colour"),
    ],
    ids=["in sight", "thrice as much", "one light", "not wholly in sight"],
)
def test_a_veil_elsewhere_must_explain_thrice_as_much_as_a_light_in_sight(
    bright_at, veil_at, cost, chosen
):
    copy = copy_of(scene()[0])
    occluded = np.zeros(SIZE, bool)
    numbers = 2.0, 0.8, math.log(0.05)
    both = [
        search.Candidate(hypotheses.bright(copy, occluded), np.array([*bright_at, *numbers]), -0.3),
        search.Candidate(hypotheses.colour(copy, occluded), np.array([*veil_at, *numbers]), cost),
    ]
    assert choice.ordered(both)[0].hypothesis.name == chosen


def test_pairs_about_a_light_are_as_many_at_any_distance_and_its_double():
    hypothesis = hypotheses.bright(copy_of(scene()[0]), np.zeros(SIZE, bool))
    drawn = pairs.drawn(hypothesis, 2000, 0, LIGHT)
    h, w = SIZE
    away = np.hypot(drawn.x - LIGHT[0] * w, drawn.y - (1 - LIGHT[1]) * h)[0] / w
    # The area grows fourfold, less what lies in the box, the mask or off the picture.
    near, far = (np.count_nonzero((away > a) & (away < 2 * a)) for a in (0.1, 0.2))
    assert 0.6 < far / near < 1.2
    apart = np.hypot(np.diff(drawn.x, axis=0), np.diff(drawn.y, axis=0)) / w
    assert apart.max() < pairs.NEAR_LIGHT[1] + 1 / w
    assert drawn.spread == pairs.drawn(hypothesis, 2000, 0).spread


def test_a_bright_lights_place_is_that_of_the_pairs_about_it():
    hypothesis = hypotheses.bright(copy_of(scene()[0]), np.zeros(SIZE, bool))
    found = search.searched(hypothesis, (LIGHT[0] + 0.03, LIGHT[1] - 0.03), 0)
    assert np.abs(np.subtract(found.place, LIGHT)).max() < HALF_A_TEXEL


def test_a_disc_that_is_none_is_covered_by_what_lies_beyond_it(single_precision):
    """An ellipse shifts the density by more than its errors; rays that end before it say so."""
    image, _ = scene(stretched=1.5)
    target = read_source(image, "none", "target")
    shading = mitchell_template("dawntime", 60, 1)
    picture = Picture.make(target, np.ones(SIZE, np.float32), None, None)
    picture = dataclasses.replace(picture, foreign=bare_fit.FOREIGN)
    posed = exact.Posed(copy_of(image), picture, shading, exact.Given({}, {}, None))
    hypothesis = hypotheses.colour(posed.copy, np.zeros(SIZE, bool))
    point = np.array([*LIGHT, 2.0 / 0.8, 0.8, math.log(8 / SIZE[1])])
    found = exact.solved_exactly(search.Candidate(hypothesis, point, -0.6), posed, 0, lambda: False)
    beyond = exact.beyond_disc(found)
    assert beyond is not None
    row, column = np.divmod(np.asarray(beyond.seen.pixels), SIZE[1])
    z = found.settled.coordinates
    away = np.hypot(column + 0.5 - z[LIGHT_X] * SIZE[1], row + 0.5 - (1 - z[LIGHT_Y]) * SIZE[0])
    assert (away * (1 - z[DENSITY]) > z[RADIUS] * SIZE[0]).all()
    assert not beyond.problem.free[RADIUS]
    off = abs(z[DENSITY] - 0.8)
    alone, outside = (exact.sector_covariance(one)[DENSITY, DENSITY] for one in (found, beyond))
    apart = z[DENSITY] - beyond.settled.coordinates[DENSITY]
    assert off > 3 * np.sqrt(alone)
    assert off < 3 * np.sqrt(apart**2 + outside)


def test_pairs_have_no_end_in_the_mask_or_off_the_picture():
    copy = copy_of(scene()[0])
    hypothesis = hypotheses.bright(copy, np.zeros(SIZE, bool))
    drawn = pairs.drawn(hypothesis, 300, 0)
    at = drawn.y.astype(int), drawn.x.astype(int)
    assert drawn.difference.shape == (300,)
    assert hypothesis.usable[at].all()
    assert not hypothesis.maps[0][at].any()


def test_a_flat_rectangle_is_a_panel_and_an_object_is_none():
    levels = np.full((120, 200, 3), 90.0)
    levels[10:60, 140:190] = 20
    row, column = np.mgrid[:120, :200]
    disc = np.hypot(row - 80, column - 60) < 25
    levels[disc] = 200
    other = (levels != 90).any(-1)
    assert panels(other, levels) == [(140, 10, 50, 50)]


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_the_first_interrupt_asks_for_the_best_so_far():
    before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, interrupts._end)
    try:
        with interrupts.kept_for_later():
            assert not interrupts.requested()
            os.kill(os.getpid(), signal.SIGINT)
            assert interrupts.requested()
        assert signal.getsignal(signal.SIGINT) is interrupts._end
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("single_precision", "fewer_pairs")
def test_a_whole_fit():
    image, mask = scene()
    result = godfit.fit(image, shader="dawntime", samples=60)
    assert abs(result.params["light_x"].value - LIGHT[0]) < HALF_A_TEXEL
    assert abs(result.params["light_y"].value - LIGHT[1]) < HALF_A_TEXEL
    density = result.params["density"]
    assert density.stderr is None or abs(density.value - 0.8) < 5 * density.stderr
    estimated = np.asarray(result.mask) > (VEIL + 1) / 2
    assert (estimated & (mask == 1)).sum() > 0.7 * (estimated | (mask == 1)).sum()
    assert any("disc on a veil" in str(note) for note in result.notes)


@pytest.mark.usefixtures("single_precision", "fewer_pairs")
def test_what_has_no_rays_is_refused_with_what_to_do_next():
    result = godfit.fit(scene(gain=0.0, texture=0.05)[0], shader="dawntime", samples=60)
    assert not result.converged
    assert "no rays were found" in result.message
    assert "--background" in result.message


@pytest.mark.usefixtures("single_precision", "fewer_pairs")
def test_a_clip_of_bare_pictures_names_every_frames_light():
    lights = LIGHT, (0.42, 0.56)
    frames = [scene(light=light)[0] for light in lights]
    result = godfit.fit_clip(frames, shader="dawntime", samples=60)
    for frame, light in zip(result.frames, lights, strict=True):
        # What counts as found in a single picture.
        assert np.abs(np.subtract(frame.light, light)).max() < 0.01


def test_the_light_of_a_sky_is_found_by_the_rays_on_what_is_dark():
    made = photographs.make_photograph(1003, (135, 240))
    copy = copy_of(made.image)
    nothing = np.zeros(copy.valid.shape, bool)
    found = search.searched(hypotheses.sky(copy, nothing), None, 0)
    truth = made.truth["light_x"], made.truth["light_y"]
    assert choice.distance(found.place, truth) < 0.01
    # A bright disc alone explains less.
    assert found.cost < search.searched(hypotheses.bright(copy, nothing), None, 0).cost
    # A picture without anything dark has no such mask.
    assert hypotheses.sky(copy_of(np.full((40, 60, 3), 128, np.uint8)), nothing[:40, :60]) is None

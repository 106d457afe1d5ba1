"""Bytes of a picture before Pillow resized it, or a program that rounds once."""

import itertools

import numpy as np
import pytest
from PIL import Image

from godfit.inference.observation import Picture
from godfit.io.image import LEVELS
from godfit.io.resampling import ROUNDED_ONCE, ROUNDED_TWICE, Resize, resize_weights
from godfit.io.sources import read_source
from godfit.search.registration.resized_targets import (
    FIXED_POINT,
    before_resize,
    before_rounding,
    bytes_before,
    narrowed,
)
from tests.support import distortions, random_targets

SIZE = (96, 80)
LARGER, SMALLER = (97, 81), (95, 79)
WAYS = list(itertools.product((LARGER, SMALLER), ROUNDED_TWICE))
KNOWN = {LARGER: 0.4, SMALLER: 0.15}
"""Share of pixels that are bounded well, at least; a box leaves nearly all of them alone."""


def _picture() -> np.ndarray:
    """(h, w, 1) rays behind triangles, as bytes."""
    mask, truth = distortions.frame(2, SIZE[0])
    return random_targets.to_bytes(random_targets.render64(mask / 255, truth))[:, : SIZE[1], None]


def _resized(picture: np.ndarray, size: tuple[int, int], name: str) -> np.ndarray:
    kernel = Image.Resampling[name.upper()]
    channels = [Image.fromarray(z).resize(size[::-1], kernel) for z in np.moveaxis(picture, -1, 0)]
    return np.stack(channels, -1)


def _anything(*shape: int) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros(shape), np.full(shape, float(LEVELS))


@pytest.mark.parametrize(("size", "name"), WAYS)
def test_bounds_hold_what_was_there(size, name):
    picture = _picture()
    resized = _resized(picture, size, name)
    resize = Resize.of(SIZE, size, name)
    bounds = bytes_before(resized, np.ones(size, bool), resize)
    assert bounds.contradicted == 0
    assert (bounds.low <= picture).all()
    assert (picture <= bounds.high).all()
    assert bounds.known.mean() > (0.9 if name == "box" else KNOWN[size])


@pytest.mark.parametrize("size", [LARGER, SMALLER])
@pytest.mark.parametrize("name", ROUNDED_ONCE)
def test_bounds_of_one_rounding_hold_with_weights_of_few_bits(size, name):
    picture = _picture()
    rows, columns = (resize_weights(*n, name) for n in zip(SIZE, size, strict=True))
    made = []
    for bits in (24, 12):
        few = [np.round(z.toarray() * 2**bits) / 2**bits for z in (rows, columns)]
        made.append((few[0] @ picture[..., 0] @ few[1].T).clip(0, LEVELS))
    resized = np.round(made[1])[..., None]
    # Beyond the edge is whatever a program takes to be there.
    resized[:4] = 33
    resized[:, -4:] = 99
    resize = Resize.of(SIZE, size, name)
    for inside, ends in zip(resize.inside, (slice(4), slice(-4, None)), strict=True):
        inside[ends] = False
    bounds = bytes_before(resized, np.ones(size, bool), resize, once=True)
    assert np.abs(made[0] - made[1]).max() < FIXED_POINT
    assert bounds.contradicted == 0
    assert (bounds.low <= picture).all()
    assert (picture <= bounds.high).all()
    assert bounds.known.any()


def test_both_axes_bound_a_picture_together(monkeypatch):
    """Of few colours nothing stays open, where a pass over either axis leaves half."""
    picture = _picture()
    mask = np.select([picture > np.quantile(picture, q) for q in (0.7, 0.4)], [255, 8])
    resized = _resized(np.uint8(mask), SMALLER, "lanczos")
    resize, every = Resize.of(SIZE, SMALLER, "lanczos"), np.ones(SMALLER, bool)
    values = np.array([0.0, 8.0, 255.0])
    both = bytes_before(resized, every, resize, values)
    assert (both.low <= mask).all()
    assert (mask <= both.high).all()
    monkeypatch.setattr("godfit.search.registration.resized_targets.PASSES", 1)
    one = bytes_before(resized, every, resize, values)
    assert (one.low < one.high).mean() > 5 * (both.low < both.high).mean()


@pytest.mark.parametrize("size", [LARGER, SMALLER])
def test_noise_is_bounded_too(size):
    """The worst case of edges: no pixel is like its neighbours."""
    picture = np.random.default_rng(0).integers(0, 256, (*SIZE, 3), np.uint8)
    for name in ROUNDED_TWICE:
        resized = _resized(picture, size, name)
        bounds = bytes_before(resized, np.ones(size, bool), Resize.of(SIZE, size, name))
        assert bounds.contradicted == 0
        assert (bounds.low <= picture).all()
        assert (picture <= bounds.high).all()


def test_bounds_are_those_of_all_pictures_that_would_look_alike():
    """Of two pixels that became three, all pairs of bytes are tried."""
    weights = resize_weights(2, 3, "bicubic")
    pairs = np.stack(np.meshgrid(*[np.arange(256.0)] * 2, indexing="ij")).reshape(2, -1)
    made = np.floor(weights @ pairs + 0.5).clip(0, 255)
    rng = np.random.default_rng(0)
    for index in rng.integers(0, pairs.shape[1], 40):
        column = made[:, [index]]
        alike = pairs[:, (made == column).all(0)]
        below, above = narrowed(*before_rounding(column, column, 0.5), weights, _anything(2, 1))
        assert (below[:, 0] <= alike.min(1)).all()
        assert (above[:, 0] >= alike.max(1)).all()
        assert (above - below)[:, 0].max() <= np.ptp(alike, axis=1).max() + 1


def test_pixels_that_are_not_valid_bound_nothing():
    picture = _picture()
    resized = _resized(picture, LARGER, "bilinear")
    valid = np.ones(LARGER, bool)
    valid[20:30, 20:60] = False
    resized[~valid] = 77
    bounds = bytes_before(resized, valid, Resize.of(SIZE, LARGER, "bilinear"))
    assert bounds.contradicted == 0
    assert (bounds.low <= picture).all()
    assert (picture <= bounds.high).all()
    assert not bounds.known[22:28, 22:58].any()


def test_a_pixel_that_the_resize_dropped_may_be_anything():
    column = np.arange(40.0)[:, None]
    weights = resize_weights(40, 30, "box")
    weights.data[weights.data < 0.9] = 0
    weights.eliminate_zeros()
    unseen = weights.toarray().sum(0) == 0
    below, above = narrowed(
        *before_rounding(weights @ column, weights @ column, 0.5), weights, _anything(40, 1)
    )
    assert unseen.any()
    assert (below[unseen] == 0).all()
    assert (above[unseen] == LEVELS).all()
    np.testing.assert_array_equal(below[~unseen], column[~unseen])
    np.testing.assert_array_equal(above[~unseen], column[~unseen])


def _as_picture(target: np.ndarray) -> Picture:
    image = read_source(target, "none", "target")
    return Picture.make(image, np.zeros(SIZE, np.float32), None, None)


@pytest.mark.parametrize(("size", "name"), WAYS)
def test_the_picture_before_is_found_and_other_kernels_contradict_themselves(size, name):
    picture = _picture()
    found = before_resize(_as_picture(_resized(picture, size, name)[..., 0]), SIZE)
    before = found[name]
    assert before.size == SIZE
    lo, hi = before.intervals(np.arange(picture.size))
    assert (lo < picture.reshape(-1, 1)).all()
    assert (picture.reshape(-1, 1) < hi).all()
    off = np.abs(before.levels - picture)[before.valid]
    assert off.max() <= 2
    assert np.median(off) == 0
    # A larger picture has more pixels than there were to explain them by.
    assert size == SMALLER or name == "box" or "box" not in found


def test_only_bytes_that_nothing_else_changed_are_bounded():
    resized = _resized(_picture(), LARGER, "bilinear")[..., 0]
    assert before_resize(_as_picture(resized), SIZE)
    assert before_resize(_as_picture(np.float32(resized) / 300), SIZE) == {}
    assert before_resize(_as_picture(random_targets.encoded(resized, 80)), SIZE) == {}

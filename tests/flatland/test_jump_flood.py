"""Jump flooding against scipy's exact Euclidean transform."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import distance_transform_edt

from godfit.flatland.jump_flood import jump_flood as flood
from tests.support.compiling import quick_jit

jump_flood = quick_jit(flood, static_argnames="spacing")


def discs(h, w, n, seed):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:h, :w]
    centres = zip(rng.uniform(0, h, n), rng.uniform(0, w, n), rng.uniform(2, 20, n), strict=True)
    return np.any([np.hypot(y - cy, x - cx) < radius for cy, cx, radius in centres], axis=0)


def lines(h, w, n, seed):
    rng = np.random.default_rng(seed)
    canvas = np.zeros((h, w), bool)
    t = np.linspace(0, 1, 2 * (h + w))
    for y0, x0, y1, x1 in rng.uniform(0, 1, (n, 4)):
        rows, columns = (y0 + t * (y1 - y0)) * (h - 1), (x0 + t * (x1 - x0)) * (w - 1)
        canvas[rows.round().astype(int), columns.round().astype(int)] = True
    return canvas


def maze(h, w, cell, seed):
    """Walls one pixel thick: every cell has one towards the row above or the column before."""
    canvas = np.zeros((h, w), bool)
    above = np.random.default_rng(seed).random((h, w)) < 0.5
    for y in range(0, h, cell):
        for x in range(0, w, cell):
            if above[y, x]:
                canvas[y, x : x + cell] = True
            else:
                canvas[y : y + cell, x] = True
    return canvas


def scattered(h, w, fraction, seed):
    return np.random.default_rng(seed).random((h, w)) < fraction


def outline(canvas):
    """The pixels of the canvas that have a neighbour outside it."""
    return canvas & (distance_transform_edt(np.pad(canvas, 1))[1:-1, 1:-1] < 1.5)


CANVASES = {
    "few seeds": (scattered(256, 256, 3e-4, 0), (1.0, 1.0)),
    "many seeds, wide": (scattered(150, 331, 0.05, 2), (1.0, 1.0)),
    "discs": (discs(240, 320, 12, 3), (1.0, 1.0)),
    "discs that one round of passes gets wrong": (discs(256, 256, 3, 45), (1.0, 1.0)),
    "outlines": (outline(discs(301, 200, 15, 4)), (1.0, 1.0)),
    "lines": (lines(256, 256, 8, 5), (1.0, 1.0)),
    "maze, tall": (maze(333, 190, 17, 6), (1.0, 1.0)),
    "oblong pixels": (scattered(200, 260, 2e-3, 7), (1.0, 3.0)),
    "lines, oblong pixels": (lines(180, 256, 6, 8), (0.025, 0.01)),
    "discs, one pixel in unit square": (discs(256, 144, 9, 9), (1 / 256, 1 / 144)),
}


def to_the_nearest(nearest, seeds, spacing):
    """The distance from every pixel to the seed that it names, which must be one."""
    assert seeds[nearest.row, nearest.column].all()
    y, x = np.mgrid[: seeds.shape[0], : seeds.shape[1]]
    return np.hypot((nearest.row - y) * spacing[0], (nearest.column - x) * spacing[1])


@pytest.mark.parametrize(("seeds", "spacing"), CANVASES.values(), ids=CANVASES)
class TestEveryCanvas:
    def test_distance_is_nearly_exact(self, seeds, spacing):
        exact = distance_transform_edt(~seeds, sampling=spacing)
        excess = jump_flood(seeds, spacing=spacing).distance - exact
        assert excess.min() > -1e-12
        assert (excess > 0.5 * min(spacing)).mean() <= 1e-3

    def test_nearest_is_at_the_distance(self, seeds, spacing):
        nearest = jax.tree.map(np.asarray, jump_flood(seeds, spacing=spacing))
        expected = to_the_nearest(nearest, seeds, spacing)
        np.testing.assert_allclose(nearest.distance, expected, rtol=1e-14)

    def test_seeds_are_their_own_nearest(self, seeds, spacing):
        row, column, far = jax.tree.map(np.asarray, jump_flood(seeds, spacing=spacing))
        assert (far[seeds] == 0).all()
        assert (far[~seeds] >= min(spacing)).all()
        np.testing.assert_array_equal(np.stack([row[seeds], column[seeds]]), np.nonzero(seeds))


@pytest.mark.parametrize("spacing", [(1.0, 1.0), (0.5, 2.0)])
@pytest.mark.parametrize("shape", [(37, 64), (65, 33), (1, 50), (41, 1), (2, 3)])
def test_one_seed_is_euclid(shape, spacing):
    h, w = shape
    for row, column in ((0, 0), (h - 1, w - 1), (h // 2, w // 3)):
        seeds = np.zeros(shape, bool)
        seeds[row, column] = True
        nearest = jump_flood(seeds, spacing=spacing)
        assert (nearest.row == row).all()
        assert (nearest.column == column).all()
        expected = distance_transform_edt(~seeds, sampling=spacing)
        np.testing.assert_allclose(nearest.distance, expected, rtol=1e-15)


@pytest.mark.parametrize("shape", [(1, 1), (1, 300), (129, 1), (7, 12)])
class TestEveryShape:
    def test_no_seed(self, shape):
        """Infinity: no seed is imagined in the corner."""
        row, column, far = jump_flood(np.zeros(shape, bool))
        assert (row == -1).all()
        assert (column == -1).all()
        assert (far == np.inf).all()

    def test_nothing_but_seeds(self, shape):
        row, column, far = jump_flood(np.ones(shape, bool))
        assert (far == 0).all()
        np.testing.assert_array_equal(np.stack([row, column]), np.indices(shape))


@pytest.mark.parametrize("axis", [0, 1])
def test_one_row_or_column_is_exact(axis):
    seeds = np.expand_dims(scattered(1, 4001, 4e-3, 10)[0], axis)
    far = jump_flood(seeds).distance
    np.testing.assert_array_equal(far, distance_transform_edt(~seeds))


# A few shapes, since every new one is compiled.
@settings(deadline=None, max_examples=80)
@given(
    st.sampled_from([(1, 1), (1, 6), (9, 1), (5, 8), (8, 8), (11, 7)]).flatmap(
        lambda shape: arrays(bool, shape)
    ),
    st.sampled_from([(1.0, 1.0), (1.0, 2.5)]),
)
def test_any_small_canvas(seeds, spacing):
    nearest = jax.tree.map(np.asarray, jump_flood(seeds, spacing=spacing))
    if not seeds.any():
        assert (nearest.distance == np.inf).all()
        return
    excess = nearest.distance - distance_transform_edt(~seeds, sampling=spacing)
    assert excess.min() > -1e-12
    assert excess.max() < 1
    expected = to_the_nearest(nearest, seeds, spacing)
    np.testing.assert_allclose(nearest.distance, expected, rtol=1e-14)


def test_float32(single_precision):
    seeds, spacing = CANVASES["oblong pixels"]
    far = jump_flood(seeds, spacing=spacing).distance
    assert far.dtype == jnp.float32
    exact = distance_transform_edt(~seeds, sampling=spacing)
    assert (np.abs(far - exact) > 1e-4).mean() <= 1e-3


def test_compiled_once():
    """The next canvas compiles nothing again, nor does the result where it goes: no weak types."""
    traces = []

    @quick_jit
    def traced(seeds):
        traces.append(seeds.shape)
        return flood(seeds)

    first = traced(scattered(20, 30, 0.1, 11))
    traced(scattered(20, 30, 0.1, 12))
    assert traces == [(20, 30)]
    assert not any(z.weak_type for z in first)
    eager = flood(jnp.asarray(scattered(20, 30, 0.1, 11)))
    jax.tree.map(np.testing.assert_array_equal, first, eager)


@pytest.mark.parametrize("spacing", [(0.0, 1.0), (1.0, -1.0), (np.inf, 1.0), (1.0, np.nan)])
def test_bad_spacing(spacing):
    with pytest.raises(ValueError, match="expected two positive, finite numbers, got"):
        flood(jnp.ones((2, 2), bool), spacing)


def test_too_large():
    seeds = jax.ShapeDtypeStruct((1, 32769), bool)
    with pytest.raises(ValueError, match="at most 32768 rows and columns, got 1 x 32769"):
        jax.eval_shape(flood, seeds)
    jax.eval_shape(flood, jax.ShapeDtypeStruct((32768, 32768), bool))

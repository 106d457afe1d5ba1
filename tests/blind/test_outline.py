"""What is hidden goes on as what is seen beside it."""

import jax.numpy as jnp
import numpy as np
import pytest

from godfit.blind import outline
from godfit.blind.occluders import asked, price
from godfit.inference.observation import Picture
from godfit.models.disc_light import DiscLight
from godfit.models.mitchell import Mitchell

SIZE = (60, 90)


def length_slowly(mask, where):
    """Every pair of neighbours once, by the definition."""
    (h, w), total = mask.shape, 0.0
    for i, j in np.ndindex(h, w):
        for k, m in np.ndindex(h, w):
            near = 0 < max(abs(i - k), abs(j - m)) <= outline.AROUND
            if near and (i, j) < (k, m) and (where[i, j] or where[k, m]):
                total += abs(float(mask[i, j]) - float(mask[k, m]))
    return total / ((2 * outline.AROUND + 1) ** 2 - 1)


@pytest.mark.parametrize("seed", range(3))
def test_the_length_is_that_of_all_pairs_of_neighbours(seed):
    rng = np.random.default_rng(seed)
    mask, where = rng.uniform(size=(9, 11)), rng.uniform(size=(9, 11)) < 0.2
    assert outline.length(mask, where) == pytest.approx(length_slowly(mask, where), rel=1e-12)
    assert outline.length(mask, np.zeros_like(where)) == 0


def test_what_a_texel_costs_is_by_how_much_it_makes_the_outline_longer():
    """Given those around it, exactly: what is solved for is what is judged by."""
    rng = np.random.default_rng(0)
    mask, where = (rng.uniform(size=(12, 14)) < 0.5).astype(float), np.ones((12, 14), bool)
    side, by = (a.reshape(12, 14) for a in outline.thought(mask, where))
    for i in range(2, 10):
        for j in range(2, 12):
            as_thought, otherwise = mask.copy(), mask.copy()
            as_thought[i, j], otherwise[i, j] = side[i, j], 1 - side[i, j]
            longer = outline.length(otherwise, where) - outline.length(as_thought, where)
            assert by[i, j] == pytest.approx(longer, abs=1e-12)


def test_a_texel_that_stands_alone_is_as_dear_as_one_that_is_seen_and_a_step_of_an_edge_is_not():
    mask = np.ones((20, 20))
    mask[:, 10:] = 0
    every = np.ones(mask.shape, bool)
    straight = outline.length(mask, every)
    alone, stepped = mask.copy(), mask.copy()
    alone[10, 4], stepped[10, 9] = 0, 0
    assert outline.length(alone, every) - straight == pytest.approx(1)
    assert outline.length(stepped, every) - straight < 0.25


def hiding(scale):
    """(picture with an object half in glare, model, what is open in truth, what is unknown), the
    light pass so many times smaller."""
    h, w = SIZE[0] // scale, SIZE[1] // scale
    shading = Mitchell(0.05, 0.98, 0.8, 0.7, [0.4, 0.5], "dawntime", 40)
    model = DiscLight(shading, [0.13, 1e-4, 0.06], np.array([[0.1, 0.2, 0.3]]))
    rows, columns = (np.indices((h, w)) + 0.5) * scale
    solid = np.hypot(columns - 45, rows - 32) < 8
    open_ = np.where(solid, 0, 1).astype(np.float32)
    every = jnp.arange(SIZE[0] * SIZE[1])
    levels = 255 * np.asarray(model(jnp.asarray(open_), size=SIZE, pixels=every))
    levels = np.round(levels.reshape(*SIZE, 3)).astype(np.float32)
    rows, columns = np.indices(SIZE) + 0.5
    levels[np.hypot(columns - 36, rows - 30) < 12] = 255
    picture = Picture(levels.clip(0, 255), 0.5, np.ones(SIZE, bool), open_, None, "none")
    glare = outline.hidden(picture, np.ones(SIZE), (h, w))
    seen = np.where(glare, 1, open_).astype(np.float32)
    return Picture(picture.levels, 0.5, picture.valid, seen, None, "none"), model, open_, glare


@pytest.mark.usefixtures("single_precision")
@pytest.mark.parametrize("scale", [1, 2])
def test_what_glare_hides_of_an_object_is_found_by_its_shadow_in_one_piece(scale, monkeypatch):
    picture, model, open_, unknown = hiding(scale)
    rim = np.asarray(model.rim(open_.shape))
    inner = unknown & ~rim
    thought = np.asarray(picture.mask)
    assert (thought != open_)[inner].sum() > 40 / scale**2

    def wrong() -> float:
        mask = thought
        for _ in range(3):
            question = asked(model, picture.with_mask(mask), unknown, thought, 5000, 0)
            assert question is not None
            mask = question.answered().mask
        return float(np.abs(mask - open_)[inner].sum())

    once = wrong()
    assert once < 0.15 * np.abs(thought - open_)[inner].sum()
    # Every texel for itself, the same object is dear.
    whole = np.where(rim, thought, open_)
    nothing = np.zeros_like(unknown)
    assert price(model, thought, thought, unknown, 1.0) == 0
    hidden, alone = (price(model, whole, thought, each, 1.0) for each in (unknown, nothing))
    # Of texels as large, an outline is of that many more of what it goes around.
    assert hidden < 0.3 * scale * alone
    monkeypatch.setattr(outline, "hidden", lambda picture, unknown, size: np.zeros(size, bool))
    assert once < wrong()


def test_nothing_is_hidden_where_some_channel_can_be_read():
    picture, _, _, _ = hiding(1)
    levels = picture.levels.copy()
    levels[..., 2] = 200
    readable = Picture(levels, 0.5, picture.valid, picture.mask, None, "none")
    everywhere = np.ones(SIZE, bool)
    assert outline.hidden(picture, everywhere, SIZE).any()
    assert not outline.hidden(picture, ~everywhere, SIZE).any()
    assert not outline.hidden(readable, everywhere, SIZE).any()

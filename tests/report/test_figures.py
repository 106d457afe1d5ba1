"""Figures hold for every shape of picture: no two texts overlap and none is cut."""

import itertools

import numpy as np
import pytest
from matplotlib.image import AxesImage
from matplotlib.text import Text

from godfit.inference.information import shares
from godfit.report.figure import by_source, residual_caption
from godfit.report.sheet import KERNING, measured, wrapped
from godfit.report.style import own_style
from tests.support.shown_results import KINDS, LONG, fit_result

SHAPES = [
    (40, 400), (400, 40), (64, 64), (36, 64), (64, 36), (30, 90), (90, 30), (4, 4), (20, 600),
    (1, 9),
]  # fmt: skip
"""Pictures of (h, w) pixels, from 30:1 to 1:10, and of very few pixels."""
EXTREMES = [(400, 40), (36, 64), (4, 4), (20, 600), (1, 9)]
"""The ends of these, and one as pictures are."""


def drawn_texts(figure, monkeypatch):
    """(text, box in pixels) of everything that is written when the figure is drawn."""
    found, draw = [], Text.draw

    def recorded(text, renderer, *rest, **more):
        if text.get_visible() and text.get_text().strip():
            found.append((text.get_text(), text.get_window_extent(renderer)))
        return draw(text, renderer, *rest, **more)

    with monkeypatch.context() as patch, own_style():
        patch.setattr(Text, "draw", recorded)
        patch.setattr(AxesImage, "draw", lambda *_: None)
        figure.draw_without_rendering()
    return found


def faults(figure, monkeypatch):
    """A line for each text that is cut, and for two that overlap, by half a pixel or more."""
    texts, whole = drawn_texts(figure, monkeypatch), figure.bbox
    found = [
        f"cut: {text}"
        for text, box in texts
        if box.x0 < -0.5
        or box.y0 < -0.5
        or box.x1 > whole.width + 0.5
        or box.y1 > whole.height + 0.5
    ]
    for (one, a), (other, b) in itertools.combinations(texts, 2):
        wide, tall = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
        if min(wide, tall) > 0.5:
            found.append(f"overlap: {one} | {other}")
    assert texts
    return found


@pytest.mark.parametrize("wordy", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_no_text_is_cut_or_overlaps_another(kind, wordy, monkeypatch):
    for shape in SHAPES if kind == "fit" and not wordy else EXTREMES:
        figure = KINDS[kind](shape, wordy).plot()
        assert faults(figure, monkeypatch) == [], shape


def test_an_overlap_and_a_cut_would_be_found(monkeypatch):
    figure = fit_result((36, 64)).plot()
    figure.text(0.03, 0.97, "over the title", va="top")
    figure.text(0.99, 0.5, "cut at the right edge")
    found = faults(figure, monkeypatch)
    assert any(line.startswith("overlap") for line in found)
    assert "cut: cut at the right edge" in found


def test_tall_and_wide_pictures_stay_large():
    for shape, longest in [((40, 400), 10.0), ((400, 40), 7.0), ((64, 64), 3.0)]:
        figure = fit_result(shape).plot()
        width, height = figure.get_size_inches()
        panel = figure.axes[0].get_position()
        assert max(panel.width * width, panel.height * height) > longest, shape
        assert width <= 13.5
        assert height < 14


def test_words_are_wrapped_within_their_room():
    for room in (0.6, 2.3, 9.0):
        lines = wrapped(LONG + " and a few more words", room, "text")
        assert max(measured(line, "text") for line in lines) <= room / KERNING
        assert "".join(lines).replace(" ", "") == (LONG + "andafewmorewords").replace(" ", "")


def test_the_residual_has_a_caption():
    assert residual_caption(fit_result((8, 8))).startswith("only rounding is left")
    assert "more than noise" in residual_caption(fit_result((8, 8), wordy=True))


def test_shares_are_those_of_each_pixels_influence():
    """Against the estimator itself: the answer moves by v^T J_i for a change of pixel i."""
    rng = np.random.default_rng(1)
    jacobian = rng.normal(size=(3, 24))
    # Three cells of eight pixels.
    cells = np.stack(
        [jacobian[:, i : i + 8] @ jacobian[:, i : i + 8].T for i in range(0, 24, 8)], -1
    )[:, :, None, :]
    free = np.array([True, True, False])
    slopes = np.array([[1.0, 0.0, 0.0], [0.5, 2.0, 0.0], [0.0, 0.0, 1.0]])
    found = shares(cells, free, slopes)
    moved = slopes[:2, :2] @ np.linalg.pinv(jacobian[:2].T)
    expected = (moved**2).reshape(2, 3, 8).sum(-1)
    expected /= expected.sum(1, keepdims=True)
    np.testing.assert_allclose([found[0][0], found[1][0]], expected, rtol=1e-6)
    assert found[2] is None


def test_lights_are_one_source():
    where = {n: np.full((2, 2), float(i)) for i, n in enumerate(("decay", "light_x", "light_y"))}
    maps = by_source(where)
    assert list(maps) == ["decay", "light"]
    np.testing.assert_array_equal(maps["light"], np.full((2, 2), 1.5))

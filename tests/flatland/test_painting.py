"""Canvases painted with strokes, against the page's shader and colours."""

import colorsys
import itertools
import math

import numpy as np
import pytest

from godfit.errors import InputError
from godfit.flatland import (
    PALETTE,
    GlobalIllumination,
    Stroke,
    example_strokes,
    from_rgba,
    painted,
    render_published,
)
from godfit.flatland.painting import varied


def distance_squared(p, start, end):
    """The page's sdfLineSquared; of a point, for which it divides 0 by 0, the point's."""
    to_start = p[0] - start[0], p[1] - start[1]
    line = end[0] - start[0], end[1] - start[1]
    square = line[0] ** 2 + line[1] ** 2
    t = 0.0
    if square > 0:
        t = min(max((to_start[0] * line[0] + to_start[1] * line[1]) / square, 0.0), 1.0)
    return (to_start[0] - line[0] * t) ** 2 + (to_start[1] - line[1] * t) ** 2


def test_painted_as_by_the_shader():
    h, w = 25, 33
    first = Stroke(np.array([[4.0, 3.0], [20.5, 9.25], [28.0, 22.0]]), PALETTE[1])
    second = Stroke(np.array([[10.0, 15.5]]), PALETTE[4], 6)
    found = painted((h, w), [first, second])
    for row, column in np.ndindex(h, w):
        # The shader has y up and flips the line's ends.
        p, expected = (column + 0.5, h - row - 0.5), (0, 0, 0, 0)
        for stroke in (first, second):
            points = [(x, h - y) for x, y in stroke.points]
            for start, end in [(points[0], points[0]), *itertools.pairwise(points)]:
                if distance_squared(p, start, end) <= stroke.radius**2:
                    colour = bytes.fromhex(stroke.colour[1:])
                    expected = (*colour, 255)
        assert tuple(found[row, column]) == expected


def test_the_example():
    glowing, shadow = example_strokes()
    assert (glowing.colour, shadow.colour) == ("#f9a875", "#000000")
    assert len(glowing.points) == 34
    assert len(shadow.points) == 20
    np.testing.assert_allclose(shadow.points[[0, -1]], [[90, 200], [204, 209.5]])
    np.testing.assert_allclose(glowing.points[0], [100 + 100 * math.sin(0.25), 50])
    t = 10 * 0.3
    angle = t * 0.05 * math.pi * 2
    at = (
        100 + 100 * math.sin(angle + 0.25) * math.cos(angle * 0.15),
        50 + 100 * math.sin(0.7 * angle),
    )
    np.testing.assert_allclose(glowing.points[10], at)
    values = painted((300, 300), (glowing, shadow))
    assert {tuple(v) for v in values.reshape(-1, 4)} == {
        (0, 0, 0, 0), (249, 168, 117, 255), (0, 0, 0, 255)
    }  # fmt: skip
    # Emission of one, shadow of the other.
    shader = GlobalIllumination(noise=False, enable_sun=False, steps=99)
    light = render_published(from_rgba(values[::4, ::4]), shader)[..., 0]
    assert light[45, 36] > 0.05
    assert light[55, 36] < 0.2 * light[45, 36]


@pytest.mark.parametrize("colour", PALETTE)
def test_variations_are_the_page_s(colour):
    """Saturation less by 1 to 20 percent, lightness more by -5 to 4, both clamped."""
    r, g, b = bytes.fromhex(colour[1:])
    hue, lightness, saturation = colorsys.rgb_to_hls(r / 255, g / 255, b / 255)
    possible = []
    for ds, dl in itertools.product(range(-20, 0), range(-5, 5)):
        s, l = (min(max(v, 0), 1) for v in (saturation + ds / 100, lightness + dl / 100))  # noqa: E741
        possible.append([255 * c for c in colorsys.hls_to_rgb(hue, l, s)])
    found = varied((r, g, b), 4000, np.random.default_rng(2))
    apart = np.abs(found[:, None].astype(float) - np.array(possible)[None]).max(-1)
    # A byte is the nearest, and nearly all of the variations occur.
    assert apart.min(1).max() < 0.5 + 1e-6
    assert np.mean(apart.min(0) < 0.5 + 1e-6) > 0.99


@pytest.mark.parametrize(
    ("size", "stroke", "message"),
    [
        ((0, 5), Stroke(np.zeros((1, 2)), "#000000"), "size: expected"),
        ((5, 5), Stroke(np.zeros((1, 2)), "red"), "colour: expected #rrggbb, got 'red'"),
        ((5, 5), Stroke(np.zeros((0, 2)), "#000000"), "points: expected"),
        ((5, 5), Stroke(np.full((1, 2), np.nan), "#000000"), "expected finite points"),
        ((5, 5), Stroke(np.zeros((1, 2)), "#000000", 0.0), "a radius above 0, got radius 0"),
    ],
)
def test_nonsense_is_refused(size, stroke, message):
    with pytest.raises(InputError, match=message):
        painted(size, [stroke])

"""Votes of many pixels against the same in NumPy, all at once."""

import numpy as np
import pytest

from godfit.blind.consensus import passed_by, votes_for

RNG = np.random.default_rng(5)


@pytest.mark.parametrize("along", [True, False])
def test_votes_are_those_of_every_edge(along):
    u, v = np.linspace(-0.3, 2, 23), np.linspace(-0.3, 1.3, 17)
    x, y, turn = RNG.uniform(0, 1, 200), RNG.uniform(0, 1, 200), RNG.uniform(0, 2 * np.pi, 200)
    nx, ny = np.cos(turn), np.sin(turn)
    dx, dy = u[None, :, None] - x, v[:, None, None] - y
    cosine = np.abs(dx * nx + dy * ny) / (np.hypot(dx, dy) + 1e-6)
    off = cosine / 0.05 if along else (1 - cosine) / 0.02
    expected = np.exp(-(off**2)).sum(-1)
    np.testing.assert_allclose(votes_for(u, v, x, y, nx, ny, along), expected, rtol=1e-9)


def test_a_light_that_edges_point_to_gets_the_most():
    u, v = np.linspace(0, 1.6, 33), np.linspace(0, 1, 21)
    x, y = RNG.uniform(0, 1.6, 300), RNG.uniform(0, 1, 300)
    towards = np.stack([u[20] - x, v[6] - y]) / np.hypot(u[20] - x, v[6] - y)
    votes = votes_for(u, v, x, y, -towards[1], towards[0], True)
    assert np.unravel_index(votes.argmax(), votes.shape) == (6, 20)


def test_circles_pass_what_is_near_them():
    x, y = RNG.uniform(0, 1.6, 400), RNG.uniform(0, 1, 400)
    circles = np.column_stack([RNG.uniform(0, 1, (30, 2)), RNG.uniform(0.1, 0.6, 30)])
    away = np.hypot(x - circles[:, :1], y - circles[:, 1:2])
    expected = (np.abs(away - circles[:, 2:]) < 0.02).sum(1)
    assert expected.max() > 10
    np.testing.assert_array_equal(passed_by(circles, x, y, 0.02), expected)

"""Noise that columns and rows share: against sums over pairs of values, and in the errors."""

import jax.numpy as jnp
import numpy as np
import pytest

from godfit.inference.allowances.shared_noise import shared_slopes
from godfit.inference.information import evidence
from godfit.inference.noise import SIGMAS
from godfit.inference.observation import Observation, Picture
from godfit.inference.problem import Problem
from godfit.inference.settle import Settled
from godfit.inference.solver import Intervals, Tangent, solve_tangent
from godfit.io.sources import read_source
from godfit.models.mitchell import Mitchell

H, W = 5, 7


def observed(levels, own, shared, channels=1, size=(H, W)):
    """Bytes of ``levels`` (m,)."""
    stored = np.round(levels).astype(np.float32)
    count = size[0] * size[1]
    plain = Observation(
        jnp.zeros(size), None, jnp.arange(count), jnp.asarray(stored - 0.5),
        jnp.asarray(stored + 0.5), size, channels, "none", True,
    )  # fmt: skip
    return plain.with_noise(own, shared)


@pytest.mark.parametrize("channels", [1, 3])
def test_pulls_of_one_line_add_up(channels):
    rng = np.random.default_rng(0)
    count = H * W * channels
    shared, jacobian = rng.standard_normal((4, count)), rng.standard_normal((2, count))
    pull = np.where(rng.random(count) < 0.6, rng.random(count), 0)
    one = observed(np.zeros(count), np.ones(count), shared, channels)
    expected = np.zeros((2, 2))
    places = np.repeat(np.arange(H * W), channels)
    for i, lines in enumerate([places % W, places // W] * 2):
        for a in range(count):
            for b in range(count):
                if a != b and lines[a] == lines[b]:
                    drawn = pull[a] * pull[b] * shared[i, a] * shared[i, b]
                    expected += drawn * np.outer(jacobian[:, a], jacobian[:, b])
    np.testing.assert_allclose(shared_slopes(jacobian, pull, one), expected, rtol=1e-10, atol=1e-10)
    # A part of the pixels has the noise of that part.
    rows = np.arange(0, H * W, 2)
    some = one.only(rows)
    values = (rows[:, None] * channels + np.arange(channels)).reshape(-1)
    np.testing.assert_array_equal(some.shared_noise, shared[:, values])
    assert one.with_noise(None).shared_noise is None


def test_errors_hold_where_columns_drift(single_precision):
    """A straight model, whose values are displaced by a draw a column and then rounded."""
    size, sigma = (64, 64), 0.02
    model = Mitchell(0.5, 0.97, 0.8, 0.7, (0.4, 0.6), "dawntime", 60)
    z, free = np.asarray(model.coordinates(), np.float32), np.arange(6) < 3
    rng = np.random.default_rng(1)
    y, x = (np.arange(64) + 0.5)[:, None] / 64, (np.arange(64) + 0.5)[None] / 64
    image = (90 + 60 * np.sin(3 * x + 2 * y) + 25 * np.cos(7 * y - 4 * x)).reshape(-1)
    rows = [np.sin(4 * x + y), np.cos(3 * y - x), x * y, *np.zeros((3, 64, 64))]
    jacobian = np.reshape(rows, (6, -1))
    shared = np.stack([np.full(image.size, sigma), np.zeros(image.size)])
    tangent = Tangent(image.astype(np.float32), jacobian.astype(np.float32), np.ones(6, np.float32))
    picture = Picture.make(
        read_source(np.zeros(size, np.uint8), "none"), np.zeros(size), None, None
    )
    straight = Problem(model, picture, free, np.where(free, np.nan, z))
    scores = {"with": [], "without": []}
    for _ in range(60):
        drawn = np.tile(rng.normal(0, sigma, 64), 64)
        one = observed(image + drawn, np.full(image.size, sigma, np.float32), shared, size=size)
        intervals = Intervals(one.lo, one.hi, own_noise=np.asarray(one.own_noise))
        least = float(SIGMAS[0])
        found = solve_tangent(z, straight, tangent, intervals, least)
        off = found.coordinates - z
        moved = tangent.shifted(off)
        settled = Settled(found.coordinates, least, 0.0, True)
        at = evidence(settled, moved, one)
        for name, known in (("with", at), ("without", at.without_shared_noise())):
            errors = np.sqrt(np.diag(known.covariance(free)))
            scores[name].append(off[free] / errors[free])
    rms = {name: np.sqrt(np.mean(np.square(z))) for name, z in scores.items()}
    assert 0.8 < rms["with"] < 1.2
    assert rms["without"] > 1.4
    # Of a model that jumps, a tangent says nothing about values at ends of their intervals.
    jumping = evidence(settled, moved._replace(jumps=True), one)
    np.testing.assert_array_equal(jumping.curvature, at.blunt)
    np.testing.assert_array_equal(jumping.scores, at.blunt)
    assert (np.diag(jumping.covariance(free))[free] > np.diag(at.covariance(free))[free]).all()

"""What the ends of intervals may promise, where few values determine a direction."""

import jax.numpy as jnp
import numpy as np
import pytest

from godfit.inference.information import evidence, undetermined
from godfit.inference.noise import SIGMAS
from godfit.inference.observation import Observation
from godfit.inference.settle import Settled
from godfit.inference.solver import Tangent

SIDE = 40
HALF = 0.5
FREE = np.ones(2, bool)


def at_an_end(few: int, one_sided: bool = False):
    """The evidence of a straight model, whose second coordinate moves ``few`` values alone. These
    lie at the lower ends of their intervals."""
    count = SIDE**2
    rng = np.random.default_rng(0)
    image = rng.uniform(60, 180, count)
    stored = np.round(image)
    jacobian = np.stack([rng.standard_normal(count), np.arange(count) < few])
    lo, hi = stored - HALF, stored + HALF
    # Some are known less well, as in a picture that was restored.
    hi[-count // 10 :] += 1
    image[:few] = lo[:few]
    if one_sided:
        hi[:few] = np.inf
    observation = Observation(
        jnp.zeros((SIDE, SIDE)), None, jnp.arange(count), jnp.asarray(lo, jnp.float32),
        jnp.asarray(hi, jnp.float32), (SIDE, SIDE), 1, "none", True,
    )  # fmt: skip
    tangent = Tangent(np.float32(image), np.float32(jacobian), np.ones(2, np.float32))
    settled = Settled(np.zeros(2, np.float32), float(SIGMAS[0]), 0.0, True)
    return evidence(settled, tangent, observation)


@pytest.mark.parametrize("few", [1, 2, 400])
def test_values_at_ends_of_their_intervals_promise_no_more_than_there_are(few, single_precision):
    errors = np.sqrt(np.diag(at_an_end(few).covariance(FREE)))
    least_squares = (2 * HALF + 1) / np.sqrt(12 * few)
    assert errors[1] > 0.99 * least_squares / np.sqrt(few)
    # Of a value at the end of its interval, least squares counts a little less.
    assert errors[1] < 1.3 * least_squares
    # By the curvature there, one of them would be known to the noise.
    sharp = 1 / np.sqrt(at_an_end(few).curvature[1, 1])
    assert (errors[1] > 20 * sharp) == (few < 400)


def test_values_that_are_bounded_from_one_side_leave_a_direction_open(single_precision):
    ranges = np.ones(2)
    assert undetermined(at_an_end(1).blunt, ranges, FREE, 0) == []
    assert undetermined(at_an_end(1, one_sided=True).blunt, ranges, FREE, 0) == [(1, [])]

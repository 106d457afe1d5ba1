"""Flat areas count once: what their pixels say together, and what becomes of a fit."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from godfit.inference.likelihood import log_likelihood
from godfit.inference.observation import Picture
from godfit.inference.repeated_values import REPEATED_VALUES, relieved
from tests.support import random_targets
from tests.support import stability_judges as stability

SIGMA = 0.005


def observed(values):
    """Levels of one row that are rounded from ``values``."""
    levels = np.round(values)[None, :, None].astype(np.float32)
    every = np.ones(levels.shape[:2], bool)
    picture = Picture(levels, 0.5, every, every * np.float32(1), None, "none")
    return picture.observe(np.arange(len(values)))


@pytest.mark.parametrize("count", [REPEATED_VALUES, 100, 5000])
@pytest.mark.parametrize("end", [-0.5, 0.5])
def test_many_alike_say_at_an_interval_s_end_what_one_says(count, end):
    values = np.full(count, 7 + 0.999 * end)
    seen = relieved(observed(values), values + 0.001 * end, SIGMA)
    at_end = np.full(count, 7 + end)
    total = float(log_likelihood(jnp.asarray(at_end), seen.lo, seen.hi, jnp.asarray(SIGMA)).sum())
    assert total == pytest.approx(np.log(0.5), abs=2e-3)


def test_others_stay_as_they_are():
    rng = np.random.default_rng(0)
    apart = observed(values := np.sort(rng.uniform(5, 200, 300)))
    assert relieved(apart, values, SIGMA) is apart
    inside = observed(values := np.full(300, 7.2))
    assert relieved(inside, values, SIGMA) is inside
    noisy = observed(values := np.full(300, 7.499))
    assert relieved(noisy, values, 0.3) is noisy
    unrounded = dataclasses.replace(noisy, lo=noisy.hi)
    assert relieved(unrounded, values, SIGMA) is unrounded
    both = observed(values := np.concatenate([values, [9.1, 9.499]]))
    seen = relieved(both, values, SIGMA)
    np.testing.assert_array_equal(seen.lo[-2:], both.lo[-2:])
    assert (np.asarray(seen.hi)[:300] > np.asarray(both.hi)[:300]).all()


@pytest.mark.usefixtures("single_precision")
@pytest.mark.parametrize(("exposure", "most"), [(0.004, 5.0), (0.03, 1.5)])
def test_a_veil_near_a_half_does_not_move_the_answer(exposure, most):
    """A third of the picture has one value, .0105 levels under a half: it alone moved parameters by
    8 (2.1) quoted errors."""
    mask = stability.mask_of(96)
    target = random_targets.to_bytes(stability.light_pass(mask, exposure=exposure))
    result = stability.fit(target, mask, pass_scale=1.0)
    assert result.converged
    truth = stability.TRUTH | {"exposure": exposure}
    off = [abs(e.value - truth[n]) / e.stderr for n, e in result.params.items()]
    assert max(off) < most

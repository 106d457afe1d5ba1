"""Least squares inside bounds: which coordinates move, and how often."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from godfit.inference.solver import _inside

P = 6


def problem(seed):
    """A quadratic cost with a lower bound of 0, its runs counted: (problem, run, slope, matrix,
    goal, runs)."""
    rng = np.random.default_rng(seed)
    matrix, goal, runs = rng.normal(size=(20, P)), rng.normal(size=20), []
    bounded = SimpleNamespace(
        free=np.ones(P, bool), bounds=(np.zeros(P, np.float32), np.full(P, np.inf, np.float32))
    )

    def run(z, moving):
        runs.append(moving.copy())
        rest = goal - matrix[:, ~moving] @ z[~moving]
        found = z.astype(float)
        found[moving] = np.linalg.lstsq(matrix[:, moving], rest, rcond=None)[0]
        return found, 0.5 * np.sum((matrix @ found - goal) ** 2), True, 1

    def slope(z):
        return matrix.T @ (matrix @ z - goal)

    return bounded, run, slope, matrix, goal, runs


@pytest.mark.parametrize("seed", range(20))
def test_the_least_inside_bounds_is_found_from_where_it_lies(seed):
    """A coordinate on its bound that would leave at once does not move: one run is all."""
    bounded, run, slope, matrix, goal, runs = problem(seed)
    best = lsq_linear(matrix, goal, (0, np.inf), tol=1e-14).x
    best[best < 1e-6] = 0
    assert (best == 0).any()
    found = _inside(best, bounded, run, slope)
    np.testing.assert_allclose(found.coordinates, best, atol=1e-5)
    assert len(runs) == 1
    assert np.array_equal(runs[0], best > 0)


@pytest.mark.parametrize("seed", range(20))
def test_what_lies_on_its_bound_comes_in_where_it_should(seed):
    """From a corner, where all but one are on their bounds."""
    bounded, run, slope, matrix, goal, _ = problem(seed)
    best = lsq_linear(matrix, goal, (0, np.inf), tol=1e-14)
    start = np.zeros(P)
    start[np.argmax(best.x)] = 1.0
    found = _inside(start, bounded, run, slope)
    assert (found.coordinates >= 0).all()
    cost = 0.5 * np.sum((goal - matrix @ start) ** 2)
    # Not always the least, as none that was let go is tried again, but nearly all of the way there.
    assert found.cost - best.cost < 0.05 * (cost - best.cost) + 1e-9


def test_what_is_held_is_not_moved():
    bounded, run, slope, *_, runs = problem(0)
    bounded.free = np.arange(P) > 0
    found = _inside(np.zeros(P), bounded, run, slope)
    assert found.coordinates[0] == 0
    assert not any(moving[0] for moving in runs)

"""Programs compiled ahead of their use, by steps on a tangent that is made up.

The first command waits seconds for the functions that numba compiles. No step of the search can be
taken without them. The programs that work on a tangent need none, and their shapes are known.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterable, Iterator

import numpy as np

from godfit.inference.information import evidence
from godfit.inference.noise import SIGMAS, best_sigma
from godfit.inference.observation import Observation
from godfit.inference.problem import SEARCH_PIXELS, Problem, pixels_used
from godfit.inference.settle import Settled, aim
from godfit.inference.solver import Tangent
from godfit.runtime.compile_time import beside_others
from godfit.runtime.guest import own_settings
from godfit.runtime.program_cache import must_compile


def rehearse(start: np.ndarray, problem: Problem, max_values: int) -> None:
    """Compile, on a thread of its own, what settles a ``problem`` on the pixels of a search and on
    all of them, ``max_values`` at most, unless an earlier command has stored it."""
    if must_compile():
        arguments = start, problem, _observations(problem, max_values)
        threading.Thread(target=_rehearse, args=arguments, daemon=True).start()


def _observations(problem: Problem, max_values: int) -> Iterator[Observation]:
    yield problem.observe(SEARCH_PIXELS)
    picture = problem.picture
    yield picture.observe(pixels_used(picture, problem.seed, max_values))


def _rehearse(start: np.ndarray, problem: Problem, observations: Iterable[Observation]) -> None:
    # What fails here fails where it is needed, and is reported there.
    with contextlib.suppress(Exception), beside_others(), own_settings():
        for observation in observations:
            tangent = _made_up(start, problem, observation)
            _, likelihood = best_sigma(tangent.prediction, observation)
            # Rounding alone is the noise of most targets.
            settled = Settled(start, float(SIGMAS[0]), likelihood, False)
            aim(settled, tangent, problem, observation)
            evidence(settled, tangent, observation)


def _made_up(start: np.ndarray, problem: Problem, observation: Observation) -> Tangent:
    """A tangent whose levels are those that were observed, and whose derivatives are noise."""
    lo, hi = np.asarray(observation.lo), np.asarray(observation.hi)
    middle = np.where(np.isfinite(lo) & np.isfinite(hi), (lo + hi) / 2, 0).astype(np.float32)
    jacobian = np.random.default_rng(0).standard_normal((len(start), len(lo)), np.float32)
    return Tangent(middle, jacobian, problem.model.scales(start))

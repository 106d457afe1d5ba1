"""Programs that are compiled ahead: those that settle a problem."""

import numpy as np
import pytest

from godfit import Mitchell
from godfit.inference.information import evidence
from godfit.inference.observation import Picture
from godfit.inference.problem import Problem
from godfit.inference.settle import settle
from godfit.runtime import program_cache
from godfit.runtime.cache import CACHE_VARIABLE
from godfit.search import rehearsal


@pytest.fixture
def first_command(monkeypatch, tmp_path):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    program_cache.disable_program_cache()
    program_cache.enable_program_cache()
    program_cache.expect_programs("a fit of this size")
    yield
    program_cache.disable_program_cache()


def small_problem() -> tuple[Problem, np.ndarray]:
    """A small picture, rounded to bytes, and the coordinates that it was made with."""
    model = Mitchell(0.5, 0.98, 0.8, 0.7, [0.5, 0.5], samples=20)
    mask = np.random.default_rng(1).random((24, 24)).astype(np.float32)
    levels = np.floor(255 * np.asarray(model(mask)) + 0.5)[..., None]
    whole = np.ones((24, 24), bool)
    picture = Picture(levels.astype(np.float32), 0.5, whole, mask, None, "none")
    free, held = np.ones(6, bool), np.full(6, np.nan, np.float32)
    return Problem(model, picture, free, held), np.array(model.coordinates(), np.float32)


@pytest.mark.usefixtures("single_precision")
def test_settling_compiles_nothing_that_a_rehearsal_has_not(first_command):
    assert program_cache.must_compile()
    problem, start = small_problem()
    observation = problem.picture.observe(np.arange(24 * 24))
    rehearsal._rehearse(start, problem, (observation,))
    rehearsed = {*program_cache._programs}

    settled, tangent = settle(start * np.float32(1.001), problem, observation)
    evidence(settled, tangent, observation)

    assert {key[0].__name__ for key in {*program_cache._programs} - rehearsed} == {"linearise"}

"""Densities above 1, whose last taps lie beyond the light.

Most shaders end their rays at the light or before it. So a search begins with densities up to 1, as
if there were no others, and goes on above 1 where what it found lies close to that end. Taps beyond
the light mirror the mask, and few pictures of shorter rays resemble that. If the residual of a fit
is not like noise, lights and attenuations are screened at densities above 1 as well.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from godfit.inference.fitted import Found
from godfit.inference.problem import SEARCH_PIXELS, Problem
from godfit.inference.settle import settle
from godfit.inference.strategy import Report, starts
from godfit.scattering.parameters import LIGHT_DENSITY
from godfit.search import density_minima, multigrid
from godfit.search.multistart import REMEDIED

CLOSE_TO_LIGHT = 0.05
"""Distance of a density from 1 at which the right one may lie beyond: a few bands."""
BARELY = 2.0
"""Standard errors of a density above 1 within which it is taken to be 1, where sliders end and the
taps reach the light: a value that shaders ship, unlike its neighbours."""
FARTHER_DENSITIES = (1.1, 1.3, 1.6, 1.9)
"""Densities above 1 that are screened."""
STARTS_OF_A_DENSITY = 2
"""Starts that go on from each of these: the best light may be another one at each."""


def up_to_light(problem: Problem, given: Mapping[str, float]) -> Problem:
    """The problem with densities up to 1; the whole range where a density is given beyond."""
    if given.get("density", 0.0) > LIGHT_DENSITY:
        return problem
    return problem.up_to("density", LIGHT_DENSITY)


def may_lie_beyond(candidates: list[np.ndarray], problem: Problem) -> bool:
    """Whether one of the ``candidates`` (p,) is close to the end of a range up to 1."""
    if "density" not in problem.most or not problem.is_free("density"):
        return False
    along = problem.index("density")
    return any(z[along] > LIGHT_DENSITY - CLOSE_TO_LIGHT for z in candidates)


def barely_beyond(found: Found) -> bool:
    """Whether the density is above 1 by no more than BARELY of its errors."""
    if not found.problem.is_free("density"):
        return False
    along = found.problem.index("density")
    variance = found.evidence.covariance(found.problem.free)[along, along]
    beyond = found.settled.coordinates[along] - LIGHT_DENSITY
    return bool(0 < beyond <= BARELY * np.sqrt(variance))


def searched(
    problem: Problem, found: np.ndarray, given: Mapping[str, float], report: Report
) -> list[np.ndarray]:
    """Candidates in the whole range of densities, where those up to 1 lead to ``found`` (p,)."""
    settled, _ = settle(found, problem, problem.observe(SEARCH_PIXELS))
    if settled.sigma < density_minima.ROUNDING_ONLY:
        # All is explained, by a density up to 1 or just above: nothing is left to search for.
        return [settled.coordinates]
    report("densities above 1")
    climbed = multigrid.climb(problem.small, [found, *_screened(problem, given)], report)
    return density_minima.on_subset(problem, climbed.coordinates, report)


def searched_anew(
    problem: Problem, found: np.ndarray, given: Mapping[str, float], report: Report
) -> list[np.ndarray]:
    """Candidates above 1, wherever ``found`` (p,) is; none where their residual has more than a
    share of REMEDIED of its noise."""
    if not problem.is_free("density"):
        return []
    report("densities above 1")
    climbed = multigrid.climb(problem.small, _screened(problem, given), report).coordinates
    observation = problem.observe(SEARCH_PIXELS)
    before, after = (settle(z, problem, observation)[0].sigma for z in (found, climbed))
    return density_minima.on_subset(problem, climbed, report) if after < REMEDIED * before else []


def _screened(problem: Problem, given: Mapping[str, float]) -> list[np.ndarray]:
    """The best starts (p,) at each of a few densities above 1: what suits densities up to 1 best
    may have another attenuation or light."""
    model, small, seed = problem.model, problem.picture.small, problem.seed
    return [
        start
        for density in FARTHER_DENSITIES
        for start in starts(
            model, small, {**given, "density": density}, keep=STARTS_OF_A_DENSITY, seed=seed
        )
    ]

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
"""Densities above 1 that a search starts from."""


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


def searched(problem: Problem, found: np.ndarray, report: Report) -> list[np.ndarray]:
    """Candidates in the whole range of densities, from ``found`` (p,), which is in that up to 1."""
    along = problem.index("density")
    begun = [found]
    for density in FARTHER_DENSITIES:
        start = found.copy()
        start[along] = density
        begun.append(start)
    report("densities above 1")
    climbed = multigrid.climb(problem.small, begun, report)
    return density_minima.on_subset(problem, climbed.coordinates, report)


def screened(
    problem: Problem, found: np.ndarray, given: Mapping[str, float], report: Report
) -> list[np.ndarray]:
    """Candidates in the whole range of densities from a screening above 1; none where they leave
    more than a share of REMEDIED of the noise that ``found`` (p,) leaves."""
    if not problem.is_free("density"):
        return []
    report("densities above 1")
    small = problem.picture.small
    begun = [
        start
        for density in FARTHER_DENSITIES
        for start in starts(
            problem.model, small, {**given, "density": density}, keep=2, seed=problem.seed
        )
    ]
    climbed = multigrid.climb(problem.small, begun, report)
    observation = problem.observe(SEARCH_PIXELS)
    own, other = (settle(z, problem, observation)[0].sigma for z in (found, climbed.coordinates))
    if other > REMEDIED * own:
        return []
    return density_minima.on_subset(problem, climbed.coordinates, report)

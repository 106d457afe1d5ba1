"""The search where the mask is known: screen, climb, compare minima, settle on all pixels."""

from __future__ import annotations

import numpy as np

from godfit.inference import indirect_inference
from godfit.inference.fitted import Found
from godfit.inference.information import evidence, undetermined
from godfit.inference.problem import Problem, pixels_used
from godfit.inference.settle import settle
from godfit.inference.strategy import (
    Effort,
    Open,
    left_open,
    search,
    stages,
    starting_points,
)
from godfit.models.base import AbstractModel
from godfit.models.mitchell import Mitchell
from godfit.search import beyond_light, density_minima, multigrid, multistart

RETRIED = 3
"""Starts from which a doubtful fit is tried once more, each alone."""


@search.register
def _(model: AbstractModel, problem: Problem, given: dict[str, float], effort: Effort) -> Found:
    return search_mask(problem, given, effort)


@left_open.register
def _(model: Mitchell, problem: Problem) -> Open | None:
    """Where no pixel shows its own value, exposure and weight act only through their product."""
    if model.convention.own_pixel or not (
        problem.is_free("exposure") and problem.is_free("weight")
    ):
        return None
    return Open("exposure", ("weight",))


def search_mask(problem: Problem, given: dict[str, float], effort: Effort) -> Found:
    """The fit of ``problem``: on a small copy from a grid of starts, on a few thousand sharp
    pixels, and on all of them; then doubts about the answer, and what the picture leaves open."""
    model, picture = problem.model, problem.picture
    any_free = problem.free.any()
    effort.report("screening")
    whole_range, problem = problem, beyond_light.up_to_light(problem, given)
    begun = starting_points(problem, given)
    candidates = [begun[0]]
    if any_free:
        climbed = multigrid.climb(problem.small, begun, effort.report, stages=stages(model))
        candidates = [climbed.coordinates]
    if any_free and model.banded:
        candidates = density_minima.on_subset(problem, candidates[0], effort.report)
        if beyond_light.may_lie_beyond(candidates, problem):
            problem = whole_range
            candidates = beyond_light.searched(problem, candidates[0], given, effort.report)
    whole = picture.observe(pixels_used(picture, problem.seed, effort.max_values))
    effort.report(f"all {len(whole.pixels):,} pixels")

    def likeliest(problem: Problem, candidates: list[np.ndarray]) -> Found:
        settled, at, counted = density_minima.likeliest(problem, candidates, whole)
        at = at.thinned(picture.repeats)
        return Found(problem, counted, settled, at, inquire=effort.inquire)

    found = likeliest(problem, candidates)
    if beyond_light.barely_beyond(found):
        found = likeliest(beyond_light.up_to_light(problem, {}), [found.settled.coordinates])
    doubted = effort.inquire and any_free and model.banded
    if doubted and multistart.doubtful(found):
        farther = beyond_light.searched_anew(
            whole_range, found.settled.coordinates, given, effort.report
        )
        # Numbers of a fit that is wrong either way stay as they are.
        other = likeliest(whole_range, farther) if farther else found
        found = found if multistart.doubtful(other) else other
    if doubted and multistart.doubtful(found):
        found = multistart.again(found, begun[:RETRIED], effort.report)
        effort.report("mask or transfer interpreted otherwise")

        def starts(picture):
            return starting_points(problem.replaced(picture=picture), given)

        found = found.replaced(remedy=multistart.remedy(found, starts))
    found = hold_open(found, given)
    return indirect_inference.corrected(found) if effort.inquire else found


def hold_open(found: Found, given: dict[str, float]) -> Found:
    """Settle again with what the picture leaves open held, if there is such."""
    problem, coordinates = found.problem, found.settled.coordinates.copy()
    model, free = problem.model, problem.free.copy()
    opened = undetermined(
        found.evidence.blunt, model.ranges(coordinates), free, problem.index(model.held_last)
    )
    if not opened:
        return found
    free[[index for index, _ in opened]] = False
    held_fast = problem.replaced(free=free)
    name, partner = model.product
    if name == "exposure" and not held_fast.is_free(name) and held_fast.is_free(partner):
        # Exposure has drifted on noise, and its partner with it: back to what a user would expect.
        at = problem.index(name)
        coordinates[at] = given.get(name, model.defaults.get(name, coordinates[at]))
    settled, tangent = settle(coordinates, held_fast, found.observation)
    at = evidence(settled, tangent, found.observation).thinned(problem.picture.repeats)
    return found.replaced(
        problem=held_fast, settled=settled, evidence=at, opened=(*found.opened, *opened)
    )

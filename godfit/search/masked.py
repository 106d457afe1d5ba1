"""The search where the mask is known: screen, climb, compare minima, settle on all pixels."""

from __future__ import annotations

import dataclasses
import math

from godfit.inference import indirect_inference
from godfit.inference.fitted import Found
from godfit.inference.information import evidence, undetermined
from godfit.inference.noise import WITHIN_ROUNDING
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
from godfit.io.image import LEVELS
from godfit.models.base import AbstractModel
from godfit.models.mitchell import Mitchell
from godfit.search import density_minima, multigrid, multistart

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
    found = _on_all_pixels(problem, given, effort)
    if found.problem.free.any() and found.settled.sigma > WITHIN_ROUNDING:
        found = _with_plateaus(found, given, effort)
    problem = found.problem
    if (
        effort.inquire
        and problem.free.any()
        and problem.model.banded
        and multistart.doubtful(found)
    ):
        begun = starting_points(problem, given)
        found = multistart.again(found, begun[:RETRIED], effort.report)
        effort.report("mask or transfer interpreted otherwise")

        def starts(picture):
            return starting_points(problem.replaced(picture=picture), given)

        found = found.replaced(remedy=multistart.remedy(found, starts))
    found = hold_open(found, given)
    return indirect_inference.corrected(found) if effort.inquire else found


def _on_all_pixels(problem: Problem, given: dict[str, float], effort: Effort) -> Found:
    """The likeliest point on all pixels."""
    model, picture = problem.model, problem.picture
    any_free = problem.free.any()
    effort.report("screening")
    begun = starting_points(problem, given)
    candidates = [begun[0]]
    if any_free:
        climbed = multigrid.climb(problem.small, begun, effort.report, stages=stages(model))
        candidates = [climbed.coordinates]
    if any_free and model.banded:
        candidates = density_minima.on_subset(problem, candidates[0], effort.report)
    whole = picture.observe(pixels_used(picture, problem.seed, effort.max_values))
    effort.report(f"all {len(whole.pixels):,} pixels")
    settled, at, counted = density_minima.likeliest(problem, candidates, whole)
    at = at.thinned(picture.repeats)
    return Found(problem, counted, settled, at, inquire=effort.inquire)


def _with_plateaus(found: Found, given: dict[str, float], effort: Effort) -> Found:
    """The fit with the values that many pixels share at an end of the target's scale taken as
    clipped, where that is likelier than a flat area. Both are probabilities of the same values;
    the level of the clipping is one more number, of 256."""
    for top in (True, False):
        plateau = found.problem.picture.plateau(top)
        if plateau is None:
            continue
        effort.report(f"values of {plateau[0]:g} taken as clipped")
        end = {"ceiling" if top else "floor": plateau[0]}
        picture = dataclasses.replace(found.problem.picture, **end)
        other = _on_all_pixels(found.problem.replaced(picture=picture), given, effort)
        if other.settled.log_likelihood > found.settled.log_likelihood + math.log(LEVELS + 1):
            found = other
    return found


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

"""The search where the mask is known: screen, climb, compare minima, settle on all pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from godfit.inference import indirect_inference
from godfit.inference.fitted import Found
from godfit.inference.information import evidence, undetermined
from godfit.inference.noise import WITHIN_ROUNDING
from godfit.inference.problem import SEARCH_PIXELS, Problem, pixels_used
from godfit.inference.settle import Settled, settle
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
from godfit.search import density_minima, multigrid, multistart

RETRIED = 3
"""Starts from which a doubtful fit is tried once more, each alone."""
DECISIVE_LOG_ODDS = 3.0
"""Log-odds from which one size of the light pass is better than another: odds of twenty."""
OWN_SIZE = (
    "light pass: the mask's own size explains the picture better than a smaller one of {w}x{h} "
    "pixels (noise of {own:.2g} levels against {other:.2g})"
)
"""Note with the width, height and noise of the light pass that was rejected."""
SMALLER_SIZE = (
    "light pass: {scale:.2g} of the mask's size, {w}x{h} pixels, explains the picture better than "
    "the whole (noise of {other:.2g} levels against {own:.2g}); --pass-scale 1 overrides this"
)
"""Note with the scale, width, height and noise of the light pass that is kept."""


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


class Located(NamedTuple):
    """The likeliest point of a problem on all pixels, and the starts of its search, best first."""

    found: Found
    begun: list[np.ndarray]


def search_mask(problem: Problem, given: dict[str, float], effort: Effort) -> Found:
    """The fit of ``problem``: on a small copy from a grid of starts, on a few thousand sharp
    pixels, and on all of them; then doubts about the answer, and what the picture leaves open."""
    found, begun = _of_better_size(_located(problem, given, effort), given, effort)
    if effort.inquire and problem.free.any() and problem.model.banded:
        found = _doubted(found, begun, given, effort)
    found = hold_open(found, given)
    return indirect_inference.corrected(found) if effort.inquire else found


def _located(problem: Problem, given: dict[str, float], effort: Effort) -> Located:
    """The likeliest point, from a grid of starts."""
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
    return Located(Found(problem, counted, settled, at, inquire=effort.inquire), begun)


def _doubted(
    found: Found, begun: list[np.ndarray], given: dict[str, float], effort: Effort
) -> Found:
    """The fit, and, where its residual is neither rounding nor noise, other starts and other
    interpretations of the images."""
    if not multistart.doubtful(found):
        return found
    found = multistart.again(found, begun[:RETRIED], effort.report)
    effort.report("mask or transfer interpreted otherwise")
    problem = found.problem

    def starts(picture):
        return starting_points(problem.replaced(picture=picture), given)

    return found.replaced(remedy=multistart.remedy(found, starts))


def _of_better_size(own: Located, given: dict[str, float], effort: Effort) -> Located:
    """The point ``own`` of the mask's size, or that of the rival with a smaller light pass where
    this is decidedly better; with a note where one of them is.

    Both are compared on the same few pixels, first from the point at hand, so that a picture of the
    mask's size that is merely noisy costs no second search.
    """
    found, problem = own.found, own.found.problem
    if effort.rival is None or not problem.free.any() or found.settled.sigma <= WITHIN_ROUNDING:
        return own
    effort.report("a smaller light pass")
    rival, start, chosen, note = effort.rival(), found.settled.coordinates, own, ""
    here, there = _on_few_pixels(problem, start), _on_few_pixels(rival, start)
    if there.log_likelihood > here.log_likelihood + DECISIVE_LOG_ODDS:
        other = _located(rival, given, effort)
        there = _on_few_pixels(rival, other.found.settled.coordinates)
        # A smaller pass is smoother, so that it also hides a part of what other defects cause.
        explained = not multistart.doubtful(other.found)
        explained |= there.sigma < multistart.REMEDIED * here.sigma
        if explained and there.log_likelihood > here.log_likelihood + DECISIVE_LOG_ODDS:
            chosen, note = other, SMALLER_SIZE
    elif here.log_likelihood > there.log_likelihood + DECISIVE_LOG_ODDS:
        note = OWN_SIZE
    h, w = rival.picture.mask.shape[:2]
    scale = h / problem.picture.mask.shape[0]
    words = note.format(scale=scale, w=w, h=h, own=here.sigma, other=there.sigma)
    return chosen._replace(found=chosen.found.replaced(notes=(words,) if note else ()))


def _on_few_pixels(problem: Problem, start: np.ndarray) -> Settled:
    """Where a problem settles from ``start`` on the pixels of a search."""
    return settle(start, problem, problem.observe(SEARCH_PIXELS))[0]


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

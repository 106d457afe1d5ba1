"""The search where the mask is known: screen, climb, compare minima, settle on all pixels."""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from godfit.errors import Remark
from godfit.inference import indirect_inference
from godfit.inference.allowances.mask_rounding import with_mask_shifts
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
from godfit.io.image import LEVELS
from godfit.models.base import AbstractModel
from godfit.models.mitchell import Mitchell
from godfit.models.tinted import Tinted
from godfit.scattering.radial.exact import at_run_time
from godfit.search import (
    beyond_light,
    conventions,
    density_minima,
    multigrid,
    multistart,
    rival_densities,
    scatter,
)
from godfit.search.rehearsal import rehearse

RETRIED = 3
"""Starts from which a doubtful fit is tried once more, each alone."""
DECISIVE_LOG_ODDS = 3.0
"""Log-odds from which one size of the light pass is better than another: odds of twenty."""
PLAIN_SUM, PLAIN_SAMPLES = "mitchell", 100
"""The sum that stands for all along whole rays, and its number of taps."""
PLAIN_NOISE = 3.0
"""Noise in levels up to which that sum explains a picture whose order of decay, own pixel and
number of taps are others: with another number of taps it has bands elsewhere."""
ANOTHER_SUM = (
    "the picture is a sum along whole rays ({:.2g} levels of noise) and not what {} computes "
    "({:.2g} levels); give its own --shader, see `godfit shaders`"
)
"""Objection with the noise of the plain sum, the shader and its noise."""
OWN_SIZE = (
    "light pass: the mask's own size explains the picture better than one of {w}x{h} pixels (noise "
    "of {own:.2g} levels against {other:.2g})"
)
"""Note with the width, height and noise of the light pass that was rejected."""
OTHER_SIZE = (
    "light pass: {scale:.2g} of the mask's size, {w}x{h} pixels, explains the picture better than "
    "the mask's own (noise of {other:.2g} levels against {own:.2g}); --pass-scale 1 overrides this"
)
"""Note with the scale, width, height and noise of the light pass that is kept."""
UNKNOWN_EDGES = (
    "edges that a resize of the mask lost leave in doubt which of several densities is right; give "
    "the mask as the shader read it"
)
"""Objection to a fit whose density is another one where the mask's edges are."""


@search.register
def _(model: AbstractModel, problem: Problem, given: dict[str, float], effort: Effort) -> Found:
    return search_mask(problem, given, effort)


@left_open.register
def _(model: Tinted, problem: Problem) -> Open | None:
    return left_open(model.shading, problem)


@left_open.register
def _(model: Mitchell, problem: Problem) -> Open | None:
    """Where no pixel shows its own value, exposure and weight act only through their product."""
    both_free = problem.is_free("exposure") and problem.is_free("weight")
    if not (model.convention.product_open and both_free) or {"exposure", "weight"} & set(
        problem.prior
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
    other = _explained_by_another(problem, effort)
    if other is not None:
        return other
    located = _with_plateaus(_located(problem, given, effort), given, effort)
    located = _of_better_size(located, given, effort)
    found = located.found
    if effort.inquire and problem.free.any() and problem.model.banded:
        found = conventions.questioned(found, effort)
        if found.objection:
            found = found.replaced(inquire=False)
        else:
            found = _doubted(located, given, effort)
    unexplained = found.inquire and found.remedy is None and problem.free.any()
    found = scatter.explained(found) if unexplained else found
    found = hold_open(found, given)
    found = rival_densities.with_rivals(found) if found.inquire else found
    found = indirect_inference.corrected(found) if found.inquire else found
    if _edges_hide_density(found):
        found = found.replaced(objection=found.objection or UNKNOWN_EDGES)
    return with_mask_shifts(found)


def _edges_hide_density(found: Found) -> bool:
    """Whether a wrong minimum in density may explain what a mask with unknown edges leaves."""
    problem = found.problem
    if problem.picture.texel_variance is None or not problem.model.banded:
        return False
    return density_minima.bands_at(found.settled, found.evidence, problem).doubtful


def _explained_by_another(problem: Problem, effort: Effort) -> Found | None:
    """The best start of a shader of several passes, with the objection, where the picture is
    Mitchell's sum instead. Its search takes a second, and that of the passes, which nothing would
    explain, minutes."""
    model = problem.model
    whole = isinstance(model, Mitchell) and model.convention.composed and problem.free.any()
    if not whole or not effort.inquire:
        return None
    assert isinstance(model, Mitchell)
    template = dataclasses.replace(model, shader=PLAIN_SUM, samples=at_run_time(PLAIN_SAMPLES))
    free = np.ones(len(problem.free), bool)
    plain = problem.replaced(model=template, free=free, held=np.full(len(free), np.nan, np.float32))
    effort.report(f"screening of {PLAIN_SUM}'s sum")
    starts = starting_points(plain, {})
    climbed = multigrid.climb(plain.small, starts, effort.report, stages=stages(template))
    settled = _on_few_pixels(plain, climbed.coordinates)
    if settled.sigma > PLAIN_NOISE:
        return None
    found = _likeliest(problem, [starting_points(problem, {})[0]], effort)
    if found.settled.sigma < settled.sigma:
        return None
    words = ANOTHER_SUM.format(settled.sigma, model.convention.name, found.settled.sigma)
    return found.replaced(objection=words, inquire=False)


def _located(problem: Problem, given: dict[str, float], effort: Effort) -> Located:
    """The likeliest point, from a grid of starts: with taps up to the light, and beyond it where
    those lead to its end."""
    any_free, model = problem.free.any(), problem.model
    effort.report("screening")
    whole_range, problem = problem, beyond_light.up_to_light(problem, given)
    begun = starting_points(problem, given)
    candidates = [begun[0]]
    if any_free and model.banded:
        rehearse(begun[0], problem, effort.max_values)
    if any_free:
        climbed = multigrid.climb(problem.small, begun, effort.report, stages=stages(model))
        candidates = [climbed.coordinates]
    if any_free and model.banded:
        candidates = density_minima.on_subset(problem, candidates[0], effort.report)
        if beyond_light.may_lie_beyond(candidates, problem):
            problem = whole_range
            candidates = beyond_light.searched(problem, candidates[0], given, effort.report)
    found = _likeliest(problem, candidates, effort)
    if beyond_light.barely_beyond(found):
        within = beyond_light.up_to_light(problem, {})
        found = _likeliest(within, [found.settled.coordinates], effort)
    return Located(found, begun)


def _likeliest(problem: Problem, candidates: list[np.ndarray], effort: Effort) -> Found:
    """The likeliest of the ``candidates`` (p,) on all pixels."""
    picture = problem.picture
    whole = picture.observe(pixels_used(picture, problem.seed, effort.max_values))
    effort.report(f"all {len(whole.pixels):,} pixels")
    settled, at, counted = density_minima.likeliest(problem, candidates, whole)
    at = at.thinned(picture.repeats)
    return Found(problem, counted, settled, at, inquire=effort.inquire)


def _doubted(located: Located, given: dict[str, float], effort: Effort) -> Found:
    """The fit, and, where its residual is neither rounding nor noise, densities above 1, other
    starts and other interpretations of the images."""
    found, begun = located
    if not multistart.doubtful(found):
        return found
    jittered = scatter.allowing_for_jitter(found)
    if jittered is not None and not multistart.doubtful(jittered):
        return jittered
    whole_range = found.problem.replaced(most={})
    farther = beyond_light.searched_anew(
        whole_range, found.settled.coordinates, given, effort.report
    )
    # Numbers of a fit that is wrong either way stay as they are.
    other = _likeliest(whole_range, farther, effort) if farther else found
    if not multistart.doubtful(other):
        return other
    found = multistart.again(found, begun[:RETRIED], effort.report)
    effort.report("mask or transfer interpreted otherwise")
    problem = found.problem

    def starts(picture):
        return starting_points(problem.replaced(picture=picture), given)

    return found.replaced(remedy=multistart.remedy(found, starts, effort.report))


def _with_plateaus(own: Located, given: dict[str, float], effort: Effort) -> Located:
    """The point with the values that many pixels share at an end of the target's scale taken as
    clipped, where that is likelier than a flat area. Both are probabilities of the same values;
    the level of the clipping is one more number, of 256."""
    if not own.found.problem.free.any() or own.found.settled.sigma <= WITHIN_ROUNDING:
        return own
    for top in (True, False):
        problem, likelihood = own.found.problem, own.found.settled.log_likelihood
        plateau = problem.picture.plateau(top)
        if plateau is None:
            continue
        effort.report(f"values of {plateau[0]:g} taken as clipped")
        end = {"ceiling" if top else "floor": plateau[0]}
        picture = dataclasses.replace(problem.picture, **end)
        other = _located(problem.replaced(picture=picture, most={}), given, effort)
        if other.found.settled.log_likelihood > likelihood + math.log(LEVELS + 1):
            own = other
    return own


def _of_better_size(own: Located, given: dict[str, float], effort: Effort) -> Located:
    """The point ``own`` of the mask's size, or that of the rival with a light pass of another size
    where this is decidedly better; with a note where one of them is.

    Both are compared on the same few pixels, first from the point at hand, so that a picture of the
    mask's size that is merely noisy costs no second search.
    """
    found, problem = own.found, own.found.problem
    if effort.rival is None or not problem.free.any() or found.settled.sigma <= WITHIN_ROUNDING:
        return own
    effort.report("a light pass of another size")
    rival, start, chosen, note = effort.rival(), found.settled.coordinates, own, ""
    ends = {"floor": problem.picture.floor, "ceiling": problem.picture.ceiling}
    rival = rival.replaced(picture=dataclasses.replace(rival.picture, **ends))
    here, there = _on_few_pixels(problem, start), _on_few_pixels(rival, start)
    if there.log_likelihood > here.log_likelihood + DECISIVE_LOG_ODDS:
        other = _located(rival, given, effort)
        there = _on_few_pixels(rival, other.found.settled.coordinates)
        # A smaller pass is smoother, so that it also hides a part of what other defects cause.
        explained = not multistart.doubtful(other.found)
        explained |= there.sigma < multistart.REMEDIED * here.sigma
        if explained and there.log_likelihood > here.log_likelihood + DECISIVE_LOG_ODDS:
            chosen, note = other, OTHER_SIZE
    elif here.log_likelihood > there.log_likelihood + DECISIVE_LOG_ODDS:
        note = OWN_SIZE
    h, w = rival.picture.pass_size(rival.model)
    scale = h / problem.picture.mask.shape[0]
    words = note.format(scale=scale, w=w, h=h, own=here.sigma, other=there.sigma)
    return chosen._replace(
        found=chosen.found.replaced(notes=(Remark(words, "pass-scale"),) if note else ())
    )


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

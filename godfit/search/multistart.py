"""Other starts and other explanations of the images, where the residual of a fit is not noise."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from godfit.inference import diagnostics
from godfit.inference.fitted import Found
from godfit.inference.information import evidence, misfit
from godfit.inference.noise import WITHIN_ROUNDING
from godfit.inference.observation import Picture
from godfit.inference.problem import SEARCH_PIXELS, Problem
from godfit.inference.settle import Settled, settle
from godfit.inference.strategy import Report, trading
from godfit.io.filters import grey
from godfit.search import multigrid, suspects

SAME_END = 0.02
"""Distance of coordinates (density, shares of the picture) within which two fits ended alike."""
REMEDIED = 0.5
"""Share of the noise, on a small copy, that another interpretation must leave at most."""
MAX_SHIFT = 6
"""Pixels by which mask and target may be shifted against each other, at most."""
FINE_DETAIL = 2.0
"""Standard deviation in pixels of the Gaussian that is subtracted to leave edges."""

Starts = Callable[[Picture], list[np.ndarray]]
"""Starting points for a picture."""


def doubtful(found: Found) -> bool:
    """Whether the residual is more than rounding and unlike noise."""
    if found.settled.sigma <= 2 * WITHIN_ROUNDING:
        return False
    return not misfit(found.evidence.prediction, found.observation).like_noise


def again(found: Found, starts: list[np.ndarray], report: Report) -> Found:
    """The likelier of the fit and what each of ``starts``, alone, leads to; with how many of them
    ended where it is."""
    problem = found.problem
    observation = problem.observe(SEARCH_PIXELS)
    own, _ = settle(found.settled.coordinates, problem, observation)
    ends, best = [], own
    for start in starts:
        report("other starts")
        point = multigrid.climb(problem.small, [start], lambda text: None)
        end, _ = settle(point.coordinates, problem, observation)
        ends.append(end.coordinates)
        if end.log_likelihood > best.log_likelihood:
            best = end
    if best is not own:
        settled, tangent = settle(best.coordinates, problem, found.observation)
        if settled.log_likelihood > found.settled.log_likelihood + 1:
            at = evidence(settled, tangent, found.observation)
            found = found.replaced(settled=settled, evidence=at)
    compared = ~np.isin(problem.names, trading(problem.model))
    here = found.settled.coordinates[compared]
    agreed = sum(bool(np.all(np.abs(end[compared] - here) < SAME_END)) for end in ends)
    return found.replaced(starts_agreed=(agreed, len(ends)))


def remedy(found: Found, starts: Starts, report: Report) -> diagnostics.Suspect | None:
    """What was wrong, if another interpretation of the images is explained far better: the mask's
    place, or what ``suspects`` tries. Its fits begin at ``starts``."""
    other = suspects.suspected(found, starts, report)
    if other is not None:
        return other
    shift = _other_place(found.problem, starts)
    if shift is None:
        return None
    words = diagnostics.WORDS["moved"].format(down=shift[0], right=shift[1])
    return diagnostics.Suspect(1.0, "moved", words)


def _other_place(problem: Problem, starts: Starts) -> tuple[int, int] | None:
    """Pixels, down and to the right, by which the mask must be moved to fit far better; None where
    no shift does. The shift at which the edges of mask and target agree best is tried first, then
    its neighbours for as long as they are better."""
    from scipy import ndimage

    picture = problem.picture
    if picture.mask.shape[:2] != picture.size or min(picture.size) < 4 * MAX_SHIFT:
        return None

    def moved(by: tuple[int, int]) -> Problem:
        mask = ndimage.shift(picture.mask, (*by, 0)[: picture.mask.ndim], order=0, mode="nearest")
        return problem.replaced(picture=picture.with_mask(mask)).small

    here = _anew(problem.small, starts).sigma
    shift = edges_agree(grey(picture.levels), grey(picture.mask))
    best = _anew(moved(shift), starts)
    tried = {shift}
    while best.sigma < here:
        around = {(shift[0] + i, shift[1] + j) for i in (-1, 0, 1) for j in (-1, 0, 1)} - tried
        tried |= around
        ends = {by: _settled(moved(by), best.coordinates) for by in around}
        nearest = min(ends, key=lambda by: ends[by].sigma, default=shift)
        if nearest == shift or ends[nearest].sigma >= best.sigma:
            break
        shift, best = nearest, ends[nearest]
    return shift if shift != (0, 0) and best.sigma < REMEDIED * here else None


def _anew(problem: Problem, starts: Starts) -> Settled:
    """The fit of the problem from the starts of its own picture."""
    point = multigrid.climb(problem, starts(problem.picture), lambda text: None)
    return _settled(problem, point.coordinates)


def _settled(problem: Problem, start: np.ndarray) -> Settled:
    return settle(start, problem, problem.observe(SEARCH_PIXELS))[0]


def edges_agree(target: np.ndarray, mask: np.ndarray) -> tuple[int, int]:
    """The shift of ``mask`` (h, w), at most MAX_SHIFT pixels either way, by which its fine detail
    is correlated most with that of ``target`` (h, w)."""
    from scipy import ndimage

    inner = (slice(MAX_SHIFT, -MAX_SHIFT),) * 2
    fine = [z - ndimage.gaussian_filter(z, FINE_DETAIL) for z in (target, mask)]

    def agreement(by: tuple[int, int]) -> float:
        moved = np.roll(fine[1], by, (0, 1))[inner]
        size = np.sqrt((moved**2).sum())
        return float((fine[0][inner] * moved).sum() / max(size, 1e-30))

    reach = range(-MAX_SHIFT, MAX_SHIFT + 1)
    return max(itertools.product(reach, reach), key=agreement)

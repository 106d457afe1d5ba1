"""Other starts, where what is left of a fit is not noise and one start is not to be trusted."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from godfit import search
from godfit.inference import evidence, misfit
from godfit.verdict import Found

# Coordinates in which starts that agree have ended: density and the light, to this.
NEAR = 0.02
# What reading the target otherwise must leave of the misfit on a small copy.
REMEDIED = 0.5


def doubtful(found: Found) -> bool:
    """Whether what is left is more than rounding and unlike noise."""
    if found.settled.sigma <= 2 * search.WITHIN_ROUNDING:
        return False
    return not misfit(found.at.prediction, found.seen).like_noise


def again(found: Found, starts: list[np.ndarray], seed: int, say: Callable[[str], None]) -> Found:
    """The likelier of the fit and what each of ``starts``, climbed from on its own, leads to; with
    how many of them ended where it is."""
    model, picture, free, held = found.model, found.picture, found.free, found.held
    seen = picture.observe(picture.informative(search.PIXELS, seed))
    own, _ = search.settle(found.settled.coordinates, model, seen, free, held)
    ends, best = [], own
    for start in starts:
        say("other starts")
        point = search.climb(picture.small, model, [start], free, held, seed, lambda _: None)
        end, _ = search.settle(point.coordinates, model, seen, free, held)
        ends.append(end.coordinates)
        if end.log_likelihood > best.log_likelihood:
            best = end
    if best is not own:
        settled, tangent = search.settle(best.coordinates, model, found.seen, free, held)
        if settled.log_likelihood > found.settled.log_likelihood + 1:
            at = evidence(settled, tangent, found.seen)
            found = dataclasses.replace(found, settled=settled, at=at)
    here = found.settled.coordinates[2:]
    agreed = sum(bool(np.all(np.abs(end[2:] - here) < NEAR)) for end in ends)
    return dataclasses.replace(found, starts_agreed=(agreed, len(ends)))


def other_transfer(found: Found, begin: Callable[..., list[np.ndarray]], seed: int) -> bool:
    """Whether the target, read as sRGB, fits a small copy far better than read as linear. Misfits
    are both in the target's own levels."""
    picture = found.picture.small
    if picture.transfer != "none" or picture.half == 0:
        return False
    costs = []
    for transfer in ("none", "srgb"):
        read = dataclasses.replace(picture, transfer=transfer)
        starts = begin(read)
        point = search.climb(
            read, found.model, starts, found.free, found.held, seed, lambda _: None
        )
        seen = read.observe(np.flatnonzero(read.valid))
        settled, _ = search.settle(point.coordinates, found.model, seen, found.free, found.held)
        costs.append(settled.sigma)
    return costs[1] < REMEDIED * costs[0]

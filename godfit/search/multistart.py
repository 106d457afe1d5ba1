"""Other starts and other readings of the images, where what is left of a fit is not noise."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np
from scipy import ndimage

from godfit.inference import diagnostics
from godfit.inference.fitted import Found
from godfit.inference.information import evidence, misfit
from godfit.inference.noise import WITHIN_ROUNDING
from godfit.inference.observation import Picture
from godfit.inference.problem import PIXELS
from godfit.inference.settle import Settled, settle
from godfit.io.filters import grey
from godfit.search import multigrid
from godfit.search.density_minima import HOPELESS

# Coordinates in which starts that agree have ended: density and the light, to this.
NEAR = 0.02
# What another reading of the images must leave of the misfit on a small copy.
REMEDIED = 0.5
# Pixels by which mask and target may be shifted against each other, and within which edges lie.
REACH, FINE = 6, 2.0


def doubtful(found: Found) -> bool:
    """Whether what is left is more than rounding and unlike noise."""
    if found.settled.sigma <= 2 * WITHIN_ROUNDING:
        return False
    return not misfit(found.at.prediction, found.seen).like_noise


def again(found: Found, starts: list[np.ndarray], seed: int, say: Callable[[str], None]) -> Found:
    """The likelier of the fit and what each of ``starts``, climbed from on its own, leads to; with
    how many of them ended where it is."""
    model, picture, free, held = found.model, found.picture, found.free, found.held
    seen = picture.observe(picture.informative(PIXELS, seed))
    own, _ = settle(found.settled.coordinates, model, seen, free, held)
    ends, best = [], own
    for start in starts:
        say("other starts")
        point = multigrid.climb(picture.small, model, [start], free, held, seed, lambda _: None)
        end, _ = settle(point.coordinates, model, seen, free, held)
        ends.append(end.coordinates)
        if end.log_likelihood > best.log_likelihood:
            best = end
    if best is not own:
        settled, tangent = settle(best.coordinates, model, found.seen, free, held)
        if settled.log_likelihood > found.settled.log_likelihood + 1:
            at = evidence(settled, tangent, found.seen)
            found = dataclasses.replace(found, settled=settled, at=at)
    here = found.settled.coordinates[2:]
    agreed = sum(bool(np.all(np.abs(end[2:] - here) < NEAR)) for end in ends)
    return dataclasses.replace(found, starts_agreed=(agreed, len(ends)))


def remedy(
    found: Found, begin: Callable[[Picture], list[np.ndarray]], seed: int
) -> diagnostics.Suspect | None:
    """What was wrong, if the images, read otherwise, are explained far better: the mask's place or
    the target's transfer. Fits start from where ``begin`` says."""
    words = ""
    place = _other_place(found, begin, seed)
    if place is not None:
        words = diagnostics.WORDS["moved"].format(down=place[0], right=place[1])
    elif found.settled.sigma > HOPELESS and _other_transfer(found, begin, seed):
        words = diagnostics.WORDS["transfer"]
    return diagnostics.Suspect(1.0, "remedy", words) if words else None


def _other_transfer(found: Found, begin: Callable[[Picture], list[np.ndarray]], seed: int) -> bool:
    """Whether the target, read as sRGB, fits a small copy far better than read as linear. Misfits
    are both in the target's own levels."""
    picture = found.picture.small
    if picture.transfer != "none" or picture.half == 0:
        return False
    linear, coded = (
        _anew(found, dataclasses.replace(picture, transfer=transfer), begin, seed).sigma
        for transfer in ("none", "srgb")
    )
    return coded < REMEDIED * linear


def _other_place(
    found: Found, begin: Callable[[Picture], list[np.ndarray]], seed: int
) -> tuple[int, int] | None:
    """Pixels, down and to the right, by which the mask must be moved to fit far better; None where
    no place does. Where the edges of mask and target agree best is tried first, then its neighbours
    for as long as they are better."""
    picture = found.picture
    if picture.mask.shape[:2] != picture.size or min(picture.size) < 4 * REACH:
        return None

    def moved(by: tuple[int, int]) -> Picture:
        mask = ndimage.shift(picture.mask, (*by, 0)[: picture.mask.ndim], order=0, mode="nearest")
        return picture.with_mask(mask)

    here = _anew(found, picture.small, begin, seed).sigma
    place = edges_agree(grey(picture.levels), grey(picture.mask))
    best = _anew(found, moved(place).small, begin, seed)
    tried = {place}
    while best.sigma < here:
        around = {(place[0] + i, place[1] + j) for i in (-1, 0, 1) for j in (-1, 0, 1)} - tried
        tried |= around
        ends = {by: _settled(found, moved(by).small, best.coordinates, seed) for by in around}
        nearest = min(ends, key=lambda by: ends[by].sigma, default=place)
        if nearest == place or ends[nearest].sigma >= best.sigma:
            break
        place, best = nearest, ends[nearest]
    return place if place != (0, 0) and best.sigma < REMEDIED * here else None


def _anew(found: Found, read: Picture, begin: Callable[[Picture], list[np.ndarray]], seed: int):
    """The fit of ``read`` from where its own search begins."""
    starts = begin(read)
    point = multigrid.climb(read, found.model, starts, found.free, found.held, seed, lambda _: None)
    return _settled(found, read, point.coordinates, seed)


def _settled(found: Found, read: Picture, start: np.ndarray, seed: int) -> Settled:
    seen = read.observe(read.informative(PIXELS, seed))
    return settle(start, found.model, seen, found.free, found.held)[0]


def edges_agree(target: np.ndarray, mask: np.ndarray) -> tuple[int, int]:
    """The shift of ``mask`` (h, w), at most REACH pixels either way, by which its fine detail is
    correlated most with that of ``target`` (h, w)."""
    inner = (slice(REACH, -REACH),) * 2
    fine = [z - ndimage.gaussian_filter(z, FINE) for z in (target, mask)]

    def agreement(by: tuple[int, int]) -> float:
        moved = np.roll(fine[1], by, (0, 1))[inner]
        size = np.sqrt((moved**2).sum())
        return float((fine[0][inner] * moved).sum() / max(size, 1e-30))

    reach = range(-REACH, REACH + 1)
    return max(itertools.product(reach, reach), key=agreement)

"""The search of a picture that comes with nothing, on a small copy of it: lights that are voted
for, starts from them, what objects and shadows make of these, the best of them on a finer copy."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from godfit.blind import glare, screen_disc
from godfit.blind.beginnings import likeliest, rough
from godfit.blind.explained import explained, grain
from godfit.blind.screenshot import Reading, template
from godfit.blind.turns import Read, Turns
from godfit.inference.evaluate import coordinates_at
from godfit.inference.observation import Picture
from godfit.inference.problem import Problem
from godfit.inference.solver import Point
from godfit.io.filters import over_channels
from godfit.io.image import LEVELS
from godfit.models.background import TERM_COUNTS
from godfit.models.coordinates import EDGE
from godfit.models.disc_light import DiscLight
from godfit.models.mitchell import Mitchell
from godfit.runtime.parallel import parallel_map

# Longest sides of the copy that is searched on and of the finer one that the search ends on, pixels
# for first and for later looks.
SIDE, FINE, FEW, MORE = 240, 480, 1024, 4096
# Taps of first looks, and with shadows on the small copy: where a disc's edge is, too few do not
# tell. On the finer copy there are as many as the shader has.
COARSE_TAPS, TAPS = 48, 96
# Starts, those tried with objects as they seem to be, and trials refined with their shadows; one
# whose cost is so many times the least is none, before shadows and with them.
STARTS, TRIED, FOLLOWED, HOPELESS, WORSE = 6, 2, 2, 8.0, 1.5
# How far, in picture heights, objects may reach into glare that hides them all, and the noise
# allowed for on the way, before and with shadows.
GROWTHS, BEFORE, WITH = (0.02, 0.045, 0.075), (8.0, 4.0, 2.0), (1.0, 0.5)
# Noise in levels allowed for in turns of light and shadows, on the small copy and on a finer one:
# where that is not the picture yet, nor are its shadows the picture's, and one turn will do.
SIGMAS, FINER = (2.0, 1.0, 1.0, 0.5), (0.5, 0.5)
# Starts whose lights lie within so much of the picture agree.
AGREE = 0.01
# How wide, in picture heights, a hard edge of the disc is taken to be while it is looked for.
SHARP = 0.002


class End(NamedTuple):
    """Where the search ended: coordinates (p,); the mask (h, w) of the finer copy's size, refined,
    and as the small copy had it."""

    coordinates: np.ndarray
    mask: np.ndarray
    coarse: np.ndarray


class Look(NamedTuple):
    """What the search found, best first, and the ``copy`` of the picture that it ended on, which is
    the picture itself where that is no larger, and its ``texture``, in levels; where the light of
    every start (n, 2) had come to, and how much of what varies the light explains (1 all)."""

    ends: tuple[End, ...]
    copy: Picture
    texture: float
    model: DiscLight
    lights: np.ndarray
    explained: float


def look(
    reading: Reading,
    shading: Mitchell,
    given: Mapping[str, float],
    held: np.ndarray,
    seed: int,
    say: Callable[[str], None],
) -> Look:
    """Search on a small copy. ``given`` parameters are not searched for; ``held`` (p,) are those
    held, NaN where free."""
    picture = reading.picture
    small = picture.shrunk(-(-max(picture.size) // SIDE))
    full = template(shading, picture.channels, reading.degree, reading.tint)
    fixed = held.copy()
    free = np.isnan(fixed)
    if free[EDGE]:
        # Discs are drawn with hard edges; a soft one looks much like another place of the light.
        fixed[EDGE], free[EDGE] = SHARP, False
    if np.isnan(fixed[[0, 3]]).all():
        # What tells exposure and weight apart, the pixel's own value, is for a closer look.
        fixed[3], free[3] = shading.defaults.get("weight", 0.8), False
    model = _with_taps(full, COARSE_TAPS)
    still = _at_taps(fixed, full, model)
    say("votes for the light")
    lights = screen_disc.places(small, seed)
    if {"light_x", "light_y"} <= set(given):
        lights = np.array([[given["light_x"], given["light_y"]]])
    say(f"{len(lights)} lights")
    begun = screen_disc.starts(small, small.mask, TERM_COUNTS[reading.degree], lights, seed, STARTS)
    seen = small.observe(small.informative(FEW, seed))
    begun += likeliest(_as_given(glare.starts(picture, seed), given), still, model, seen)
    points = rough(begun, Problem(model, small, free, still, seed), seen)
    model = _with_taps(full, TAPS)
    still = _at_taps(fixed, full, model)
    masks = _reaching_into_glare(small)
    first, *others = _apart(points)[:TRIED]
    begun_with = [(first, mask) for mask in masks] + [(p, small.mask) for p in others]
    say(f"{len(begun_with)} of {len(points)} starts and {len(masks)} masks, with their shadows")
    turns = Turns(model, small, reading.unknown, grain(small), free, still, seed)
    seen = small.observe(small.informative(MORE, seed + 1))

    def unshadowed(begin: tuple[Point, np.ndarray]) -> Read:
        # Where a start ends under what may be open.
        read = Read.of(*begin, seen)
        for sigma in BEFORE:
            read = turns.descended(read, sigma)
        return read

    trials = _likely(parallel_map(unshadowed, begun_with), HOPELESS)
    trials = parallel_map(lambda read: _with_shadows(turns, read, WITH), trials)
    trials = _likely(trials, WORSE)[:FOLLOWED]
    say(f"{len(trials)} of them further")
    begun_again = [Read.of(t.point, t.thought, seen) for t in trials]
    ended = parallel_map(lambda read: _with_shadows(turns, read, SIGMAS), begun_again)
    copy, coarse = small, [read.mask for read in ended]
    if small.size != picture.size:
        say("a finer copy")
        copy, model, still = picture.shrunk(-(-max(picture.size) // FINE)), full, fixed
        turns = Turns(model, copy, reading.unknown, grain(copy), free, still, seed)
        seen = copy.observe(copy.informative(MORE, seed + 2))
        coarse = [enlarged(mask, small.mask, copy.mask) for mask in coarse]
        sigmas = FINER if copy.size == picture.size else FINER[:1]

        def finely(begin: tuple[Read, np.ndarray]) -> Read:
            read, mask = begin
            return _with_shadows(turns, Read.of(read.point, mask, seen), sigmas)

        ended = parallel_map(finely, zip(ended, coarse, strict=True))
    both = sorted(zip(ended, coarse, strict=True), key=lambda each: each[0].point.cost)
    best = both[0][0]
    shaded = copy.with_mask(best.mask)
    share = explained(best.point.coordinates, still, model, shaded, turns.texture)
    ends = [
        End(
            np.asarray(coordinates_at(read.point.coordinates, still, model), np.float32),
            enlarged(read.mask, copy.mask, copy.mask),
            mask,
        )
        for read, mask in both
    ]
    lights = np.stack([p.coordinates[4:6] for p in points])
    return Look(tuple(ends), copy, turns.texture, full, lights, share)


def agreed(lights: np.ndarray, light: np.ndarray) -> tuple[int, int]:
    """Starts whose light, of ``lights`` (n, 2), is where it was found (2,) in the end, of all."""
    near = np.abs(lights - light).max(-1) < AGREE
    return int(np.count_nonzero(near)), len(near)


def _with_taps(model: DiscLight, most: int) -> DiscLight:
    """The same picture with no more than so many taps a ray."""
    shading = dataclasses.replace(model.shading, samples=min(model.samples, most))
    return DiscLight(shading, model.shape, model.background, model.tint)


def _at_taps(held: np.ndarray, model: DiscLight, fewer: DiscLight) -> np.ndarray:
    """What of ``model`` is held (p,), NaN where free, as ``fewer`` taps that make the same light
    have it. Coordinates are the same for both."""
    still, times = held.copy(), model.samples / fewer.samples
    still[1] **= times
    still[3] *= times
    return still


def _as_given(begun: list[dict[str, float]], given: Mapping[str, float]) -> list[dict[str, float]]:
    """None that puts the light elsewhere than it was given."""
    return [] if {"light_x", "light_y"} & set(given) else begun


def _reaching_into_glare(small: Picture) -> list[np.ndarray]:
    """What may be open, (h, w) each: as it seems, and with objects that reach so far into glare,
    where all channels are clipped and nothing is seen of them."""
    glare = over_channels(np.logical_and, small.levels >= LEVELS - small.half - 0.5)
    solid = small.mask < 0.5
    masks = [small.mask]
    for growth in GROWTHS:
        steps = max(1, round(growth * small.size[0]))
        reached = ndimage.binary_dilation(solid, iterations=steps, mask=solid | glare)
        mask = np.where(np.logical_and(reached, ~solid), 0, small.mask).astype(np.float32)
        if not np.array_equal(mask, masks[-1]):
            masks.append(mask)
    return masks


def _likely(trials: list[Read], times: float) -> list[Read]:
    """Best first, without those that leave so many ``times`` the least."""
    trials = sorted(trials, key=lambda trial: trial.point.cost)
    return [trial for trial in trials if trial.point.cost <= times * trials[0].point.cost]


def _with_shadows(turns: Turns, read: Read, sigmas: tuple[float, ...]) -> Read:
    """Light and occluders in turn, until they suit each other."""
    for sigma in sigmas:
        read = turns.turn(read, sigma)
    return turns.solved(read, 1.0)


def _apart(points: list[Point]) -> list[Point]:
    """Points, cheapest first, with their lights apart."""
    kept: list[Point] = []
    for p in points:
        if np.isfinite(p.cost) and not any(_agree(p, q) for q in kept):
            kept.append(p)
    return kept or points


def _agree(p: Point, q: Point) -> bool:
    return bool(np.abs(p.coordinates[4:6] - q.coordinates[4:6]).max() < AGREE)


def enlarged(mask: np.ndarray, before: np.ndarray, fine: np.ndarray) -> np.ndarray:
    """``fine`` (h, w) with what became of its small copy, or of itself: as it was where that was
    confirmed."""
    (h, w), (rows, columns) = fine.shape, mask.shape
    at = np.ix_(np.arange(h) * rows // h, np.arange(w) * columns // w)
    changed = np.abs(mask - before) > 0.25
    return np.where(changed[at], mask[at].clip(0, 1), fine).astype(np.float32)

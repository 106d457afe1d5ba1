"""A picture that comes with nothing: what is open, where the light is, and the fit of both.

What differs from the background in colour stands in the way, or lies on top; of what only edges cut
off, or glare hides, the shadows decide. Pixels of objects and panels say nothing themselves: what
they look like without the light is anybody's guess.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from godfit import glare, screen_disc
from godfit.disc import EDGE, FIRST, TERMS, DiscLight, terms
from godfit.explained import explained, grain
from godfit.image import Image
from godfit.kept import kept
from godfit.likelihood import log_likelihood
from godfit.models import Mitchell
from godfit.observation import LEVELS, Observation, Picture, over_channels
from godfit.points import coordinates_at, predicted
from godfit.segment import Segments, grown, light_colour, panels, segments
from godfit.side_by_side import side_by_side
from godfit.solver import Point, solve
from godfit.turns import Read, Turns

# Share of pixels that the model may be silent about without being told.
FOREIGN = 0.02
# Longest side of the copy that is searched on, pixels for first and for later looks.
SIDE, FEW, MORE = 240, 1024, 4096
# Taps of first looks, and with shadows on the small copy: where a disc's edge is, too few do not
# tell. On the finer copy there are as many as the shader has.
COARSE_TAPS, TAPS = 48, 96
# Starts, those tried with objects as they seem to be, and trials refined with their shadows; one
# whose cost is so many times the least is none, before shadows and with them.
STARTS, TRIED, FOLLOWED, HOPELESS, WORSE = 6, 2, 2, 8.0, 1.5
# How far, in picture heights, objects may reach into glare that hides them all, and the noise
# allowed for on the way, before and with shadows.
GROWTHS, BEFORE, WITH = (0.02, 0.045, 0.075), (8.0, 4.0, 2.0), (1.0, 0.5)
# Pixels of the last look, in blocks of so many rows and columns: what errs together is told by
# neighbours. Sums along rows cost less.
LAST, ROWS, COLUMNS = 16_384, 8, 32
VEILS = (None, 0.05)
# Noise in levels that the first steps allow for, and the points that go on for more of them.
COARSE, AGAIN = 8.0, 4
# Levels by which the background's colours must vary over the picture to be called smooth.
SMOOTH = 1.5
# Noise in levels allowed for in turns of light and shadows, on the small copy and on a finer one.
SIGMAS, FINER = (2.0, 1.0, 1.0, 0.5), (0.5, 0.5)
# Texture in levels next to which the light is taken to be white.
TEXTURE = 1.5
# Share of the picture that must be background for the rest to be objects.
LEAST = 0.03
# Starts whose lights lie within so much of the picture agree.
AGREE = 0.01
# How wide, in picture heights, a hard edge of the disc is taken to be while it is looked for.
SHARP = 0.002


class Reading(NamedTuple):
    """``picture`` with ``mask`` 1 where it is open; ``unknown`` (h, w) is what shadows decide;
    ``panels`` as (x, y, width, height); ``degree`` of the background; ``tint`` of the light, (2,)
    or, where it is white, (0,)."""

    picture: Picture
    unknown: np.ndarray
    panels: list[tuple[int, int, int, int]]
    degree: int
    tint: np.ndarray


class End(NamedTuple):
    """Where the search ended: coordinates (p,); the mask (h, w) of the finer copy's size, refined,
    and as the small copy had it."""

    coordinates: np.ndarray
    mask: np.ndarray
    coarse: np.ndarray


class Look(NamedTuple):
    """What the search found, best first, and the ``copy`` of the picture that it ended on, which is
    the picture itself where that is no larger; where the light of every start (n, 2) had come to,
    and how much of what varies the light explains (1 all)."""

    ends: tuple[End, ...]
    copy: Picture
    model: DiscLight
    lights: np.ndarray
    explained: float


def read(target: Image, valid: np.ndarray | None, occluder: np.ndarray | None) -> Reading:
    """What can be told before any light is known. ``occluder`` (h, w) is True where the user says
    that something stands in the way."""
    size = target.values.shape[:2]
    picture = Picture.make(target, np.ones(size, np.float32), None, valid)
    picture = dataclasses.replace(picture, foreign=FOREIGN)
    colour = _light_colour(picture)
    found = segments(picture.levels, picture.half, picture.valid, colour)
    lying = panels(found.other | found.doubtful, picture.levels)
    open_, silent, unknown = _sorted_out(picture, found, lying)
    if (picture.valid & ~silent).mean() < LEAST:
        # Objects all over are no objects.
        open_, silent = np.ones_like(open_), np.zeros_like(silent)
    if occluder is not None:
        open_ = np.where(occluder, 0, open_).astype(np.float32)
        silent |= grown(occluder, 2)
        unknown &= ~occluder
    picture = dataclasses.replace(picture, mask=open_, valid=picture.valid & ~silent)
    tint = colour[[0, 2]] if np.any(colour != 1) else np.zeros(0)
    return Reading(picture, unknown, lying, 0 if found.variation < SMOOTH else 2, tint)


def _light_colour(picture: Picture) -> np.ndarray:
    """The light's (c,). Texture has a colour of its own, which hides it."""
    if grain(picture) > TEXTURE:
        return np.ones(picture.channels)
    return light_colour(picture.levels, picture.half, picture.valid)


def _sorted_out(picture: Picture, found: Segments, lying: list[tuple[int, int, int, int]]):
    """(h, w) each: what is open at first sight, what says nothing, what shadows decide."""
    open_ = np.where(found.other, 0.0, 1.0).astype(np.float32)
    silent = grown(found.other, 2)
    unknown = found.other | found.doubtful | (picture.clipped & picture.valid)
    unknown = grown(unknown)
    for x, y, wide, tall in lying:
        over = (slice(y, y + tall), slice(x, x + wide))
        around = (slice(max(y - 2, 0), y + tall + 2), slice(max(x - 2, 0), x + wide + 2))
        open_[over], silent[around], unknown[over] = 1.0, True, False
    return open_, silent, unknown


def template(shading: Mitchell, channels: int, degree: int, tint) -> DiscLight:
    """The model at no particular point, but for the light's ``tint`` (t,)."""
    return DiscLight(shading, [0.1, 0.003, 0.05], np.zeros((TERMS[degree], channels)), tint)


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
    begun = screen_disc.starts(small, small.mask, TERMS[reading.degree], lights, seed, STARTS)
    seen = small.observe(small.informative(FEW, seed))
    begun += _likeliest(_as_given(glare.starts(picture, seed), given), still, model, seen)
    points = _rough(begun, free, still, model, seen)
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

    trials = _likely(side_by_side(unshadowed, begun_with), HOPELESS)
    trials = side_by_side(lambda read: _with_shadows(turns, read, WITH), trials)
    trials = _likely(trials, WORSE)[:FOLLOWED]
    say(f"{len(trials)} of them further")
    begun_again = [Read.of(t.point, t.thought, seen) for t in trials]
    ended = side_by_side(lambda read: _with_shadows(turns, read, SIGMAS), begun_again)
    copy, coarse = small, [read.mask for read in ended]
    if small.size != picture.size:
        say("a finer copy")
        copy, model, still = picture.shrunk(-(-max(picture.size) // (2 * SIDE))), full, fixed
        turns = Turns(model, copy, reading.unknown, grain(copy), free, still, seed)
        seen = copy.observe(copy.informative(MORE, seed + 2))
        coarse = [enlarged(mask, small.mask, copy.mask) for mask in coarse]

        # Shadows that are found on a copy are not those of the picture.
        sigmas = FINER if copy.size == picture.size else FINER[:1]

        def finely(begin: tuple[Read, np.ndarray]) -> Read:
            read, mask = begin
            return _with_shadows(turns, Read.of(read.point, mask, seen), sigmas)

        ended = side_by_side(finely, zip(ended, coarse, strict=True))
    both = sorted(zip(ended, coarse, strict=True), key=lambda each: each[0].point.cost)
    best = both[0][0]
    share = explained(best.point.coordinates, still, model, copy.with_mask(best.mask))
    ends = [
        End(
            np.asarray(coordinates_at(read.point.coordinates, still, model), np.float32),
            enlarged(read.mask, copy.mask, copy.mask),
            mask,
        )
        for read, mask in both
    ]
    return Look(tuple(ends), copy, full, np.stack([p.coordinates[4:6] for p in points]), share)


def agreed(lights: np.ndarray, light: np.ndarray) -> tuple[int, int]:
    """Starts whose light, of ``lights`` (n, 2), is where it was found (2,) in the end, of all."""
    near = np.abs(lights - light).max(-1) < AGREE
    return int(np.count_nonzero(near)), len(near)


def blocks(picture: Picture, seed: int) -> np.ndarray:
    """Sorted indices of LAST valid pixels, in blocks drawn at random; all where there are fewer."""
    h, w = picture.size
    rows, columns = -(-h // ROWS), -(-w // COLUMNS)
    order = np.random.default_rng(seed).permutation(rows * columns)
    rank = np.argsort(order).reshape(rows, columns)
    rank = np.kron(rank, np.ones((ROWS, COLUMNS), int))[:h, :w].ravel()
    pixels = np.flatnonzero(picture.valid)
    # Always as many, the last block cut off: for every other number the program would be compiled
    # anew.
    return np.sort(pixels[np.argsort(rank[pixels], kind="stable")[:LAST]])


def _veiled(start: Mapping[str, float], veil: float | None) -> dict[str, float]:
    """A start's gains as they would be under a veil of this brightness."""
    if veil is None:
        return {}
    gain = max(start["veil_gain"] / veil, 0.3 * start["gain"])
    return {"gain": gain * (1 - veil), "veil_gain": gain * veil}


def _as_given(begun: list[dict[str, float]], given: Mapping[str, float]) -> list[dict[str, float]]:
    """None that puts the light elsewhere than it was given."""
    return [] if {"light_x", "light_y"} & set(given) else begun


def _likeliest(
    begun: list[dict[str, float]], held: np.ndarray, model: DiscLight, seen: Observation
) -> list[dict[str, float]]:
    """The best of starts as they are, for every light."""

    def off(start: dict[str, float]) -> float:
        z = with_background(coordinates_of(start, model), held, model, seen)
        levels = predicted(z, held, model, seen)
        sigma = np.float32(COARSE)
        return -float(log_likelihood(levels, seen.lo, seen.hi, sigma, seen.foreign).sum())

    best: dict[tuple[float, float], dict[str, float]] = {}
    for start in sorted(begun, key=off):
        best.setdefault((start["light_x"], start["light_y"]), start)
    return list(best.values())


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


def _rough(
    begun: list[dict[str, float]],
    free: np.ndarray,
    held: np.ndarray,
    model: DiscLight,
    seen: Observation,
) -> list[Point]:
    """Solved from every start and veil, cheapest first."""

    def from_start(begin: tuple[dict[str, float], float | None]) -> Point:
        start, veil = begin
        z = with_background(coordinates_of(start | _veiled(start, veil), model), held, model, seen)
        # Wide first: what is far off must not pass for foreign.
        z = solve(z, free, held, model, seen, 4 * COARSE).coordinates
        return solve(z, free, held, model, seen, COARSE)

    def further(point: Point) -> Point:
        return solve(point.coordinates, free, held, model, seen, COARSE)

    points = side_by_side(from_start, itertools.product(begun, VEILS))
    points.sort(key=lambda p: p.cost)
    points = [*side_by_side(further, points[:AGAIN]), *points[AGAIN:]]
    return sorted(points, key=lambda p: p.cost)


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


def coordinates_of(start: Mapping[str, float], model: DiscLight) -> np.ndarray:
    """Coordinates of what the screening found; the background is left out."""
    unit = model.convention.gain * float(model.colour.mean())
    disc, veil = (start[name] / unit for name in ("gain", "veil_gain"))
    both = max(disc + veil, 1e-2)
    veil = float(np.clip(veil, 0.003 * both, 0.5 * both))
    weight = model.shading.defaults.get("weight", 0.8)
    exposure = both * start["density"] / (model.samples * weight)
    place = start["light_x"], start["light_y"]
    first = [exposure, start["kappa"], start["density"], both - veil, *place]
    rest = np.zeros(model.background.size)
    return np.array([*first, start["radius"], 0.004, veil, *rest, *model.tint], np.float32)


def with_background(
    z: np.ndarray, held: np.ndarray, model: DiscLight, seen: Observation
) -> np.ndarray:
    """Coordinates with the background that suits the rest of them best, by least squares."""
    light = np.asarray(_light(z, held, model, seen))
    k, c = model.background.shape
    lo, hi = (np.asarray(b).reshape(-1, c) for b in (seen.lo, seen.hi))
    known = over_channels(np.logical_and, np.isfinite(hi))
    if not known.any():
        return z
    basis = terms(np.asarray(seen.pixels), seen.size, k)[known]
    goal = ((np.maximum(lo, 0) + hi) / 2)[known] / LEVELS
    goal = goal - light[known, None] * np.asarray(model.colour)
    found = np.linalg.lstsq(basis, goal, rcond=None)[0]
    # Once more without the tenth that is farthest off.
    off = np.abs(goal - basis @ found).max(1)
    close = off <= np.quantile(off, 0.9)
    found = np.linalg.lstsq(basis[close], goal[close], rcond=None)[0]
    z = z.copy()
    z[FIRST : FIRST + found.size] = found.reshape(-1)
    return z.astype(np.float32)


@kept
def _light(z, held, model: DiscLight, seen: Observation):
    at = model.moved(z, held)
    return at.light_pass(seen.mask, size=seen.size, pixels=seen.pixels)

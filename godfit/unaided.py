"""The fit of a picture that comes with nothing, from its bytes to what was found.

See ``screenshot.py`` for how it is understood. The search runs on a small copy; the answer is
settled on blocks of the whole picture under a likelihood with heavy tails.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np
from scipy import ndimage

from godfit import inputs, screenshot, search
from godfit.disc import DENSITY, EDGE, GAIN, RADIUS, DiscLight
from godfit.errors import InputError
from godfit.explained import grain, predicted
from godfit.image import Image
from godfit.inference import Evidence, evidence
from godfit.models import Mitchell
from godfit.observation import Observation, Picture
from godfit.side_by_side import side_by_side
from godfit.solver import Point, solve_tangent
from godfit.turns import Read, Turns
from godfit.valley import DOUBT
from godfit.verdict import Found

# Of what varies in a picture, the share that light must explain to be called rays. Photographs,
# text and noise reach 0, textured screenshots .4.
RAYS = 0.25
# Exposure of a shader without a default, where nothing tells it from the weight.
FAINT = 0.1
# The valley in which radius, veil and gain trade is long.
ROUNDS = 25
# Noise in levels that the copy's answer may be off by, less and less.
NEAR = (4.0, 2.0, 1.0)
# Turns of shadows and light, before and after the size of the light pass is decided, and pixels
# that shadows are found by.
SOME, TURNS, SHADOWED = 2, 6, 1 << 14
# Dips of density, either way, and shares of the radius that are tried, and how much more may be
# left by what is as likely.
DIPS, RADII, ALIKE = (-1, 0, 1), (0.75, 1.25), 1.02
# Widths of the disc's edge, in texels of the light pass, that are tried one after the other.
EDGES = (0.3, 0.2, 0.1, 0.05)
# The size of a light pass that is tried beside the picture's own.
HALF = 0.5
# Pixels without which nothing can be told.
LEAST = 500
NO_RAYS = (
    "no rays were found: a light explains {:.0f}% of what varies in this picture, a smooth "
    "background the rest"
)
COARSE = "the light pass looks half the picture's size; give --pass-scale to say otherwise"
DISAGREE = "only {} of {} starts agree on the light: look at fit.png; give --start light_x=..."
HIDDEN = (
    "the light's disc is clipped or hidden: radius, veil and exposure trade, and glare may hide "
    "occluders"
)


def found_in(
    target: Image,
    shading: Mitchell,
    valid: np.ndarray | None,
    occluder: np.ndarray | None,
    pass_scale: float | None,
    fix: Mapping[str, float | None],
    start: Mapping[str, float],
    seed: int,
    say: Callable[[str], None],
) -> tuple[Found, tuple[str, ...]]:
    """What was found, and notes. ``valid`` and ``occluder`` are (h, w): where to look, and where
    something is known to stand in the way; ``pass_scale`` is asked of the picture where it is not
    given. Raises InputError for what cannot be read so."""
    if shading.convention.box:
        raise InputError(
            f"mask: expected one with the shader '{shading.shader}', got none; give --mask"
        )
    if min(target.values.shape[:2]) < 32:
        h, w = target.values.shape[:2]
        raise InputError(f"target: expected at least 32x32 pixels without a mask, got {w}x{h}")
    if valid is not None and np.count_nonzero(valid) < LEAST:
        raise InputError(
            f"ignore: expected some open background, at least {LEAST} pixels, got "
            f"{np.count_nonzero(valid)}; ignore less"
        )
    say("background, objects, panels")
    reading = screenshot.read(target, valid, occluder)
    notes = tuple(
        f"a panel at {x},{y},{w},{h} is taken to lie on top and is left out"
        for x, y, w, h in reading.panels
    )

    def held_by(model: DiscLight) -> np.ndarray:
        return inputs.parameters(model, fix, start)[1]

    model = screenshot.template(shading, reading.picture.channels, reading.degree)
    given, held = inputs.parameters(model, fix, start)
    looked = screenshot.look(reading, shading, given, held_by, seed, say)
    model, picture = looked.model, looked.picture
    opened: list[tuple[int, list[int]]] = []
    open_ = np.asarray(picture.mask)
    picture = dataclasses.replace(picture, mask=inputs.shrink_mask(open_, pass_scale or 1.0))
    free = np.isnan(held) & model.used
    edges = EDGES if free[EDGE] else ()
    if edges:
        held[EDGE], free[EDGE] = screenshot.SHARP, False
    hidden = _hidden(model, looked.coordinates, held, picture)
    if free[0] and free[3] and (hidden or not model.convention.own_pixel):
        # Only the disc itself would tell a pixel's own value, if it is shown, from its rays.
        held[0] = given.get("exposure", model.shading.defaults.get("exposure", FAINT))
        free[0] = False
        opened.append((0, [3]))
    texture = grain(picture)
    turns = Turns(model, picture, reading.unknown, texture, free, held, seed)
    seen = picture.observe(screenshot.blocks(picture, seed))
    say(f"{len(seen.pixels):,} pixels")
    rays = looked.explained > RAYS
    rounds = ROUNDS if rays else 1
    begin = Read.of(Point(looked.coordinates, np.inf, False, 0), picture.mask, seen)
    if rays:
        masks = []
        if pass_scale is None:
            # On a copy of that size shadows were those of such a pass.
            masks = [inputs.shrink_mask(mask, HALF) for mask in (open_, looked.coarse)]
        say("shadows")
        first, read = _of_its_size(turns, begin, [begin.with_thought(mask) for mask in masks])
        if read.mask.shape != picture.mask.shape:
            pass_scale = HALF
            notes += (COARSE,)
        say("densities and radii beside it")
        thought = inputs.shrink_mask(np.asarray(reading.picture.mask), pass_scale or 1.0)
        turns, read, doubts = _best(turns, first, read._replace(thought=thought), edges)
    else:
        first = read = turns.solved(begin, NEAR[-1])
        doubts = []
    (point, mask, _, seen), held = read, turns.held
    picture = dataclasses.replace(picture, mask=mask)
    settled, tangent = search.settle(point.coordinates, model, seen, free, held, rounds=rounds)
    at = _with_ranges(evidence(settled, tangent, seen), model.ranges(settled.coordinates))
    found = Found(model, picture, seen, settled, at, free, held, opened, False)
    found.starts_agreed = looked.starts_agreed
    objection = "" if rays else NO_RAYS.format(100 * max(looked.explained, 0))
    remarks = []
    if looked.starts_agreed[0] < 2 and looked.starts_agreed[1] > 1:
        remarks.append(DISAGREE.format(*looked.starts_agreed))
    if hidden:
        remarks.append(HIDDEN)
    # As far from what was found as the rivals are from what was first thought.
    rivals = (
        picture.mask + inputs.shrink_mask(mask, pass_scale or 1.0) - first.mask
        for mask in _rivals(open_, np.asarray(reading.picture.mask))
    )
    shifts = [
        _shift(settled, tangent, model, seen, free, held, rival.clip(0, 1).astype(np.float32))
        for rival in rivals
    ]
    shifts += [np.where(free, shift, 0.0) for shift in doubts]
    if free[DENSITY]:
        shifts.append(_next_dip(settled, at.covariance(free), model.samples))
    found = dataclasses.replace(
        found, remarks=tuple(remarks), objection=objection, shifts=tuple(shifts)
    )
    return found, notes


def _of_its_size(turns: Turns, own: Read, smaller: list[Read]) -> tuple[Read, Read]:
    """Solved under a light pass of its ``own`` size or, where that is likelier, under one of the
    ``smaller``; before and after each has the shadows that suit it."""

    def near(read: Read) -> Read:
        # At some noise first: where a copy's answer is a little off, rays must not pass for
        # foreign.
        for sigma in NEAR:
            read = turns.solved(read, sigma)
        return read

    own, *smaller = side_by_side(near, [own, *smaller])
    sizes = [own, *sorted(smaller, key=_cost)[:1]]
    turned = side_by_side(lambda read: turns.turned(read, SHADOWED, SOME), sizes)
    likelier = turned[-1].point.cost < turned[0].point.cost - DOUBT
    return (sizes[-1], turned[-1]) if likelier else (sizes[0], turned[0])


def _cost(read: Read) -> float:
    return read.point.cost


def _best(
    turns: Turns, first: Read, read: Read, edges: tuple[float, ...]
) -> tuple[Turns, Read, list[np.ndarray]]:
    """The best of what is found from an answer and from beside it, with the disc's edge that suits
    it, and changes (p,) that it may be off by: a mask that explains more takes the light with it
    from where it was at ``first``, and what differs in density may explain as much."""
    again = sorted([read, *_again(turns, read)], key=turns.total)
    best = turns.turned(again[0], SHADOWED, TURNS)
    limit, z = ALIKE * turns.total(best), best.point.coordinates
    alike = [r.point.coordinates - z for r in again if turns.total(r) < limit]
    doubts = [z - first.point.coordinates, *sorted(alike, key=lambda d: abs(d[DENSITY]))[-1:]]
    sharp = side_by_side(lambda read: _sharpened(turns, read, edges), [best, *again[1:2]])
    turns, read = min(sharp, key=lambda pair: pair[0].total(pair[1]))
    return turns, read, doubts


def _sharpened(turns: Turns, read: Read, edges: tuple[float, ...]) -> tuple[Turns, Read]:
    """With the harder edge of the disc, of ``edges`` in texels, that explains most: one that is
    drawn, with anti-aliasing or without, is narrower than a texel, and the rays show it."""
    best = turns, read
    for texels in edges:
        held = turns.held.copy()
        held[EDGE] = texels / read.mask.shape[0]
        turns = dataclasses.replace(turns, held=held)
        z = read.point.coordinates.copy()
        z[EDGE] = held[EDGE]
        read = turns.turn(turns.solved(read.at(z), turns.noise), SHADOWED, turns.noise)
        if turns.total(read) < best[0].total(best[1]):
            best = turns, read
    return best


def _again(turns: Turns, read: Read) -> list[Read]:
    """What is found from the answer, from the dips of density beside it and from other radii, each
    with shadows of its own: a mask that has settled holds the light where it is, and shadows can
    make up for a wrong density or radius."""
    starts = [(DENSITY, 1 + dips / turns.model.samples) for dips in DIPS]
    starts += [(RADIUS, times) for times in RADII]

    def found(start: tuple[int, float]) -> Read:
        index, times = start
        z, still = read.point.coordinates.copy(), turns.free.copy()
        z[index] *= times
        if index == RADIUS and turns.free[GAIN]:
            # What a smaller disc lacks its brightness makes up for.
            z[GAIN] /= times
        z = np.clip(z, *(np.asarray(b, z.dtype) for b in turns.model.bounds()))
        still[index] = False
        held = dataclasses.replace(turns, free=still)
        # Wide first, as what is far off would pass for foreign.
        there = held.solved(read.with_thought(read.thought).at(z), 2 * held.noise)
        there = held.turn(held.solved(there, held.noise), SHADOWED, held.noise)
        return turns.turn(there, SHADOWED, turns.noise)

    return side_by_side(found, [s for s in starts if turns.free[s[0]]])


def _rivals(mask: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, ...]:
    """Masks as likely as ``mask``: objects a pixel smaller or larger, and as first seen."""
    return (
        np.asarray(ndimage.maximum_filter(mask, 3)),
        np.asarray(ndimage.minimum_filter(mask, 3)),
        first,
    )


def _next_dip(settled: search.Settled, covariance: np.ndarray, samples: int) -> np.ndarray:
    """(p,) how far the next of the dips lies that the taps make in the cost by density, see
    ``dips.py``: with a mask of one's own making the deepest need not be the right one."""
    dip = float(settled.coordinates[DENSITY]) / samples
    return covariance[:, DENSITY] / covariance[DENSITY, DENSITY] * dip


def _with_ranges(at: Evidence, ranges: np.ndarray) -> Evidence:
    """The evidence with what is known beforehand: coordinates lie within plausible ranges. Radius,
    veil and gain can trade until nothing but this limits them."""
    known = np.diag(1 / ranges**2)
    return at._replace(
        curvature=at.curvature + known, scores=at.scores + known, blunt=at.blunt + known
    )


def _shift(
    settled: search.Settled,
    tangent: search.Tangent,
    model: DiscLight,
    seen: Observation,
    free: np.ndarray,
    held: np.ndarray,
    mask: np.ndarray,
) -> np.ndarray:
    """(p,) how far the answer moves where ``mask`` is the right one, on the tangent."""
    other = seen.with_mask(mask)
    prediction = np.asarray(predicted(settled.coordinates, held, model, other))
    lo, hi = np.asarray(seen.lo), np.asarray(seen.hi)
    # Where the other mask would make a pixel foreign it is not that mask that is right.
    sigma = max(settled.sigma, 0.5)
    point = solve_tangent(
        settled.coordinates, free, model, tangent.scale, prediction, tangent.jacobian, lo, hi,
        sigma, seen.foreign,
    )  # fmt: skip
    return np.where(free, point.coordinates - settled.coordinates, 0.0)


def _hidden(model: DiscLight, z: np.ndarray, held: np.ndarray, picture: Picture) -> bool:
    """Whether less than a tenth of the light's outline lies where it can be read."""
    at = model.moved(z, held)
    h, w = picture.size
    (u, v), radius = np.asarray(at.light[0]), float(at.shape[0])
    turn = np.linspace(0, 2 * np.pi, 256, endpoint=False)
    column = np.floor(u * w + radius * h * np.cos(turn)).astype(int)
    row = np.floor((1 - v) * h - radius * h * np.sin(turn)).astype(int)
    inside = (column >= 0) & (column < w) & (row >= 0) & (row < h)
    known = ndimage.binary_erosion(picture.valid & ~picture.clipped)
    return bool(np.count_nonzero(known[row[inside], column[inside]]) < 25)

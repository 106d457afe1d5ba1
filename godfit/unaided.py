"""The fit of a picture that comes with nothing, from its bytes to what was found.

See ``screenshot.py`` for how it is understood. The search runs on a small copy; the answer is
settled on blocks of the whole picture under a likelihood with heavy tails.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping

import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from godfit import inputs, screenshot, search
from godfit.disc import DENSITY, EDGE, GAIN, LIGHT_X, LIGHT_Y, RADIUS, SOFT, VEIL, DiscLight
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
# Turns of shadows and light, before and after the size of the light pass is decided.
SOME, TURNS = 2, 6
# How far beside an answer it is looked for at first, and how often: shares of the radius and of the
# picture and powers of two of what the disc adds, half as far where that finds nothing, and dips of
# density, which stay as far apart.
BESIDE, LOOKS = {RADIUS: 0.2, LIGHT_X: 0.004, LIGHT_Y: 0.004, DENSITY: 1.0, GAIN: 1.0}, 6
# What leaves so much more before the rest has moved is given up, and how much more may be left by
# what is as likely.
WORSE, ALIKE = 1.25, 1.1
# Widths of the disc's edge in texels: of one that is drawn without anti-aliasing, whose rim is left
# to the shadows, and from where a soft one's is looked for.
HARD, WIDE = 0.1, 1.0
# A disc is in sight where it is brighter than the veil by this.
SEEN = 1.1
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
    model, picture = looked.model, reading.picture
    best, *others = looked.ends
    opened: list[tuple[int, list[int]]] = []
    picture = dataclasses.replace(picture, mask=inputs.shrink_mask(best.mask, pass_scale or 1.0))
    free = np.isnan(held) & model.used
    soft = bool(free[EDGE])
    if soft:
        held[EDGE], free[EDGE] = HARD / picture.mask.shape[0], False
    hidden = _hidden(model, best.coordinates, held, picture)
    if free[0] and free[3] and (hidden or not model.convention.own_pixel):
        # Only the disc itself would tell a pixel's own value, if it is shown, from its rays.
        held[0] = given.get("exposure", model.shading.defaults.get("exposure", FAINT))
        free[0] = False
        opened.append((0, [3]))
    texture = grain(picture)
    turns = Turns(model, picture, reading.unknown, texture, free, held, seed)
    few = picture.observe(picture.informative(screenshot.MORE, seed + 2))
    seen = picture.observe(screenshot.blocks(picture, seed))
    say(f"{len(seen.pixels):,} pixels")
    rays = looked.explained > RAYS
    rounds = ROUNDS if rays else 1

    def begun(end: screenshot.End, scale: float | None) -> Read:
        at = Point(end.coordinates, np.inf, False, 0)
        return Read.of(at, inputs.shrink_mask(end.mask, scale or 1.0), few)

    begin = begun(best, pass_scale)
    if rays:
        smaller = []
        if pass_scale is None:
            # On a copy of that size shadows were those of such a pass.
            smaller = [begun(end, HALF) for end in (best, best._replace(mask=best.coarse))]
        say("shadows")
        read = _of_its_size(turns, begin, smaller)
        if read.mask.shape != picture.mask.shape:
            pass_scale = HALF
            notes += (COARSE,)
            others = [end._replace(mask=end.coarse) for end in others]
            if soft:
                turns = _with_edge(turns, HARD / read.mask.shape[0])
        say("lights, densities and radii beside it")
        thought = inputs.shrink_mask(np.asarray(reading.picture.mask), pass_scale or 1.0)
        read = read._replace(thought=thought)
        read, doubts = _best(turns, read, [begun(end, pass_scale) for end in others])
        say(f"all of the {len(seen.pixels):,} pixels")
        read = turns.descended(read._replace(seen=seen.with_mask(read.mask)), turns.noise)
        read = turns.turned(read, TURNS)
        if soft:
            turns, read = _softened(turns, read)
    else:
        begin = begin._replace(seen=seen.with_mask(begin.mask))
        read, doubts = turns.solved(begin, NEAR[-1]), []
    point, mask, seen, free, held = read.point, read.mask, read.seen, turns.free, turns.held
    picture = dataclasses.replace(picture, mask=mask)
    settled, tangent = search.settle(point.coordinates, model, seen, free, held, rounds=rounds)
    at = _with_ranges(evidence(settled, tangent, seen), model.ranges(settled.coordinates))
    found = Found(model, picture, seen, settled, at, free, held, opened, False)
    found.starts_agreed = screenshot.agreed(looked, settled.coordinates[LIGHT_X : LIGHT_Y + 1])
    objection = "" if rays else NO_RAYS.format(100 * max(looked.explained, 0))
    remarks = []
    if free[GAIN] and free[VEIL] and _out_of_sight(model, settled.coordinates, held, picture):
        opened.append((GAIN, [VEIL]))
    if found.starts_agreed[0] < 2 and found.starts_agreed[1] > 1:
        remarks.append(DISAGREE.format(*found.starts_agreed))
    if _hidden(model, settled.coordinates, held, picture):
        remarks.append(HIDDEN)
    # As far from what was found as the rivals are from what the search ended with.
    scale = pass_scale or 1.0
    away = picture.mask - inputs.shrink_mask(best.mask, scale)
    rivals = (
        away + inputs.shrink_mask(rival, scale)
        for rival in _rivals(best.mask, np.asarray(reading.picture.mask))
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


def _of_its_size(turns: Turns, own: Read, smaller: list[Read]) -> Read:
    """Solved under a light pass of its ``own`` size or, where that is likelier, under one of the
    ``smaller``, each with the shadows that suit it."""

    own, *smaller = side_by_side(lambda read: _near(turns, read), [own, *smaller])
    sizes = [own, *sorted(smaller, key=_cost)[:1]]
    turned = side_by_side(lambda read: turns.turned(read, SOME), sizes)
    likelier = turned[-1].point.cost < turned[0].point.cost - DOUBT
    return turned[-1] if likelier else turned[0]


def _near(turns: Turns, read: Read) -> Read:
    """Solved at some noise first: where a copy's answer is a little off, rays must not pass for
    foreign."""
    for sigma in NEAR:
        read = turns.solved(read, sigma)
    return read._replace(before=read.point.coordinates)


def _cost(read: Read) -> float:
    return read.point.cost


def _best(turns: Turns, read: Read, others: list[Read]) -> tuple[Read, list[np.ndarray]]:
    """The best of what is found from an answer, from ``others`` and from beside them, and changes
    (p,) that it may be off by: a mask that explains more takes the light with it from where it was
    before, and what lies elsewhere may explain as much."""

    def afar(other: Read) -> Read:
        other = _near(turns, other)._replace(thought=read.thought)
        return turns.turned(other, SOME)

    def afresh(read: Read) -> Read:
        # A mask that has settled holds the light where it is.
        return turns.turn(read.unshadowed(), turns.noise)

    work = [functools.partial(afresh, read), *(functools.partial(afar, o) for o in others)]
    found = [read, *side_by_side(lambda find: find(), work)]
    best = min(found, key=turns.total)
    steps = {index: by for index, by in BESIDE.items() if turns.free[index]}
    tried = None
    for _ in range(LOOKS):
        before = best
        for index, by in steps.items():
            if index == DENSITY and tried is best:
                continue
            there = side_by_side(functools.partial(_beside, turns, best, index), (-by, by))
            found += there
            if index == DENSITY:
                tried = best
            elif turns.total(best) <= min(map(turns.total, there)):
                steps[index] = by / 2
            best = min(best, *there, key=turns.total)
        near = all(by < BESIDE[i] / 4 for i, by in steps.items() if i != DENSITY)
        if best is before and near:
            break
    limit, z = ALIKE * turns.total(best), best.point.coordinates
    alike = [r.point.coordinates - z for r in found if turns.total(r) < limit]
    scale = turns.model.scales(z)
    doubts = sorted(alike, key=lambda d: np.abs(d / scale)[turns.free].max(initial=0))[-1:]
    return best, doubts if best.before is None else [z - best.before, *doubts]


def _beside(turns: Turns, read: Read, index: int, by: float) -> Read:
    """What is found where one coordinate is moved, its shadows and the rest first, and then itself:
    single taps and texels make the way there too rough to be gone down."""
    z = read.point.coordinates.copy()
    if index == RADIUS:
        # Of a larger disc that is seen from as far, and as brightly.
        z[RADIUS] *= 1 + by
        if turns.free[DENSITY]:
            z[DENSITY] = 1 - (1 + by) * (1 - z[DENSITY])
        if turns.free[GAIN]:
            z[GAIN] /= 1 + by
        elif turns.free[0]:
            z[0] *= z[DENSITY] / read.point.coordinates[DENSITY] / (1 + by)
    elif index == DENSITY:
        z[DENSITY] *= 1 + by / turns.model.samples
    elif index == GAIN:
        z[GAIN] *= 2**by
    else:
        z[index] += by
    free = turns.free.copy()
    free[index] = False
    held = dataclasses.replace(turns, free=free)
    there = held.turn(read.at(turns.inside(z)), turns.noise)
    if turns.total(there) > WORSE * turns.total(read):
        return there
    return turns.turn(there, turns.noise)


def _with_edge(turns: Turns, width: float | None) -> Turns:
    """With the disc's edge held at a ``width`` in picture heights, or free."""
    free, held = turns.free.copy(), turns.held.copy()
    free[EDGE], held[EDGE] = width is None, np.nan if width is None else width
    return dataclasses.replace(turns, free=free, held=held)


def _softened(turns: Turns, read: Read) -> tuple[Turns, Read]:
    """With a soft edge of the disc where that explains more than another turn with a hard one."""
    softer, z, rows = _with_edge(turns, None), read.point.coordinates.copy(), read.mask.shape[0]
    z[EDGE] = WIDE / rows
    begin = softer.solved(read.at(z), turns.noise)
    both = [(softer, begin), (turns, read)]
    soft, hard = side_by_side(lambda each: each[0].turn(each[1], turns.noise), both)
    hard = min(read, hard, key=turns.total)
    wide = soft.point.coordinates[EDGE] > SOFT / rows
    if wide and softer.total(soft) < turns.total(hard) - DOUBT:
        return softer, softer.turned(soft, SOME)
    return turns, hard


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


def _out_of_sight(model: DiscLight, z: np.ndarray, held: np.ndarray, picture: Picture) -> bool:
    """Whether nothing in the picture is lit by more than the veil."""
    lit = np.asarray(model.moved(z, held).occlusion(jnp.ones(picture.mask.shape, jnp.float32)))
    return bool(lit.max() < SEEN * lit.min())


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

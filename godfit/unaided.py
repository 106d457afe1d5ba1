"""The fit of a picture that comes with nothing, from its bytes to what was found.

See ``screenshot.py`` for how it is understood. The search runs on a small copy; the answer is
settled on blocks of the whole picture under a likelihood with heavy tails.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from godfit import inputs, screenshot, search
from godfit.disc import DENSITY, DiscLight
from godfit.errors import InputError
from godfit.explained import grain, predicted
from godfit.image import Image
from godfit.inference import Evidence, evidence
from godfit.models import Mitchell
from godfit.observation import Observation, Picture, shrink
from godfit.occluders import refined
from godfit.side_by_side import side_by_side
from godfit.solver import Point, solve, solve_tangent
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
# Turns of shadows and light, before and after the size of the light pass is decided; pixels that
# shadows are found by, and the share of the cost that is worth another turn.
SOME, TURNS, SHADOWED, WORTH = 2, 6, 1 << 14, 0.02
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
    if free[screenshot.EDGE]:
        held[screenshot.EDGE], free[screenshot.EDGE] = screenshot.SHARP, False
    hidden = _hidden(model, looked.coordinates, held, picture)
    if free[0] and free[3] and (hidden or not model.convention.own_pixel):
        # Only the disc itself would tell a pixel's own value, if it is shown, from its rays.
        held[0] = given.get("exposure", model.shading.defaults.get("exposure", FAINT))
        free[0] = False
        opened.append((0, [3]))
    seen = picture.observe(screenshot.blocks(picture, seed))
    texture = grain(picture)
    say(f"{len(seen.pixels):,} pixels")
    rays = looked.explained > RAYS
    rounds = ROUNDS if rays else 1
    begin = _Read(Point(looked.coordinates, np.inf, False, 0), picture.mask, seen)
    # At some noise first: where a copy's answer is a little off, rays must not pass for foreign.
    noises = [max(sigma, texture) for sigma in (NEAR if rays else NEAR[-1:])]
    masks = [picture.mask]
    if rays and pass_scale is None:
        # On a copy of that size shadows were those of such a pass.
        masks += [inputs.shrink_mask(mask, HALF) for mask in (open_, looked.coarse)]
    first, *halved = side_by_side(
        lambda mask: _solved(begin.with_mask(mask), noises, free, held, model), masks
    )
    point = first.point
    if halved:
        say("a light pass of half the size")
        likelier = _likelier(
            first,
            halved,
            lambda read, turns: _in_turns(
                read, turns, model, picture, reading.unknown, texture, free, held, seed
            ),
        )
        if likelier is not None:
            first, (point, mask, seen) = likelier
            picture, pass_scale = dataclasses.replace(picture, mask=mask), HALF
            notes += (COARSE,)
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
    # A mask that may explain more takes the light with it.
    shifts.append(np.where(free, point.coordinates - first.point.coordinates, 0.0))
    if free[DENSITY]:
        shifts.append(_next_dip(settled, at.covariance(free), model.samples))
    found = dataclasses.replace(
        found, remarks=tuple(remarks), objection=objection, shifts=tuple(shifts)
    )
    return found, notes


class _Read(NamedTuple):
    """Where a solve ended, with the mask (h, w), of the light pass's size, that it was of."""

    point: Point
    mask: np.ndarray
    seen: Observation

    def with_mask(self, mask: np.ndarray) -> _Read:
        return _Read(self.point, mask, self.seen.with_mask(mask))


def _solved(
    read: _Read, noises: Sequence[float], free: np.ndarray, held: np.ndarray, model: DiscLight
) -> _Read:
    """Solved with one noise (levels) after the other allowed for."""
    point = read.point
    for sigma in noises:
        point = solve(point.coordinates, free, held, model, read.seen, sigma)
    return read._replace(point=point)


def _likelier(
    first: _Read, others: Sequence[_Read], in_turns: Callable[[_Read, int], _Read]
) -> tuple[_Read, _Read] | None:
    """Whichever of ``others``, masks of another size, explains more than ``first`` once each has
    the shadows that suit it, before and after those were found; None where none does. Those of a
    pass as large as the picture are known, and not looked for further."""
    own = in_turns(first, SOME)
    nearest = min(others, key=lambda read: read.point.cost)
    other = in_turns(nearest, SOME)
    if not other.point.cost < own.point.cost - DOUBT:
        return None
    return nearest, in_turns(other, TURNS)


def _in_turns(
    read: _Read,
    turns: int,
    model: DiscLight,
    picture: Picture,
    unknown: np.ndarray,
    texture: float,
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
) -> _Read:
    """Shadows and light in turn for as long as it helps. What is ``unknown`` (h, w) becomes what
    explains the rays best: the stairs of a disc that was drawn without anti-aliasing, too."""
    thought = read.mask
    unknown = shrink(unknown.astype(np.float32), thought.shape[:2]) > 0
    for _ in range(turns):
        at = model.moved(read.point.coordinates, held)
        known = dataclasses.replace(picture, mask=read.mask)
        mask = refined(at, known, unknown, thought, SHADOWED, seed, texture)
        noises = (max(NEAR[-1], texture),)
        there = _solved(read.with_mask(mask), noises, free, held, model)
        gained = 1 - there.point.cost / read.point.cost
        if gained > 0:
            read = there
        if not gained > WORTH:
            break
    return read


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

"""The fit of a picture that comes with nothing, from its bytes to what was found.

See ``screenshot.py`` for how it is understood. The search runs on a small copy (``first_look.py``);
the answer is settled on blocks of the whole picture under a likelihood with heavy tails.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np

from godfit.blind import first_look, screenshot
from godfit.blind.around import best_around
from godfit.blind.beside import NEAR, place_of
from godfit.blind.brightness import NARROW, along_gain
from godfit.blind.doubts import next_dip, rivals, shift
from godfit.blind.edge import hardened, softened, softer_at_once
from godfit.blind.explained import TEXTURE
from godfit.blind.no_rays import objection
from godfit.blind.pass_size import HALF, pass_scale_of
from godfit.blind.sight import hidden, out_of_sight
from godfit.blind.turns import SOME, Read, Turns
from godfit.errors import InputError
from godfit.inference.fitted import Found
from godfit.inference.information import evidence
from godfit.inference.observation import Observation, Picture
from godfit.inference.problem import Problem, given_and_held
from godfit.inference.settle import settle
from godfit.inference.solver import Point
from godfit.io.image import Image
from godfit.io.sources import shrink_mask
from godfit.models.background import TERM_COUNTS
from godfit.models.coordinates import DENSITY, EDGE, FIRST_BACKGROUND, GAIN, LIGHT_X, LIGHT_Y, VEIL
from godfit.models.mitchell import Mitchell
from godfit.runtime.blas import one_thread
from godfit.runtime.parallel import parallel_map

# Exposure of a shader without a default, where nothing tells it from the weight.
FAINT = 0.1
# The valley in which radius, veil and gain trade is long.
ROUNDS = 25
# Turns of shadows and light on the picture, most.
TURNS = 6
# Degree of a background that is not constant, in the end, and from the start where what the light
# makes up for would lead the search astray, in dips of density that are not its own; next to
# texture, which hides these, it would make up for the light.
FINER = 3
# Searches of a whole picture, most, until one explains it and shows where the disc ends: dips are
# so narrow that it hangs on which pixels are seen, and on how sums are rounded, in which one ends.
TRIES = 3
# Noise allowed for, in levels, where the search explains a picture: gains that leave as little next
# to a level of it are told apart by what is left of rounding.
ROUNDING = 0.3
# Pixels of the last look, and of that at a picture that was searched whole: how bright a clipped
# disc is hangs on a few pixels of many. They are in blocks of so many rows and columns: what errs
# together is told by neighbours, and sums along rows cost less.
LAST, LAST_OF_WHOLE, ROWS, COLUMNS = 16_384, 65_536, 8, 32
# Pixels without which nothing can be told.
LEAST = 500
COARSE = "the light pass looks half the picture's size; give --pass-scale to say otherwise"
DISAGREE = "only {} of {} starts agree on the light: look at fit.png; give --start light_x=..."
HIDDEN = (
    "the light's disc is clipped or hidden: radius, veil and exposure trade, and glare may hide "
    "occluders"
)


# Searches go on side by side, a core each.
@one_thread()
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
    like: np.ndarray | None = None,
) -> tuple[Found, tuple[str, ...]]:
    """What was found, and notes. ``valid`` and ``occluder`` are (h, w): where to look, and where
    something is known to stand in the way; ``pass_scale`` is asked of the picture where it is not
    given; ``like`` (4,) are coordinates of the scattering that other frames of a clip have, NaN
    where none tells. Raises InputError for what cannot be read so."""
    own = shading.convention
    # Without a mask the search has the four numbers of Mitchell's family, and scales of its kind.
    if not own.plain or own.absent or own.averaged or not own.own_scaled:
        raise InputError(f"mask: expected one with the shader '{own.name}', got none; give --mask")
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
    reading = reading._replace(degree=_degree(reading))
    notes = tuple(
        f"a panel at {x},{y},{w},{h} is taken to lie on top and is left out"
        for x, y, w, h in reading.panels
    )

    model = screenshot.template(shading, reading.picture.channels, reading.degree, reading.tint)
    given, held = given_and_held(model, fix, start)
    tint = slice(len(held) - len(reading.tint), None)
    free_tint = np.isnan(held[tint])
    # What it was read as will do until the rest is known.
    held[tint] = np.where(free_tint, reading.tint, held[tint])
    looked = first_look.look(reading, shading, given, held, seed, say)
    model, picture = looked.model, reading.picture
    best = looked.ends[0]
    opened: list[tuple[int, list[int]]] = []
    free = np.isnan(held) & model.used
    unseen = hidden(model, best.coordinates, held, picture)
    if free[0] and free[3] and (unseen or not model.convention.own_pixel):
        # Only the disc itself would tell a pixel's own value, if it is shown, from its rays.
        default = model.shading.defaults.get("exposure", FAINT)
        if like is not None and np.isfinite(like[0]):
            default = like[0]
        held[0] = given.get("exposure", default)
        free[0] = False
        opened.append((0, [3]))
    turns = Turns(model, picture, reading.unknown, reading.texture, free, held, seed)
    whole = looked.copy.size == picture.size
    clear = whole and turns.texture < TEXTURE
    seen = picture.observe(blocks(picture, seed, LAST_OF_WHOLE if clear else LAST))
    said = objection(looked, held, picture)
    rays = not said
    first = first_look.enlarged(best.mask, looked.copy.mask, picture.mask)
    rounds = ROUNDS if rays else 1
    if rays:
        sizes = _sizes(picture, turns.texture) if pass_scale is None else [pass_scale]
        turns, read, doubts = _searched_again(turns, looked, seen, sizes, say, like)
        if pass_scale is None and read.mask.shape != picture.mask.shape:
            pass_scale = HALF
            notes += (COARSE,)
        turns, read, doubts = _finer_background(turns, read, doubts)
        model = turns.model
        z = read.point.coordinates
        if not whole and free[EDGE] and not hidden(model, z, turns.held, picture):
            # Of a disc in sight: in glare what is misread looks soft.
            turns, read = softer_at_once(turns, read)
        say(f"all of the {len(seen.pixels):,} pixels")
        read = turns.descended(read._replace(seen=seen.with_mask(read.mask)), turns.noise)
        if whole:
            read = turns.turned(read, TURNS)
            if free[EDGE]:
                turns, read = softened(turns, read)
            read, _ = along_gain(turns, read, *NARROW)
        if free_tint.any():
            turns, read = _coloured(turns, read, free_tint)
    else:
        at = Point(best.coordinates, np.inf, False, 0)
        begin = Read.of(at, shrink_mask(first, pass_scale or 1.0), seen)
        turns = hardened(turns, begin)
        read, doubts = turns.solved(begin, NEAR[-1]), []
    point, mask, seen, free, held = read.point, read.mask, read.seen, turns.free, turns.held
    picture = picture.with_mask(mask)
    problem = Problem(model, picture, free, held, seed)
    settled, tangent = settle(point.coordinates, problem, seen, rounds=rounds)
    at = evidence(settled, tangent, seen).within(model.ranges(settled.coordinates))
    agreed = first_look.agreed(looked.lights, settled.coordinates[LIGHT_X : LIGHT_Y + 1])
    remarks = []
    if free[GAIN] and free[VEIL] and out_of_sight(model, settled.coordinates, held, picture):
        opened.append((GAIN, [VEIL]))
    if agreed[0] < 2 and agreed[1] > 1:
        remarks.append(DISAGREE.format(*agreed))
    if hidden(model, settled.coordinates, held, picture):
        remarks.append(HIDDEN)
    others = rivals(picture.mask, first, np.asarray(reading.picture.mask), pass_scale or 1.0)
    shifts = parallel_map(lambda other: shift(settled, tangent, problem, seen, other), others)
    shifts += [np.where(free, doubt, 0.0) for doubt in doubts]
    if free[DENSITY]:
        shifts.append(next_dip(settled, at.covariance(free), model.samples))
    found = Found(
        problem,
        seen,
        settled,
        at,
        tuple(opened),
        False,
        tuple(remarks),
        said,
        tuple(shifts),
        agreed,
    )
    return found, notes


def blocks(picture: Picture, seed: int, most: int = LAST) -> np.ndarray:
    """Sorted indices of ``most`` valid pixels, in blocks drawn at random; all where there are
    fewer."""
    h, w = picture.size
    rows, columns = -(-h // ROWS), -(-w // COLUMNS)
    order = np.random.default_rng(seed).permutation(rows * columns)
    rank = np.argsort(order).reshape(rows, columns)
    rank = np.kron(rank, np.ones((ROWS, COLUMNS), int))[:h, :w].ravel()
    pixels = np.flatnonzero(picture.valid)
    # Always as many, the last block cut off: for every other number the program would be compiled
    # anew.
    return np.sort(pixels[np.argsort(rank[pixels], kind="stable")[:most]])


def _degree(reading: screenshot.Reading) -> int:
    """Of the background that the light is searched before."""
    whole = max(reading.picture.size) <= first_look.FINE
    clear = reading.texture < TEXTURE
    return FINER if reading.degree and whole and clear else reading.degree


def _sizes(picture: Picture, texture: float) -> list[float]:
    """What the light pass's size may be against the picture's: texture, in levels, hides it."""
    told = pass_scale_of(picture) if texture < TEXTURE else None
    return [1.0, HALF] if told is None else [told]


def _searched_again(
    turns: Turns,
    looked: first_look.Look,
    seen: Observation,
    sizes: list[float],
    say: Callable[[str], None],
    like: np.ndarray | None,
) -> tuple[Turns, Read, list[np.ndarray]]:
    """The likeliest by all that is ``seen`` of what some searches found, each by pixels of its own,
    until one of them explains these and shows where the disc ends: of one that is clipped or hidden
    nearly any gain explains as much. Once where the search ended on a copy, where other frames of a
    clip have scattering ``like`` that (4,), and next to texture, which nothing explains."""
    if looked.copy.size != turns.picture.size or like is not None or turns.texture >= TEXTURE:
        return _searched(turns, looked, sizes, say, like)
    found: list[tuple[bool, float, tuple[Turns, Read, list[np.ndarray]]]] = []
    for again in range(TRIES):
        other = dataclasses.replace(turns, seed=turns.seed + again)
        end, read, doubts = _searched(other, looked, sizes, say, None)
        explained = place_of(end, read).explained
        if explained:
            end = dataclasses.replace(end, least=ROUNDING)
        there = end.descended(read._replace(seen=seen.with_mask(read.mask)), end.noise)
        found.append((not explained, place_of(end, there).left, (end, read, doubts)))
        if explained and not _trades(end, read):
            break
    # What is explained was solved next to less noise, and leaves more for it.
    return min(found, key=lambda each: each[:2])[2]


def _trades(turns: Turns, read: Read) -> bool:
    """Whether the disc's gain trades with its radius: it is in sight, but not where it ends."""
    at = turns.model, read.point.coordinates, turns.held, turns.picture
    return hidden(*at) and not out_of_sight(*at)


def _searched(
    turns: Turns,
    looked: first_look.Look,
    sizes: list[float],
    say: Callable[[str], None],
    like: np.ndarray | None,
) -> tuple[Turns, Read, list[np.ndarray]]:
    """The best of where the search ended and, unless that was on a smaller copy, of what lies
    beside it, by a few of the pixels, with a light pass of one of these ``sizes``, and changes (p,)
    that it may be off by."""
    picture = turns.picture
    few = picture.observe(picture.informative(first_look.MORE, turns.seed + 2))
    whole = looked.copy.size == picture.size

    def begun(end: first_look.End) -> list[Read]:
        # What it left on a copy says nothing of what it leaves here, nor do its shadows.
        at = Point(end.coordinates, np.inf, False, 0)
        masks = {scale: [end.mask if whole else np.asarray(picture.mask)] for scale in sizes}
        if whole and HALF in masks:
            # On a copy of that size shadows were those of such a pass.
            masks[HALF].append(end.coarse)
        return [
            Read.of(at, shrink_mask(mask, scale), few) for scale in sizes for mask in masks[scale]
        ]

    say("lights, densities and radii beside these" if whole else "shadows of the whole picture")
    ends = looked.ends if whole else looked.ends[:1]
    return best_around(turns, [begun(end) for end in ends], whole, like)


def _finer_background(
    turns: Turns, read: Read, doubts: list[np.ndarray]
) -> tuple[Turns, Read, list[np.ndarray]]:
    """With a background of as high a degree as in the end, unless it is constant."""
    k, c = turns.model.background.shape
    if k in (1, TERM_COUNTS[FINER]):
        return turns, read, doubts
    more, end = (TERM_COUNTS[FINER] - k) * c, FIRST_BACKGROUND + k * c

    def longer(values: np.ndarray, by: float = 0) -> np.ndarray:
        return np.insert(values, end, np.full(more, by, values.dtype))

    was = turns.model
    model = screenshot.template(was.shading, c, FINER, was.tint).cut_into(was.cut)
    free, held = longer(turns.free, True), longer(turns.held, np.nan)
    turns = dataclasses.replace(turns, model=model, free=free, held=held)
    return turns, read.at(longer(read.point.coordinates)), [longer(doubt) for doubt in doubts]


def _coloured(turns: Turns, read: Read, which: np.ndarray) -> tuple[Turns, Read]:
    """With those of the light's colour, ``which`` (t,), free that were held."""
    free, held = turns.free.copy(), turns.held.copy()
    free[-len(which) :], held[-len(which) :] = which, np.where(which, np.nan, held[-len(which) :])
    turns = dataclasses.replace(turns, free=free, held=held)
    return turns, turns.turned(turns.solved(read, turns.noise), SOME)

"""What lies beside an answer to a picture that comes with nothing: light passes of half the size,
other lights, radii and densities.

The cost has many dips, a texel or a tap apart, and single taps and texels make the way from one to
the next too rough to be gone down: neighbours are tried, each with the shadows that suit it.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from godfit import glare
from godfit.clear_rays import looks_alike, seen_clearly
from godfit.disc import DENSITY, GAIN, KAPPA, LIGHT_X, LIGHT_Y, RADIUS, VEIL
from godfit.edge import PARTS, hardened
from godfit.explained import predicted
from godfit.models import FAINTEST
from godfit.observation import shrink
from godfit.side_by_side import side_by_side
from godfit.turns import SOME, Read, Turns

# Noise in levels that the copy's answer may be off by, less and less.
NEAR = (4.0, 2.0, 1.0)
# How far beside an answer it is looked for at first: shares of the radius, periods of the light,
# dips of density and powers of two of what the disc adds and of the attenuation; half as far where
# that finds nothing, but no nearer than the next dip, and from there so many dips ``FARTHER``.
# Those of the light lie where the last tap comes to the next texel.
BESIDE = {RADIUS: 0.2, LIGHT_X: 1.0, LIGHT_Y: 1.0, DENSITY: 8.0, GAIN: 1.0, KAPPA: 1.0}
FARTHER = 4
# Share of that, of all of it where clear rays have shown the disc, of the light where glare has.
CLOSE, NEARBY = 0.25, 0.5
# Share of a radius that one step leaves of it, least.
LEAST = 0.3
# Answers that are looked around, most, each time, and steps on along one way.
LEFT, ON = (2, 1, 1), 4
# Times that is done, most, and the share of what was left that is worth another after these.
EARLY, TIMES, HEADWAY = 1, 9, 0.03
# Share of what is seen that is off by no more than so many halves of a level where rounding alone
# is left: of the light pass, and of a background that varies as well (quantiles of one and of the
# sum of two uniform errors, and a little). The rest is where an object's edge is not known, and
# costs no more than so many times what one rounding does.
MOST, ONCE, TWICE, REST = 0.9, 1.0, 1.4, 2.5
# What leaves so much more before the rest has moved is given up, and how much more may be left by
# what is as likely.
WORSE, ALIKE = 1.25, 1.05
# What leaves so many times the least is not looked around, nor what clear rays show from there.
FAR_WORSE, CLEARED = 2.0, 1.5
# Texture, in levels, next to which no disc is told to a part of a texel.
TEXTURE = 1.0
# What a disc is found by, and what frames of a clip share.
DISC, SHARED = (DENSITY, LIGHT_X, LIGHT_Y, RADIUS), (KAPPA, DENSITY, GAIN)
# Times that a radius shrinks or grows, most, where the gain does not suit it.
TIMES_AS_LARGE = 3.0


class Place(NamedTuple):
    """The best answer ``read`` of all that was ``found`` by ``turns`` around a beginning, how far
    beside it, by coordinate, is looked next, and how many dips of density from it nothing was
    found, by the coordinate that leads there."""

    turns: Turns
    read: Read
    found: tuple[Read, ...]
    steps: dict[int, float]
    known: dict[int, tuple[int, ...]]

    @property
    def left(self) -> float:
        """What is left and what its shadows cost, by the picture's area and not by how many texels
        a light pass has."""
        cost, (h, w) = self.read.point.cost, self.turns.picture.size
        return cost + (self.turns.total(self.read) - cost) * h * w / self.read.mask.size

    @property
    def explained(self) -> bool:
        """Hardly anything is left but what rounding leaves."""
        seen, turns = self.read.seen, self.turns
        rounding = (turns.picture.half / turns.noise) ** 2 / 6 * np.size(seen.lo)
        if self.read.point.cost > REST * rounding:
            return False
        levels = predicted(self.read.point.coordinates, turns.held, turns.model, seen)
        lo, hi = np.asarray(seen.lo), np.asarray(seen.hi)
        known = np.isfinite(lo) & np.isfinite(hi)
        off = np.abs(np.asarray(levels) - (lo + hi) / 2)[known]
        rounded = ONCE if turns.model.background.shape[0] == 1 else TWICE
        return len(off) > 0 and bool(np.quantile(off, MOST) < rounded * turns.picture.half)

    @property
    def finished(self) -> bool:
        """Nothing was found however near it was looked."""
        return all(map(self._exhausted, self.steps))

    def _exhausted(self, index: int) -> bool:
        dips = self.dips(index)
        return dips is None or (dips == 0 and self.steps[index] < BESIDE[index] / 4)

    def dips(self, index: int) -> int | None:
        """How many dips of density the next step along a coordinate leads across, at least one; 0
        if density does not go along with it, None if all there are to look at are known."""
        dips = _dips(self.turns, self.read, index, self.steps[index])
        known = self.known.get(index, ())
        if dips != 1 or 1 not in known:
            return dips
        return None if FARTHER in known else FARTHER


def best_around(
    turns: Turns, begun: list[list[Read]], around: bool, like: np.ndarray | None = None
) -> tuple[Turns, Read, list[np.ndarray]]:
    """The best of these beginnings, each of which may be of light passes of several sizes, and of
    what lies ``around`` them if that is wanted, and changes (p,) that it may be off by: a mask that
    explains more takes the light with it from where it was before, and what lies elsewhere may
    explain as much. By the turns that suit its size; see ``solved``. Other frames of its clip have
    scattering ``like`` that (4,), NaN where none tells."""
    sizes = side_by_side(functools.partial(solved, turns), itertools.chain(*begun))
    places = sizes
    if like is not None:
        places = [*sizes, *side_by_side(functools.partial(_likened, like=like), sizes)]
    if around:
        places = _around(turns, begun, sizes, places[len(sizes) :])
    found = itertools.chain.from_iterable(place.found for place in places)
    turns, read, *_ = min(places, key=_left)
    limit, z = ALIKE * turns.total(read), read.point.coordinates
    alike = [r.point.coordinates - z for r in found if turns.total(r) < limit]
    doubts = _spread(np.array(alike) * turns.free, turns.model.scales(z))
    return turns, read, doubts if read.before is None else [z - read.before, *doubts]


def _around(
    turns: Turns, begun: list[list[Read]], sizes: list[Place], likened: list[Place]
) -> list[Place]:
    """What lies around beginnings, solved in all their ``sizes``, and around what was ``likened``
    to other frames."""

    def afresh(place: Place) -> Place:
        # A mask that has settled holds the light where it is.
        again = place.turns.turn(place.read.unshadowed(), place.turns.noise)
        best = min(place.read, again, key=place.turns.total)
        return place._replace(read=best, found=(*place.found, again))

    each = iter(sizes)
    likely = [min((next(each) for _ in reads), key=_left) for reads in begun]
    places = [*side_by_side(afresh, likely), *likened]
    told = likened and min(places, key=_left).explained
    # Texture hides how a disc was drawn.
    if told or turns.texture >= TEXTURE:
        return _climbed(places, EARLY)
    limit = CLEARED * min(place.left for place in sizes)
    near = zip(itertools.chain(*begun), sizes, strict=True)
    asked = [read for read, place in near if place.left < limit]
    cleared = _cleared(turns, asked)
    places += cleared
    if not min(places, key=_left).explained:
        places += _glared(sizes)
        places += _crossed(places)
    places = _climbed(places, EARLY)
    best = min(places, key=_left)
    if best.explained:
        return places
    # What is nearly right knows better what is clear.
    asked += [place.read for place in cleared]
    places += _cleared(best.turns, [best.read], asked, True)
    return _climbed(places, TIMES)


def _climbed(places: list[Place], most_times: int) -> list[Place]:
    """The likeliest of these, looked around again and again, fewer each time."""
    before = np.inf
    for time in range(most_times):
        places = _apart(places)
        explained = places[0].explained
        # What is explained is looked around once.
        most = 1 if explained else LEFT[min(time, len(LEFT) - 1)]
        if (explained and time > 0) or all(place.finished for place in places[:most]):
            break
        if time >= len(LEFT) and not places[0].left < (1 - HEADWAY) * before:
            break
        before = places[0].left
        places = [place for place in places if place.left < FAR_WORSE * before][:most]
        places = [_looked_around(place) for place in places]
    return places


def _apart(places: list[Place]) -> list[Place]:
    """The likeliest first, without those that look like a likelier one."""
    kept: list[Place] = []
    for place in sorted(places, key=_left):
        if not any(looks_alike(place.read, other.read) for other in kept):
            kept.append(place)
    return kept


def _spread(changes: np.ndarray, scale: np.ndarray) -> list[np.ndarray]:
    """As far as these ``changes`` (n, p) go along each of their principal directions."""
    _, _, directions = np.linalg.svd(changes / scale, full_matrices=False)
    far = np.abs(changes / scale @ directions.T).max(0, initial=0)
    return [by * direction * scale for by, direction in zip(far, directions, strict=True) if by > 0]


def solved(turns: Turns, begin: Read) -> Place:
    """A beginning under the disc's edge as hard as it is drawn, unless that was held, with the
    shadows that suit it, which from now on are compared with what was open at first sight."""
    hard = hardened(turns, begin)
    read = _first_sight(turns, hard.turned(_near(hard, begin), SOME))
    # One that was solved already may be the better.
    return _place(hard, min(read, begin, key=hard.total))


def _place(turns: Turns, read: Read, close: Mapping[int, float] | None = None) -> Place:
    """Looked around nearer by, by these shares, along coordinates that are ``close``."""
    close = close or {}
    steps = {i: by * close.get(i, 1.0) for i, by in BESIDE.items() if turns.free[i]}
    return Place(turns, read, (read,), steps, {})


def _cleared(
    turns: Turns, reads: list[Read], asked: Iterable[Read] = (), shaded: bool = False
) -> list[Place]:
    """What clear rays show about each of these, where that was not ``asked`` before; and, if that
    is wanted, ``shaded`` ones."""
    places: list[Place] = []
    looked = [*asked]
    for read in reads:
        clear = not any(looks_alike(read, other) for other in looked)
        if not (clear or shaded):
            continue
        looked.append(read)
        # A light pass as large as the picture is drawn without anti-aliasing.
        own = read.mask.shape[:2] == turns.picture.size
        for cut in (1,) if own else (1, PARTS):
            hard = hardened(turns, read, cut)
            found = seen_clearly(hard, read, cut, clear, shaded)
            places += [_suited(hard, read, z) for z in found]
    return places


def _likened(place: Place, like: np.ndarray) -> Place:
    """With scattering ``like`` that of other frames (4,), held until the rest suits it."""
    turns, z = place.turns, place.read.point.coordinates.copy()
    free = turns.free[list(SHARED)]
    gain, veiled = z[GAIN] + z[VEIL], z[VEIL] / max(z[GAIN] + z[VEIL], FAINTEST)
    kappa, density, shared = np.where(np.isnan(like[1:]), (z[KAPPA], z[DENSITY], gain), like[1:])
    there = kappa, density, shared * (1 - veiled)
    z[list(SHARED)] = np.where(free, there, z[list(SHARED)])
    if free[-1]:
        z[VEIL] = shared * veiled
        # A ray adds as much where it leads across less of a brighter disc.
        z[RADIUS] *= np.clip(gain / max(shared, FAINTEST), 1 / TIMES_AS_LARGE, TIMES_AS_LARGE)
    return _suited(turns, place.read, z, SHARED)


def _suited(
    turns: Turns, read: Read, coordinates: np.ndarray, which: tuple[int, ...] = DISC
) -> Place:
    """A disc found elsewise (p,), ``which`` is held until the rest suits it."""
    held = _holding(turns, *which)
    found = held.solved(_first_sight(turns, read).unshadowed().at(coordinates), NEAR[0])
    found = turns.turned(_nearer(held, found), SOME)
    return _place(turns, found, dict.fromkeys(BESIDE, CLOSE))


def _glared(places: list[Place]) -> list[Place]:
    """These with the light in the middle of the outline of glare, held until the rest suits it: the
    likeliest of each size of light pass."""
    turns = places[0].turns
    if not turns.free[[LIGHT_X, LIGHT_Y]].all():
        return []
    circles = glare.circles(turns.picture, turns.seed, 1)

    def begun(each: tuple[Place, np.ndarray]) -> Place:
        place, circle = each
        z = place.read.point.coordinates.copy()
        z[[LIGHT_X, LIGHT_Y]] = circle[:2]
        held = _holding(place.turns, LIGHT_X, LIGHT_Y)
        read = held.solved(place.read.unshadowed().at(z), NEAR[0])
        return place._replace(read=held.turn(read, NEAR[0]))

    def suited(place: Place) -> Place:
        held = _holding(place.turns, LIGHT_X, LIGHT_Y)
        found = held.turned(_nearer(held, place.read), SOME)
        return _place(place.turns, found, dict.fromkeys((LIGHT_X, LIGHT_Y), NEARBY))

    found = side_by_side(begun, itertools.product(places, circles))
    return side_by_side(suited, _of_each_size(found))


def _crossed(places: list[Place]) -> list[Place]:
    """The likeliest of each size of light pass with the disc of the likeliest of another: dips of
    one are not those of the other."""

    def begun(pair: tuple[Place, Place]) -> Place:
        own, other = (place.read.point.coordinates for place in pair)
        z = own.copy()
        z[list(DISC)] = other[list(DISC)]
        return _suited(pair[0].turns, pair[0].read, z)

    return side_by_side(begun, itertools.permutations(_of_each_size(places), 2))


def _of_each_size(places: list[Place]) -> list[Place]:
    """The likeliest of each size of light pass."""
    best: dict[tuple[int, ...], Place] = {}
    for place in sorted(places, key=_left):
        best.setdefault(place.read.mask.shape, place)
    return list(best.values())


def _nearer(turns: Turns, read: Read) -> Read:
    """Turn by turn, with less and less noise allowed for."""
    for sigma in NEAR[1:]:
        read = turns.turn(read, sigma)
    return read


def _holding(turns: Turns, *which: int) -> Turns:
    """With these coordinates as they are."""
    free = turns.free.copy()
    free[list(which)] = False
    return dataclasses.replace(turns, free=free)


def _left(place: Place) -> float:
    return place.left


def _looked_around(place: Place) -> Place:
    """Once to either side along every coordinate, from the best so far, and on that way while it
    helps."""
    turns = place.turns
    for index, by in place.steps.items():
        dips = place.dips(index)
        if dips is None:
            continue
        best, sides = place.read, (-by, by)
        there = side_by_side(functools.partial(_beside, turns, best, index, dips), sides)
        totals = [turns.total(read) for read in there]
        if not min(totals) < turns.total(best):
            near = by if _dips(turns, best, index, by) == 1 else by / 2
            known = (*place.known.get(index, ()), dips)
            place = place._replace(
                found=(*place.found, *there),
                steps=place.steps | {index: near},
                known=place.known | {index: known},
            )
            continue
        side = int(np.argmin(totals))
        found, best = [*place.found, *there], there[side]
        for _ in range(ON):
            further = _beside(turns, best, index, dips, sides[side])
            found.append(further)
            if not turns.total(further) < turns.total(best):
                break
            best = further
        place = place._replace(read=best, found=tuple(found), known={})
    return place


def _dips(turns: Turns, read: Read, index: int, by: float) -> int:
    """How many dips of density such a step (``by``) leads across, at least one; 0 of a coordinate
    that density does not go along with."""
    if index not in (DENSITY, RADIUS) or not turns.free[DENSITY]:
        return 0
    density = float(read.point.coordinates[DENSITY])
    if index == RADIUS:
        by *= (1 - density) * turns.model.samples / density
    return max(1, round(abs(by)))


def _first_sight(turns: Turns, read: Read) -> Read:
    """From now on its shadows are compared with what was open at first sight."""
    thought = shrink(np.asarray(turns.picture.mask), read.mask.shape[:2])
    return read._replace(thought=thought)


def _near(turns: Turns, read: Read) -> Read:
    """Solved at some noise first: where a copy's answer is a little off, rays must not pass for
    foreign."""
    for sigma in NEAR:
        read = turns.solved(read, sigma)
    return read._replace(before=read.point.coordinates)


def _beside(turns: Turns, read: Read, index: int, dips: int, by: float) -> Read:
    """What is found where one coordinate is moved, across so many ``dips`` of density if that goes
    along, its shadows and the rest first, and then itself: single taps and texels make the way
    there too rough to be gone down."""
    z, held = read.point.coordinates.copy(), [index]
    density = float(z[DENSITY])
    if index == DENSITY:
        z[DENSITY] *= 1 + np.sign(by) * dips / turns.model.samples
    elif index == RADIUS:
        # Of a larger disc that is seen from as far, and as brightly.
        if dips:
            z[DENSITY] *= 1 - np.sign(by) * dips / turns.model.samples
            by = max((1 - z[DENSITY]) / max(1 - density, 1e-6) - 1, LEAST - 1)
            held.append(DENSITY)
        z[RADIUS] *= 1 + by
        if turns.free[GAIN]:
            z[GAIN] /= 1 + by
        elif turns.free[0]:
            z[0] *= z[DENSITY] / density / (1 + by)
    elif index in (GAIN, KAPPA):
        z[index] *= 2**by
    else:
        z[index] += by / (density * read.mask.shape[1 if index == LIGHT_X else 0])
    there = _holding(turns, *held).turn(read.at(turns.inside(z)), turns.noise)
    if turns.total(there) > WORSE * turns.total(read):
        return there
    return turns.turn(there, turns.noise)

"""Where else an answer to a picture that comes with nothing may lie: where clear rays show a disc,
in the middle of glare, where an answer for a light pass of another size is, or where other frames
of a clip have it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np

from godfit.blind import glare
from godfit.blind.beside import BESIDE, NEAR, Place, holding, left, nearer, place_of
from godfit.blind.clear_rays import looks_alike, seen_clearly
from godfit.blind.edge import PARTS, hardened
from godfit.blind.turns import SOME, Read, Turns
from godfit.io.filters import shrink
from godfit.models.base import FAINTEST
from godfit.models.coordinates import DENSITY, GAIN, KAPPA, LIGHT_X, LIGHT_Y, RADIUS, VEIL
from godfit.runtime.parallel import parallel_map

# Share of how far is looked beside an answer at first: of all of it where clear rays have shown the
# disc, of the light where glare has.
CLOSE, NEARBY = 0.25, 0.5
# What a disc is found by, and what frames of a clip share.
DISC, SHARED = (DENSITY, LIGHT_X, LIGHT_Y, RADIUS), (KAPPA, DENSITY, GAIN)
# Times that a radius shrinks or grows, most, where the gain does not suit it.
TIMES_AS_LARGE = 3.0


def solved(turns: Turns, begin: Read) -> Place:
    """A beginning under the disc's edge as hard as it is drawn, unless that was held, with the
    shadows that suit it, which from now on are compared with what was open at first sight."""
    hard = hardened(turns, begin)
    read = _first_sight(turns, hard.turned(_near(hard, begin), SOME))
    # One that was solved already may be the better.
    return place_of(hard, min(read, begin, key=hard.total))


def cleared(
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


def likened(place: Place, like: np.ndarray) -> Place:
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


def glared(places: list[Place]) -> list[Place]:
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
        held = holding(place.turns, LIGHT_X, LIGHT_Y)
        read = held.solved(place.read.unshadowed().at(z), NEAR[0])
        return place._replace(read=held.turn(read, NEAR[0]))

    def suited(place: Place) -> Place:
        held = holding(place.turns, LIGHT_X, LIGHT_Y)
        found = held.turned(nearer(held, place.read), SOME)
        return place_of(place.turns, found, dict.fromkeys((LIGHT_X, LIGHT_Y), NEARBY))

    found = parallel_map(begun, itertools.product(places, circles))
    return parallel_map(suited, of_each_size(found))


def crossed(places: list[Place]) -> list[Place]:
    """The likeliest of each size of light pass with the disc of the likeliest of another: dips of
    one are not those of the other."""

    def begun(pair: tuple[Place, Place]) -> Place:
        own, other = (place.read.point.coordinates for place in pair)
        z = own.copy()
        z[list(DISC)] = other[list(DISC)]
        return _suited(pair[0].turns, pair[0].read, z)

    return parallel_map(begun, itertools.permutations(of_each_size(places), 2))


def of_each_size(places: list[Place]) -> list[Place]:
    """The likeliest of each size of light pass."""
    best: dict[tuple[int, ...], Place] = {}
    for place in sorted(places, key=left):
        best.setdefault(place.read.mask.shape, place)
    return list(best.values())


def _suited(
    turns: Turns, read: Read, coordinates: np.ndarray, which: tuple[int, ...] = DISC
) -> Place:
    """A disc found elsewise (p,), ``which`` is held until the rest suits it."""
    held = holding(turns, *which)
    there = _first_sight(turns, read).unshadowed().at(coordinates)
    found = turns.turned(nearer(held, there), SOME)
    return place_of(turns, found, dict.fromkeys(BESIDE, CLOSE))


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

"""How bright a disc is of which little is seen.

Of one that an object or glare hides but for a crescent, many gains explain nearly as much, each
with a crescent of its own that is as wide as it is bright; and many densities, each with a disc
that is seen from as far and as brightly. Among them the right one explains much more: a narrow well
in a rough plateau, which nothing leads down to. They are walked along, each time from where the
last step led.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

from godfit.blind.beside import holding, nearer
from godfit.blind.turns import SOME, Read, Turns
from godfit.models.coordinates import DENSITY, GAIN, LIGHT_X, LIGHT_Y, RADIUS
from godfit.runtime.parallel import parallel_map

# Steps, in powers of two, and how many of them to either side, most: wide ones may cross a plateau,
# narrow ones find the bottom of a well. So many dips of density.
WIDE, NARROW, DIPS = (0.25, 14), (0.08, 8), 9
# How many times the least a step may leave for another to follow; steps that change what is left by
# next to nothing, after which none does: nothing of the disc is seen.
WORSE, SAME, NOTHING = 1.25, 3, 1.0
# What a well leaves of the rest, most: by less, a solve that ended elsewhere is as likely.
WELL = 0.95


def along_gain(turns: Turns, read: Read, step: float, most: int) -> tuple[Read, list[Read]]:
    """The bottom of a well, or ``read`` where there is none, and all that is found along the gain
    by steps of that size, in powers of two, at ``most`` so many to either side; everything else as
    it suits the gain."""
    if not turns.free[GAIN]:
        return read, []
    sides = [functools.partial(_brighter, turns, times=2**by) for by in (-step, step)]
    return _along(turns, read, sides, most)


def along_density(turns: Turns, read: Read, worse: float = WORSE) -> tuple[Read, list[Read]]:
    """The same by dips of density, of discs that are seen from as far, for as long as a step leaves
    no more than so many times the least."""
    if not turns.free[[DENSITY, RADIUS, GAIN]].all():
        return read, []
    sides = [functools.partial(_denser, turns, dips=by) for by in (-1, 1)]
    return _along(turns, read, sides, DIPS, worse)


def _along(
    turns: Turns,
    read: Read,
    sides: list[Callable[[Read], Read]],
    most: int,
    worse: float = WORSE,
) -> tuple[Read, list[Read]]:
    least = turns.total(read)

    def to_one_side(stepped: Callable[[Read], Read]) -> list[Read]:
        found, best, before, same = [read], least, least, 0
        while len(found) <= most and before <= worse * best and same < SAME:
            found.append(stepped(found[-1]))
            left = turns.total(found[-1])
            same = same + 1 if abs(left - before) < NOTHING else 0
            best, before = min(best, left), left
        return found[1:]

    found = [each for side in parallel_map(to_one_side, sides) for each in side]
    best = min(found, key=turns.total)
    if not turns.total(best) < WELL * least:
        return read, found
    return turns.turned(best, SOME), found


def _brighter(turns: Turns, read: Read, times: float) -> Read:
    """The best that is found with a gain so many ``times`` as large, held."""
    held, still = holding(turns, GAIN), holding(turns, GAIN, RADIUS)
    z = read.point.coordinates.copy()
    z[GAIN] *= times
    there = read.at(turns.inside(z))
    z[RADIUS] = _radius(read, times)
    smaller = read.at(turns.inside(z))
    # What shadows hid may be open under another disc, and single texels hold the radius.
    ways = (there, there.unshadowed(), smaller, still.turn(smaller.unshadowed(), turns.noise))
    return min((held.turn(way, turns.noise) for way in ways), key=turns.total)


def _denser(turns: Turns, read: Read, dips: int) -> Read:
    """The best that is found so many ``dips`` of density away, held, of a disc that is seen from as
    far and adds as much."""
    z = read.point.coordinates.copy()
    z[DENSITY] = min(z[DENSITY] * (1 + dips / turns.model.samples), 1.0)
    times = (1 - z[DENSITY]) / max(1 - read.point.coordinates[DENSITY], 1 / turns.model.samples)
    if not times > 0:
        return read
    z[RADIUS] *= times
    z[GAIN] /= times**2
    there = read.at(turns.inside(z))
    ways = (holding(turns, DENSITY), holding(turns, DENSITY, RADIUS))
    return min((held.turned(nearer(held, there), SOME) for held in ways), key=turns.total)


def _radius(read: Read, times: float) -> float:
    """In picture heights, of a disc about the same light of which so much less is open."""
    z, (h, w) = read.point.coordinates, read.mask.shape[:2]
    rows, columns = np.indices((h, w)) + 0.5
    away = np.hypot((columns / w - z[LIGHT_X]) * w / h, 1 - rows / h - z[LIGHT_Y]).ravel()
    order = np.argsort(away)
    away, area = away[order], np.cumsum(read.mask.ravel()[order])
    seen = area[max(np.searchsorted(away, z[RADIUS]) - 1, 0)] / times
    return float(away[np.searchsorted(area, min(seen, area[-1]))])

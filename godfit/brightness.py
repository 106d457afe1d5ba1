"""How bright a disc is of which little is seen.

Of one that an object or glare hides but for a crescent, many gains explain nearly as much, each
with a crescent of its own that is as wide as it is bright, and among them the right one much more:
a narrow well in a rough plateau, which nothing leads down to. The gain is walked along, each time
from where the last step led.
"""

from __future__ import annotations

import numpy as np

from godfit.beside import holding
from godfit.disc import GAIN, LIGHT_X, LIGHT_Y, RADIUS
from godfit.side_by_side import side_by_side
from godfit.turns import SOME, Read, Turns

# Steps, in powers of two, and how many of them to either side, most: wide ones may cross a plateau,
# narrow ones find the bottom of a well.
WIDE, NARROW = (0.25, 14), (0.08, 8)
# How many times the least a step may leave for another to follow; steps that change what is left by
# next to nothing, after which none does: nothing of the disc is seen.
WORSE, SAME, NOTHING = 1.25, 3, 1.0
# What a well leaves of the rest, most: by less, shadows that happen to suit it are as likely.
WELL = 0.8


def along_gain(turns: Turns, read: Read, step: float, most: int) -> tuple[Read, list[Read]]:
    """The bottom of a well, or ``read`` where there is none, and all that is found along the gain
    by steps of that size, in powers of two, at ``most`` so many to either side; everything else as
    it suits the gain."""
    if not turns.free[GAIN]:
        return read, []
    least = turns.total(read)

    def to_one_side(by: float) -> list[Read]:
        found, best, before, same = [read], least, least, 0
        while len(found) <= most and before <= WORSE * best and same < SAME:
            found.append(_stepped(turns, found[-1], 2**by))
            left = turns.total(found[-1])
            same = same + 1 if abs(left - before) < NOTHING else 0
            best, before = min(best, left), left
        return found[1:]

    found = [each for side in side_by_side(to_one_side, (-step, step)) for each in side]
    best = min(found, key=turns.total)
    if not turns.total(best) < WELL * least:
        return read, found
    return turns.turned(best, SOME), found


def _stepped(turns: Turns, read: Read, times: float) -> Read:
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


def _radius(read: Read, times: float) -> float:
    """In picture heights, of a disc about the same light of which so much less is open."""
    z, (h, w) = read.point.coordinates, read.mask.shape[:2]
    rows, columns = np.indices((h, w)) + 0.5
    away = np.hypot((columns / w - z[LIGHT_X]) * w / h, 1 - rows / h - z[LIGHT_Y]).ravel()
    order = np.argsort(away)
    away, area = away[order], np.cumsum(read.mask.ravel()[order])
    seen = area[max(np.searchsorted(away, z[RADIUS]) - 1, 0)] / times
    return float(away[np.searchsorted(area, min(seen, area[-1]))])

"""What lies beside an answer to a picture that comes with nothing: lights, radii and densities.

The cost has many dips, a texel or a tap apart, and single taps and texels make the way from one to
the next too rough to be gone down: neighbours are tried, each with the shadows that suit it.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from godfit.blind.turns import Read, Turns
from godfit.inference.evaluate import predicted
from godfit.models.coordinates import DENSITY, GAIN, KAPPA, LIGHT_X, LIGHT_Y, RADIUS
from godfit.runtime.parallel import parallel_map

# How far beside an answer it is looked for at first: shares of the radius, periods of the light,
# dips of density and powers of two of what the disc adds and of the attenuation; half as far where
# that finds nothing, but no nearer than the next dip, and from there so many dips ``FARTHER``.
# Those of the light lie where the last tap comes to the next texel.
BESIDE = {RADIUS: 0.2, LIGHT_X: 1.0, LIGHT_Y: 1.0, DENSITY: 8.0, GAIN: 1.0, KAPPA: 1.0}
FARTHER = 4
# Share of a radius that one step leaves of it, least.
LEAST = 0.3
# Steps on along one way, most.
ON = 4
# Share of what is seen that is off by no more than so many halves of a level where rounding alone
# is left: of the light pass, and of a background that varies as well (quantiles of one and of the
# sum of two uniform errors, and a little). The rest is where an object's edge is not known, and
# costs no more than so many times what one rounding does.
MOST, ONCE, TWICE, REST = 0.9, 1.0, 1.4, 2.5
# Noise in levels that what is not solved yet may be off by, less and less.
NEAR = (4.0, 2.0, 1.0)
# What leaves so much more before the rest has moved is tried once more with noise allowed for, and
# then given up.
WORSE = 1.25


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


def place_of(turns: Turns, read: Read, close: Mapping[int, float] | None = None) -> Place:
    """Looked around nearer by, by these shares, along coordinates that are ``close``."""
    close = close or {}
    steps = {i: by * close.get(i, 1.0) for i, by in BESIDE.items() if turns.free[i]}
    return Place(turns, read, (read,), steps, {})


def left(place: Place) -> float:
    return place.left


def holding(turns: Turns, *which: int) -> Turns:
    """With these coordinates as they are."""
    free = turns.free.copy()
    free[list(which)] = False
    return dataclasses.replace(turns, free=free)


def nearer(turns: Turns, read: Read) -> Read:
    """What is not solved yet, turn by turn, with less and less noise allowed for."""
    read = turns.solved(read, NEAR[0])
    for sigma in NEAR[1:]:
        read = turns.turn(read, sigma)
    return read


def looked_around(place: Place) -> Place:
    """Once to either side along every coordinate, from the best so far, and on that way while it
    helps."""
    turns = place.turns
    for index, by in place.steps.items():
        dips = place.dips(index)
        if dips is None:
            continue
        best, sides = place.read, (-by, by)
        there = parallel_map(functools.partial(_beside, turns, best, index, dips), sides)
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


def _beside(turns: Turns, read: Read, index: int, dips: int, by: float) -> Read:
    """What is found where one coordinate is moved, across so many ``dips`` of density if that goes
    along, its shadows and the rest first, and then itself: single taps and texels make the way
    there too rough to be gone down."""
    z, which = read.point.coordinates.copy(), [index]
    density = float(z[DENSITY])
    if index == DENSITY:
        z[DENSITY] *= 1 + np.sign(by) * dips / turns.model.samples
    elif index == RADIUS:
        # Of a larger disc that is seen from as far, and as brightly.
        if dips:
            z[DENSITY] *= 1 - np.sign(by) * dips / turns.model.samples
            by = max((1 - z[DENSITY]) / max(1 - density, 1e-6) - 1, LEAST - 1)
            which.append(DENSITY)
        z[RADIUS] *= 1 + by
        if turns.free[GAIN]:
            z[GAIN] /= 1 + by
        elif turns.free[0]:
            z[0] *= z[DENSITY] / density / (1 + by)
    elif index in (GAIN, KAPPA):
        z[index] *= 2**by
    else:
        z[index] += by / (density * read.mask.shape[1 if index == LIGHT_X else 0])
    held, there = holding(turns, *which), read.at(turns.inside(z))
    most = WORSE * turns.total(read)
    found = held.turn(there, turns.noise)
    if turns.total(found) > most:
        # What is off by much may have passed for foreign, or for a shadow.
        found = held.turn(held.solved(there, NEAR[0]), turns.noise)
    return found if turns.total(found) > most else turns.turn(found, turns.noise)

"""The edge of the disc: as hard as it is drawn without anti-aliasing, or soft where that explains
more."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from godfit.blind.turns import SOME, Read, Turns
from godfit.inference.distinct import DOUBT
from godfit.models.bare_picture import DERIVATIVE_EDGE
from godfit.models.coordinates import EDGE
from godfit.runtime.parallel import parallel_map

# Widths of the disc's edge in texels: of one that is drawn without anti-aliasing, whose rim is left
# to the shadows, and from where a soft one's is looked for.
HARD, WIDE = 0.02, 1.0
# Where softness is asked for at once: widths it is tried from, and what one solve leaves of what a
# hard edge does, most.
WIDTHS, LIKELY = (WIDE, 4.0), 0.9
# Parts a side into which texels of a light pass are cut that is smaller than the picture.
PARTS = 2


def hardened(turns: Turns, read: Read, parts: int | None = None) -> Turns:
    """With the disc's edge, where it is free, held as a mask (h, w) of the size of ``read``'s has
    it without anti-aliasing, its texels cut into so many ``parts`` a side: of a light pass smaller
    than the picture, unless that is given, as one that is scaled down."""
    if not turns.free[EDGE]:
        return turns
    rows = read.mask.shape[0]
    if parts is None:
        parts = 1 if rows == turns.picture.size[0] else PARTS
    cut = dataclasses.replace(turns, model=turns.model.cut_into(parts))
    return with_edge(cut, HARD / (rows * parts))


def with_edge(turns: Turns, width: float | None) -> Turns:
    """With the disc's edge held at a ``width`` in picture heights, or free."""
    free, held = turns.free.copy(), turns.held.copy()
    free[EDGE], held[EDGE] = width is None, np.nan if width is None else width
    return dataclasses.replace(turns, free=free, held=held)


def softer_at_once(turns: Turns, read: Read) -> tuple[Turns, Read]:
    """As ``softened``, under the shadows that suit a hard edge: with a soft one where that explains
    clearly more at once. Of a large picture turns of shadows are dear."""
    softer = with_edge(turns, None)
    wide = parallel_map(functools.partial(_from_width, softer, read), WIDTHS)
    best = min(wide, key=softer.total)
    if not softer.total(best) < LIKELY * turns.total(read):
        return turns, read
    return softer, softer.descended(best, softer.noise)


def _from_width(softer: Turns, read: Read, width: float) -> Read:
    """One solve from where the edge, free, is so many texels wide."""
    z = read.point.coordinates.copy()
    z[EDGE] = width / read.mask.shape[0]
    return softer.solved(read.at(z), softer.noise)


def softened(turns: Turns, read: Read) -> tuple[Turns, Read]:
    """With a soft edge of the disc where that explains more than a hard one; with a hard one from
    where a soft one led, past kinks of its own, where that does."""
    softer = with_edge(turns, None)
    begin = _from_width(softer, read, WIDE)
    both = [(softer, begin), (turns, read)]
    soft, hard = parallel_map(lambda each: each[0].turn(each[1], turns.noise), both)
    hard = min(read, hard, key=turns.total)
    if not softer.total(soft) < turns.total(hard) - DOUBT:
        return turns, hard
    ways = [(turns, turns.solved(soft, turns.noise))]
    if soft.point.coordinates[EDGE] > DERIVATIVE_EDGE / read.mask.shape[0]:
        ways.append((softer, soft))
    again, *wide = parallel_map(lambda way: way[0].turned(way[1], SOME), ways)
    hard = min(hard, again, key=turns.total)
    if wide and softer.total(wide[0]) < turns.total(hard) - DOUBT:
        return softer, wide[0]
    return turns, hard

"""The best answer to a picture that comes with nothing, of beginnings and what lies around them."""

from __future__ import annotations

import functools
import itertools

import numpy as np

from godfit.blind.beside import Place, left, looked_around
from godfit.blind.brightness import NARROW, WIDE, WORSE, along_density, along_gain
from godfit.blind.clear_rays import looks_alike
from godfit.blind.elsewhere import cleared, crossed, glared, likened, of_each_size, solved
from godfit.blind.explained import TEXTURE
from godfit.blind.turns import Read, Turns
from godfit.runtime.parallel import parallel_map

# Answers that are looked around, most, each time.
LEFT = 2, 1, 1
# Times that is done, most, and the share of what was left that is worth another after these.
EARLY, TIMES, HEADWAY = 1, 9, 0.03
# How much more may be left by what is as likely.
ALIKE = 1.05
# What leaves so many times the least is not looked around, nor what clear rays show from there, nor
# are gain and density walked along.
FAR_WORSE, CLEARED, AS_LIKELY = 2.0, 1.5, 1.25
# Times the least that a step may leave on the way down, which is rough.
DOWNHILL = 1.03


def best_around(
    turns: Turns, begun: list[list[Read]], around: bool, like: np.ndarray | None = None
) -> tuple[Turns, Read, list[np.ndarray]]:
    """The best of these beginnings, each of which may be of light passes of several sizes, and of
    what lies ``around`` them if that is wanted, and changes (p,) that it may be off by: a mask that
    explains more takes the light with it from where it was before, and what lies elsewhere may
    explain as much. By the turns that suit its size; see ``solved``. Other frames of its clip have
    scattering ``like`` that (4,), NaN where none tells."""
    sizes = parallel_map(functools.partial(solved, turns), itertools.chain(*begun))
    places = sizes
    if like is not None:
        places = [*sizes, *parallel_map(functools.partial(likened, like=like), sizes)]
    if around:
        places = _around(turns, begun, sizes, places[len(sizes) :])
        places += [_walked(place) for place in _likely(of_each_size(places), AS_LIKELY)]
    found = itertools.chain.from_iterable(place.found for place in places)
    turns, read, *_ = min(places, key=left)
    limit, z = ALIKE * turns.total(read), read.point.coordinates
    alike = [r.point.coordinates - z for r in found if turns.total(r) < limit]
    doubts = _spread(np.array(alike) * turns.free, turns.model.scales(z))
    return turns, read, doubts if read.before is None else [z - read.before, *doubts]


def _around(
    turns: Turns, begun: list[list[Read]], sizes: list[Place], others: list[Place]
) -> list[Place]:
    """What lies around beginnings, solved in all their ``sizes``, and around what is as ``others``,
    the frames of a clip, have it."""

    def afresh(place: Place) -> Place:
        # A mask that has settled holds the light where it is.
        again = place.turns.turn(place.read.unshadowed(), place.turns.noise)
        best = min(place.read, again, key=place.turns.total)
        return place._replace(read=best, found=(*place.found, again))

    each = iter(sizes)
    likely = [min((next(each) for _ in reads), key=left) for reads in begun]
    places = [*parallel_map(afresh, likely), *others]
    told = others and min(places, key=left).explained
    # Texture hides how a disc was drawn.
    if told or turns.texture >= TEXTURE:
        return _climbed(places, EARLY)
    limit = CLEARED * min(place.left for place in sizes)
    near = zip(itertools.chain(*begun), sizes, strict=True)
    asked = [read for read, place in near if place.left < limit]
    shown = cleared(turns, asked)
    places += shown
    if not min(places, key=left).explained:
        places += glared(sizes)
        places += crossed(places)
    places = _climbed(places, EARLY)
    best = min(places, key=left)
    if best.explained:
        return places
    # What is nearly right knows better what is clear.
    asked += [place.read for place in shown]
    places += cleared(best.turns, [best.read], asked, True)
    return _climbed(places, TIMES)


def _walked(place: Place) -> Place:
    """The best of what lies along the gain and along density: what is explained, downhill only."""

    def best(place: Place, walked: tuple[Read, list[Read]]) -> Place:
        read, found = walked
        return place._replace(read=read, found=(*place.found, read, *found))

    for step in (WIDE, NARROW):
        place = best(place, along_gain(place.turns, place.read, *step))
    worse = DOWNHILL if place.explained else WORSE
    return best(place, along_density(place.turns, place.read, worse))


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
        places = _likely(places, FAR_WORSE)
        places = [*map(looked_around, places[:most]), *places[most:]]
    return places


def _likely(places: list[Place], times: float) -> list[Place]:
    """These, likeliest first, without those that leave so many ``times`` the least."""
    return [place for place in places if place.left < times * places[0].left]


def _apart(places: list[Place]) -> list[Place]:
    """The likeliest first, without those that look like a likelier one."""
    kept: list[Place] = []
    for place in sorted(places, key=left):
        if not any(looks_alike(place.read, other.read) for other in kept):
            kept.append(place)
    return kept


def _spread(changes: np.ndarray, scale: np.ndarray) -> list[np.ndarray]:
    """As far as these ``changes`` (n, p) go along each of their principal directions."""
    _, _, directions = np.linalg.svd(changes / scale, full_matrices=False)
    far = np.abs(changes / scale @ directions.T).max(0, initial=0)
    return [by * direction * scale for by, direction in zip(far, directions, strict=True) if by > 0]

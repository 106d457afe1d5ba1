"""The fit of a picture that comes with nothing: search, choice, exact numbers, verdict.

The order is that of ``docs/bare-pictures.md``. What the picture does not determine gets no number,
and an answer that other pixels do not confirm is not converged.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from godfit.blind import hypotheses
from godfit.blind.certainty import RAYS_COST, SAME_PLACE, SURE_COST, Certainty, certainty
from godfit.blind.choice import SAME_LIGHT, distance, ordered
from godfit.blind.exact import (
    Exact,
    Given,
    Posed,
    beyond_disc,
    sector_covariance,
    solved_exactly,
)
from godfit.blind.hypotheses import Hypothesis, ground_colour
from godfit.blind.panels import panels
from godfit.blind.reduced import Reduced, additive, clipped_pixels, reduced
from godfit.blind.search import Candidate, searched
from godfit.errors import InputError, Remark
from godfit.inference.fitted import Found
from godfit.inference.information import evidence
from godfit.inference.observation import Picture
from godfit.io.filters import shrink
from godfit.io.image import LEVELS, Image
from godfit.models.build import mitchell_template
from godfit.models.coordinates import (
    DENSITY,
    EDGE,
    EXPOSURE,
    GAIN,
    KAPPA,
    LIGHT_X,
    LIGHT_Y,
    RADIUS,
    VEIL,
)
from godfit.models.mitchell import Mitchell
from godfit.runtime.blas import one_thread
from godfit.runtime.interrupts import kept_for_later, requested
from godfit.runtime.parallel import parallel_map

LEAST_PIXELS = 500
"""Pixels without which nothing can be estimated."""
LEAST_SIZE = 32
"""Least width and height of a picture: rays are a few pixels wide there."""
FOREIGN = 0.02
"""Share of pixels that may have any level: what no hypothesis explains."""
MOST_PLACE_ERROR = 0.01
"""Largest standard error of a light that counts as found, as a share of the picture."""
MOST_DENSITY_ERROR = 0.1
"""Largest standard error of a density that is quoted: more is no number."""
MOST_KAPPA_ERROR = 0.3
"""The same of the attenuation, as a share of it."""
EXPLAINED_NOISE = 4.0
"""Noise in levels up to which single pixels are explained: more is structure."""
ROUNDING_NOISE = 0.5
"""Noise in levels up to which single pixels are explained as well as rounding allows."""
SAME_AS_SEARCH = 0.01
"""Distance of the exact light from that of the search, up to which the two agree."""
SHARED_ERROR = (1.0, 1.0, 0.25, 0.25)
"""Share of the distance between the exact answer and the search's that counts as an error: of light
u and v, attenuation and density. The copy has no own pixel and nearest texels, which bias the last
two: on real frames they are four times as far off there."""
CLIPPED_SHARE = 0.5
"""Share of a disc's pixels that must not be clipped for its gain to have a number."""
RIVAL_COST = 0.5
"""Share of the best hypothesis's explanation from which another one explains as well."""
NEXT = (
    "; give a second screenshot with the effect off (--background off.png), or --light-near U,V, "
    "--occluder, --mask"
)
NO_RAYS = "no rays were found: a light explains too little of this picture ({:.3f} per pair)"
UNSURE = "the light explains too little of this picture to be sure of it ({:.3f} per pair)"
DISAGREE = "searches on independent pixels disagree on the light by {:.1f}% of the picture"
RIVALS = "two masks explain the picture, with lights {:.1f}% of it apart"
LOOSE = "the light is known to {:.1f}% of the picture only"
AT_END = "a number of the search lies at the end of its range"
MOVED = "the exact light is {:.1f}% of the picture from that of the search"
STRUCTURE = "the residual is structure of {:.1f} levels, which the light does not explain"
SEVERAL = "one light of {} is estimated without a mask"
STOPPED = "interrupted: the best answer so far"
HYPOTHESIS = {
    "bright": "the mask is what is bright in the picture, within a radius of the light",
    "sky": "the mask is all that is bright in the picture, the brighter the more",
    "colour": "the mask is a disc on a veil, open where the picture has its ground's colour",
    "darkness": "the mask is a disc on a veil, open where the picture is not dark",
}
CANONICAL = "under any shader, whose --shader only names them: "
BOX = "{}: numbers of this shader are not estimated without a mask; the light alone is"
PANEL = "a panel at {},{},{},{} is taken to lie on top and is left out"


class Settings(NamedTuple):
    """What a fit of a bare picture is given beside the picture: ``valid`` and ``occluder`` (h, w),
    where to look and where something occludes the light; ``bright_pass`` to try that hypothesis
    alone; how many ``lights`` there are, of which one is estimated, and the light pass's size,
    ``pass_scale``; values that are held (``fix``) and started from; a place ``near`` the light."""

    valid: np.ndarray | None = None
    occluder: np.ndarray | None = None
    bright_pass: bool = False
    lights: int = 1
    pass_scale: float | None = None
    fix: Mapping[str, float | None] = {}
    start: Mapping[str, float] = {}
    near: tuple[float, float] | None = None
    seed: int = 0

    @property
    def place(self) -> tuple[float, float] | None:
        """Where the light is known to be, from ``near``, ``fix`` and ``start``."""
        if self.near is not None:
            return self.near
        known = {**self.start, **{k: v for k, v in self.fix.items() if v is not None}}
        if {"light_x", "light_y"} <= known.keys():
            return known["light_x"], known["light_y"]
        return None


@one_thread()
def found_in(
    target: Image, shading: Mitchell, settings: Settings, say: Callable[[str], None]
) -> tuple[Found, tuple[str, ...]]:
    """What was found, and notes. Raises InputError for pictures without enough pixels.

    In a command the first interrupt ends the search with the best answer so far.
    """
    _check(target, settings.valid)
    notes: tuple[str, ...] = ()
    box = bool(shading.convention.box)
    if box:
        notes += (BOX.format(shading.shader),)
        shading = mitchell_template("mitchell", None, 1)
    say("background, objects, panels")
    picture, lying = _picture(target, settings.valid, shading)
    notes += tuple(PANEL.format(*place) for place in lying)
    copy = reduced(picture.levels, picture.valid, shading.convention)
    occluded = np.zeros(copy.valid.shape, bool)
    if settings.occluder is not None:
        size = copy.valid.shape[0], copy.valid.shape[1]
        occluded = shrink(settings.occluder.astype(np.float32), size) > 0.5
    with kept_for_later():
        candidates = ordered(_searched(_tried(copy, occluded, settings), settings, say))
        best = candidates[0]
        say("other pixels, sector by sector")
        sure = certainty(best, settings.place, settings.seed)
        say("exact numbers")
        given = Given(settings.fix, settings.start, settings.pass_scale)
        posed = Posed(copy, picture, shading, given, not box)
        exact = solved_exactly(best, posed, settings.seed, requested)
        if exact.exact and exact.settled.sigma < ROUNDING_NOISE:
            # Every pixel is explained: what other hypotheses make of differences is no doubt.
            candidates = [best]
        doubts = [*_doubts(candidates, sure), *_exact_doubts(exact, best)]
        if settings.lights > 1:
            doubts.append(SEVERAL.format(settings.lights))
        if requested():
            doubts.insert(0, STOPPED)
    found = _concluded(exact, candidates, sure, doubts, box).replaced(
        pass_scale=settings.pass_scale
    )
    return found, (*notes, HYPOTHESIS[best.hypothesis.name], *_canonical(found))


def _check(target: Image, valid: np.ndarray | None) -> None:
    """Raise InputError for a picture that is too small, or ignored."""
    h, w = target.values.shape[:2]
    if min(h, w) < LEAST_SIZE:
        raise InputError(
            f"target: expected at least {LEAST_SIZE}x{LEAST_SIZE} pixels without a mask, "
            f"got {w}x{h}"
        )
    if valid is not None and np.count_nonzero(valid) < LEAST_PIXELS:
        raise InputError(
            f"ignore: expected some open background, at least {LEAST_PIXELS} pixels, got "
            f"{np.count_nonzero(valid)}; ignore less"
        )


def _picture(
    target: Image, valid: np.ndarray | None, shading: Mitchell
) -> tuple[Picture, list[tuple[int, int, int, int]]]:
    """The picture without the panels that lie on it, and these, as (x, y, width, height)."""
    size = target.values.shape[:2]
    picture = Picture.make(target, np.ones(size, np.float32), None, valid)
    picture = dataclasses.replace(picture, foreign=FOREIGN)
    if shading.convention.blend == "screen":
        # A screen blend happens in linear light, and the canvas is encoded after it.
        picture = dataclasses.replace(picture, transfer="srgb")
    lying = _panels(picture, shading)
    kept = picture.valid.copy()
    for x, y, wide, tall in lying:
        kept[max(y - 2, 0) : y + tall + 2, max(x - 2, 0) : x + wide + 2] = False
    return dataclasses.replace(picture, valid=kept), lying


def _panels(picture: Picture, shading: Mitchell) -> list[tuple[int, int, int, int]]:
    values = additive(picture.levels / np.float32(LEVELS), shading.convention)
    values = np.broadcast_to(values, (*values.shape[:2], 3))
    clipped = clipped_pixels(picture.levels)
    other = ~ground_colour(values, picture.valid, clipped) & picture.valid
    return panels(other, picture.levels)


def _tried(copy: Reduced, occluded: np.ndarray, settings: Settings) -> list[Hypothesis]:
    others = [hypotheses.colour, hypotheses.darkness]
    skies = [hypotheses.sky, hypotheses.coarse_sky]
    makers = [hypotheses.bright, *(skies if settings.bright_pass else others)]
    made = [maker(copy, occluded) for maker in makers]
    kept = [h for h in made if h is not None and np.count_nonzero(h.usable) >= LEAST_PIXELS]
    if not kept:
        raise InputError(
            f"target: expected at least {LEAST_PIXELS} pixels of the copy that are not clipped, "
            f"got {np.count_nonzero(copy.usable)}; give --mask"
        )
    return kept


def _searched(
    tried: list[Hypothesis], settings: Settings, say: Callable[[str], None]
) -> list[Candidate]:
    """The best light under each hypothesis, a core each; the best so far after an interrupt."""
    say("lights under each hypothesis: " + ", ".join(h.name for h in tried))
    return parallel_map(lambda h: searched(h, settings.place, settings.seed), tried)


def _doubts(candidates: list[Candidate], sure: Certainty) -> list[str]:
    """Why the search's answer is not sure, the gravest first."""
    best, cost = candidates[0], candidates[0].cost
    if cost > RAYS_COST:
        return [NO_RAYS.format(cost)]
    doubts = []
    if cost > SURE_COST:
        doubts.append(UNSURE.format(cost))
    if sure.apart > SAME_PLACE:
        doubts.append(DISAGREE.format(100 * sure.apart))
    for other in _rivals(candidates):
        apart = distance(best.place, other.place)
        if apart > SAME_LIGHT:
            doubts.append(RIVALS.format(100 * apart))
    if sure.at_end:
        doubts.append(AT_END)
    return doubts


def _rivals(candidates: list[Candidate]) -> list[Candidate]:
    """Hypotheses beside the chosen one that explain the picture as well."""
    return [c for c in candidates[1:] if c.cost < RIVAL_COST * candidates[0].cost]


def _exact_doubts(exact: Exact, best: Candidate) -> list[str]:
    if not exact.exact:
        return []
    place = exact.settled.coordinates[LIGHT_X : LIGHT_Y + 1]
    apart = distance((float(place[0]), float(place[1])), best.place)
    doubts = []
    if apart > SAME_AS_SEARCH:
        doubts.append(MOVED.format(100 * apart))
    if exact.settled.sigma > EXPLAINED_NOISE:
        doubts.append(STRUCTURE.format(exact.settled.sigma))
    return doubts


def _concluded(
    exact: Exact, candidates: list[Candidate], sure: Certainty, doubts: list[str], box: bool
) -> Found:
    """The answer with its errors, and without a number for what is not determined."""
    problem, settled = exact.problem, exact.settled
    z, free, held = settled.coordinates, problem.free.copy(), problem.held.copy()
    best = candidates[0]
    known = [LIGHT_X, LIGHT_Y, KAPPA, DENSITY]
    # What the search on the copy says holds where single pixels say nothing, or promise more.
    scatter = np.zeros((len(z), len(z)))
    scatter[np.ix_(known, known)] = sure.covariance
    for other in _rivals(candidates):
        scatter[known[:2], known[:2]] += np.subtract(other.place, best.place) ** 2
    at = evidence(settled, exact.tangent, exact.seen).within(problem.model.ranges(z))
    if exact.exact:
        scatter = at.covariance(free) + sector_covariance(exact)
        # Two answers that do not share their assumptions: the error is at least their distance.
        found = np.array([*best.place, best.point[2], best.density])
        scatter[known, known] += (np.array(SHARED_ERROR) * (z[known] - found)) ** 2
        beyond = beyond_disc(exact)
        if beyond is not None:
            scatter[known, known] += (z[known] - beyond.settled.coordinates[known]) ** 2
            # A disc that is no circle trades with these two: they are as sure as without it.
            trading = np.ix_([KAPPA, DENSITY], [KAPPA, DENSITY])
            scatter[trading] += sector_covariance(beyond)[trading]
    scatter[~free] = scatter[:, ~free] = 0.0
    opened: list[tuple[int, list[int]]] = []
    if free[GAIN] and not np.isnan(held[EXPOSURE]):
        opened.append((EXPOSURE, [GAIN]))
    lost = _lost(exact, scatter, box)
    for index in lost:
        if free[index]:
            opened.append((index, []))
            free[index], held[index] = False, z[index]
            scatter[index] = scatter[:, index] = 0.0
    error = float(np.sqrt(np.diag(scatter)[known[:2]].max()))
    if error > MOST_PLACE_ERROR:
        doubts = [*doubts, LOOSE.format(100 * error)]
    objection = doubts[0] + NEXT if doubts else ""
    remarks = tuple(Remark(doubt, "unsure") for doubt in doubts[1:])
    return Found(
        problem.replaced(free=free, held=held), exact.seen, settled, at, tuple(opened), False,
        remarks, objection, (), None, None, scatter,
    )  # fmt: skip


def _lost(exact: Exact, scatter: np.ndarray, box: bool) -> list[int]:
    """Coordinates that the picture does not determine well enough to be told as numbers."""
    if box or not exact.exact or exact.settled.sigma > EXPLAINED_NOISE:
        return [KAPPA, DENSITY, GAIN, RADIUS, EDGE, VEIL]
    z, error = exact.settled.coordinates, np.sqrt(np.diag(scatter))
    # The gain of a disc that is clipped trades with its radius, in a valley that is no straight
    # line: its error says little.
    lost = [GAIN, RADIUS, EDGE, VEIL] if _clipped_disc(exact) else []
    if error[DENSITY] > MOST_DENSITY_ERROR:
        lost.append(DENSITY)
    if error[KAPPA] > MOST_KAPPA_ERROR * max(z[KAPPA], 1.0):
        lost.append(KAPPA)
    return lost


def _clipped_disc(exact: Exact) -> bool:
    """Whether most of the disc's pixels are clipped, behind objects, or off the picture."""
    picture, z = exact.problem.picture, exact.settled.coordinates
    h, w = picture.size
    row, column = np.mgrid[:h, :w]
    x, y = column + 0.5 - z[LIGHT_X] * w, row + 0.5 - (1 - z[LIGHT_Y]) * h
    inside = x * x + y * y < (z[RADIUS] * h) ** 2
    in_sight = picture.valid & ~picture.clipped
    open_ = np.count_nonzero(inside & in_sight)
    return bool(open_ < CLIPPED_SHARE * max(1.0, np.pi * (z[RADIUS] * h) ** 2))


def _canonical(found: Found) -> tuple[str, ...]:
    """What is determined in numbers that no shader names, as a note; none where nothing is."""
    z, free, spread = found.settled.coordinates, found.problem.free, found.scatter
    assert spread is not None
    parts = []
    if free[KAPPA] and free[DENSITY]:
        slope = np.array([z[DENSITY], z[KAPPA]])
        pair = [KAPPA, DENSITY]
        error = np.sqrt(slope @ spread[np.ix_(pair, pair)] @ slope)
        parts.append(f"attenuation along a ray {z[KAPPA] * z[DENSITY]:.3g} +- {error:.2g}")
    if free[DENSITY]:
        parts.append(f"density {z[DENSITY]:.3g} +- {np.sqrt(spread[DENSITY, DENSITY]):.2g}")
    if free[GAIN] and free[DENSITY]:
        error = z[DENSITY] * np.sqrt(spread[GAIN, GAIN])
        parts.append(f"gain {z[GAIN] * z[DENSITY]:.3g} +- {error:.2g}")
    return (CANONICAL + ", ".join(parts),) if parts else ()

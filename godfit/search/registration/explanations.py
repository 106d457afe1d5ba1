"""What may have happened between a mask and a target from different sources, and which of it did.

A pixel of the target at column x, from the left edge, shows what the mask has at column a x + b;
rows have a scale and a shift of their own. The first guesses are that both show the same frame,
and that the target is a crop of it.

A mask that was resized from the target's size is taken as it was before that, and a target that was
resized from the mask's size likewise: interpolated, edges would be grey. None of these has a number
to be fitted, so the right one leaves rounding alone. Otherwise the map is fitted, and the likeliest
is taken; a map that is a shift by whole pixels, to within its error, is taken as that.

The light is in the target's frame. Beyond the target's edge the mask's edge there is repeated,
which is exact for a light on the picture: its rays do not leave the frame.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import NamedTuple

import numpy as np

from godfit.errors import Remark
from godfit.inference.allowances.mask_rounding import edge_variance
from godfit.inference.observation import Picture
from godfit.inference.problem import SEARCH_PIXELS, Problem, pixels_used
from godfit.inference.settle import Settled, settle
from godfit.inference.strategy import Report
from godfit.io.image import LEVELS
from godfit.io.resampling import Resize
from godfit.scattering.upsample import is_larger
from godfit.search.density_minima import ROUNDING_ONLY, on_subset
from godfit.search.registration import resized_masks, resized_targets
from godfit.search.registration.map_fit import MapFit
from godfit.search.registration.maps import IDENTITY, Map

WHOLE = 0.05
"""Pixels within which a map is taken as a shift by whole pixels, where that explains no less."""
LIKELY = 2.0
"""Noise as a share of the least found, up to which another kind of explanation is worth a search: a
wrong density leaves so much of the right one."""
MADE = 1.0
"""Levels rms between a target and what a resize makes of the picture that explains it, at most:
both are rounded."""
WITHOUT_EDGES = 0.01
"""Noise in levels up to which a grey mask was restored: its edges then leave nothing."""
MOVED = (
    "the mask was registered: scale {:.6g} x {:.6g}, shift {:+.4g} pixels to the right and {:+.4g} "
    "down {} before)"
)
"""The note where the mask was moved."""
ANOTHER_SIZE = (
    "the target was resized from the mask's {}x{} pixels ({}), which are taken as the light pass's "
    "{} under a mask of the target's size)"
)
"""The note where the target was resized instead."""
RESIZED = "; a resize made the mask's edges grey, and errors allow for what they were"
"""Words after the note where more is left."""
LOST_LEVELS, LOST_SHARE = 1.0, 0.25
"""Noise in levels that is left under a resized mask, and its share of what was before, from which
the mask's edges are lost: rays of wrong edges are no noise, and no error allows for them."""
LOST = (
    "the registered mask leaves noise of {:.2g} levels, of {:.2g} before: a resize lost its edges; "
    "give the mask as the shader read it"
)


class Registered(NamedTuple):
    """The ``problem`` under the registered mask, a ``note`` on the map, and ``shifts``, the changes
    of the coordinates (p,) by an error of each direction of the map; the ``objection`` to a fit
    with it, "" where there is none."""

    problem: Problem
    note: Remark
    shifts: tuple[np.ndarray, ...]
    objection: str


class Explanation(NamedTuple):
    """A ``problem`` under one explanation of how mask and target belong together, and where it
    ``settled``: by the ``map`` of the mask, whose texels have a ``variance`` where that is known;
    or the target was resized from a light pass of the mask's size by a ``kernel``."""

    problem: Problem
    settled: Settled
    map: Map = IDENTITY
    variance: np.ndarray | None = None
    kernel: str = ""

    def settled_from(self, start: np.ndarray, count: int | None = None) -> Explanation:
        """The same, settled from ``start`` on ``count`` pixels, or on all."""
        problem = self.problem
        if count is None:
            observation = problem.picture.observe(pixels_used(problem.picture, problem.seed))
        else:
            observation = problem.observe(count)
        return self._replace(settled=settle(start, problem, observation)[0])

    def makes(self, target: Picture) -> bool:
        """Whether all of the ``target`` is what the resize makes of the fitted picture. What is
        known of that may be its flat parts alone, which anything explains."""
        picture = self.problem.picture
        if not self.kernel or picture.size == target.size:
            return True
        every = picture.observe(np.arange(picture.size[0] * picture.size[1]))
        levels = np.asarray(every.predict(self.problem.at(self.settled.coordinates)), np.float64)
        levels = np.round(levels.reshape(*picture.size, -1)).clip(0, LEVELS)
        made = Resize.of(picture.size, target.size, self.kernel).made(levels).clip(0, LEVELS)
        off = (made - target.levels)[target.valid]
        return bool(np.sqrt(np.square(off).mean()) <= MADE)

    def note(self, before: float) -> Remark:
        """The note on it, where the same frame at the target's size left noise ``before``."""
        noise = f"(noise of {self.settled.sigma:.2g} levels against {before:.2g}"
        if self.kernel:
            h, w = self.problem.picture.mask.shape[:2]
            words = ANOTHER_SIZE.format(w, h, self.kernel, noise)
        else:
            (down, right), (high, wide) = self.map.shift, self.map.scale
            words = MOVED.format(wide, high, right, down, noise)
        return Remark(words, "register")

    def likelier_from(self, start: np.ndarray) -> Explanation:
        """The same settled from another start as well, where that is likelier."""
        again = self.settled_from(start, SEARCH_PIXELS)
        better = again.settled.log_likelihood > self.settled.log_likelihood
        return again if better else self


def _least(explanations: list[Explanation]) -> Explanation:
    """That which leaves the least noise."""
    return min(explanations, key=lambda one: one.settled.sigma)


def registered(
    problem: Problem, mask: np.ndarray, given: dict[str, float], report: Report
) -> Registered:
    """The ``problem`` under ``mask`` (H, W, ...) moved and scaled to fit it best."""
    report("shift and scale of the mask")
    target, size = problem.picture, problem.picture.size
    sides = np.array(mask.shape[:2])
    frame = Map(sides / size, np.zeros(2))
    guesses = [frame]
    for down, right in itertools.product(*(sorted({0, n // 2, n}) for n in sides - size)):
        guesses.append(Map(np.ones(2), np.array([down, right], float)))
    maps = MapFit(problem, mask)
    begun = [maps.begin(guess, given) for guess in guesses]
    before = begun[0].sigma
    crops = sorted(zip(guesses[1:], begun[1:], strict=True), key=lambda pair: pair[1].sigma)
    masks = _masks_before_resize(maps, frame, begun[0])
    targets = _targets_before_resize(maps, begun[0])
    kinds = [[_cropped(maps, *pair) for pair in crops[:1]], masks, targets]
    sure = _without_noise(kinds, target, report)
    if sure is None:
        kinds = [
            _masks_before_resize(maps, frame, begun[0], once=True),
            _targets_before_resize(maps, begun[0], once=True),
        ]
        masks, targets = masks + kinds[0], targets + kinds[1]
        sure = _without_noise(kinds, target, report)
    if sure is not None:
        return _with_doubt(sure, before, ())
    # A crop may resemble a resize: the best crop and the same frame both go on.
    ends = [maps.solve(guess, z) for guess, z in [(frame, begun[0]), *crops[:1]]]
    moved, settled, shifts = max(ends, key=lambda end: end.settled.log_likelihood)
    best = Explanation(maps.posed(moved), settled, moved)
    whole = Map(np.ones(2), np.round(moved.shift))
    if np.abs(whole.corners(size) - moved.corners(size)).max() < WHOLE:
        masks = [*masks, _cropped(maps, whole, settled)]
    tried = [one.likelier_from(settled.coordinates) for one in masks]
    near = max(tried, key=lambda one: one.settled.log_likelihood, default=best)
    if near is not best and near.settled.log_likelihood >= settled.log_likelihood - 1:
        best, shifts = near, ()
    others = [one.likelier_from(settled.coordinates) for one in targets]
    there = _least([best, *(one for one in others if one.makes(target))])
    return _with_doubt(there, before, shifts if there is best else ())


def _cropped(maps: MapFit, whole: Map, start: Settled) -> Explanation:
    """The target as a crop of the mask's frame."""
    settled, _, problem = maps.under(whole.applied(maps.mask, maps.size), start.coordinates)
    return Explanation(problem, settled, whole)


def _masks_before_resize(
    maps: MapFit, frame: Map, start: Settled, once: bool = False
) -> list[Explanation]:
    """The mask as it was at the target's size, by each kernel of programs that rounded twice or
    ``once``."""
    found = []
    for before in resized_masks.before_resize(maps.mask, maps.size, once):
        settled, _, problem = maps.under(before.mask, start.coordinates)
        found.append(Explanation(problem, settled, frame, before.variance))
    return found


def _targets_before_resize(maps: MapFit, start: Settled, once: bool = False) -> list[Explanation]:
    """The target as it was at the mask's size, by each kernel of programs that rounded twice or
    ``once``. One that is not in bytes is interpolated from a light pass of that size instead."""
    if is_larger(maps.mask.shape[:2], maps.size):
        return []
    settled, _, problem = maps.under(maps.mask, start.coordinates)
    pictures = resized_targets.before_resize(problem.picture, maps.mask.shape[:2], once)
    found = []
    for kernel, picture in pictures.items():
        one = Explanation(problem.replaced(picture=picture), settled, kernel=kernel)
        found.append(one.settled_from(settled.coordinates, SEARCH_PIXELS))
    if not found and not once:
        found = [Explanation(problem, settled, kernel="bilinear")]
    return found


def _without_noise(
    kinds: list[list[Explanation]], target: Picture, report: Report
) -> Explanation | None:
    """The explanation that leaves rounding alone in all of the ``target``, at the right density;
    None where none does."""
    kinds = sorted(filter(None, kinds), key=lambda kind: _least(kind).settled.sigma)
    for kind in kinds:
        if _least(kind).settled.sigma > LIKELY * _least(kinds[0]).settled.sigma:
            break
        found = _searched(kind, report)
        if found.settled.sigma <= ROUNDING_ONLY and found.makes(target):
            return found
    return None


def _searched(kind: list[Explanation], report: Report) -> Explanation:
    """The best of the explanations of a kind at the best of its densities. A density that is found
    under one of them serves the others."""
    one = _least(kind)
    if one.settled.sigma > ROUNDING_ONLY and one.problem.model.banded:
        for z in on_subset(one.problem, one.settled.coordinates, report):
            kind = [other.likelier_from(z) for other in kind]
    alike = [one for one in kind if one.settled.sigma <= ROUNDING_ONLY]
    if len(alike) < 2:
        return _least(kind)
    # A few thousand pixels may be content with several; all of them tell a kernel from another.
    return _least([one.settled_from(one.settled.coordinates) for one in alike])


def _with_doubt(best: Explanation, before: float, shifts: tuple[np.ndarray, ...]) -> Registered:
    """The ``best`` explanation, with what a resize left open of the mask."""
    picture, sigma = best.problem.picture, best.settled.sigma
    note, objection, variance = best.note(before), "", best.variance
    if variance is None and not best.map.whole and sigma > WITHOUT_EDGES:
        variance = edge_variance(picture.mask)
        if sigma > max(LOST_LEVELS, LOST_SHARE * before):
            objection = LOST.format(sigma, before)
    if variance is not None and variance.any():
        note = Remark(f"{note}{RESIZED}", "register")
        picture = dataclasses.replace(picture, texel_variance=variance)
    return Registered(best.problem.replaced(picture=picture), note, shifts, objection)

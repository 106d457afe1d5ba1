"""Shift and scale of a mask against its target, from different sources.

A pixel of the target at column x, from the left edge, shows what the mask has at column a x + b;
rows have a scale and a shift of their own. The first guesses are that both show the same frame,
and that the target is a crop of it. From the best, the four numbers are improved by Gauss-Newton
steps on a few thousand pixels, with the parameters' own steps projected out. A map that is a shift
by whole pixels, to within its error, is taken as that: the mask is then cropped and not
interpolated. A mask that was resized from the target's size is taken as it was before that, where
this explains no less (``godfit.search.resizing``): interpolated twice, its edges would be grey.
Where the target was resized instead, the mask is as it was: the light pass has its size, and is
interpolated as one at a lower resolution.

The light is in the target's frame. Beyond the target's edge the mask's edge there is repeated,
which is exact for a light on the picture: its rays do not leave the frame.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any, NamedTuple

import numpy as np

from godfit.errors import InputError, Remark
from godfit.inference.allowances.mask_rounding import edge_variance
from godfit.inference.problem import SEARCH_PIXELS, Problem, pixels_used
from godfit.inference.settle import Settled, settle
from godfit.inference.solver import Tangent
from godfit.inference.strategy import Report, stages, starting_points
from godfit.scattering.upsample import is_larger
from godfit.search import multigrid, resized_bytes
from godfit.search.density_minima import ROUNDING_ONLY, on_subset
from godfit.search.resizing import before_resize

NEAR, NEAR_ASPECT = 0.02, 0.01
"""Differences of the sides and of the aspects of mask and target, as a share, up to which the mask
is registered unasked: a crop by a few pixels or a resize by as much happens unnoticed."""
REGISTERED = 0.1
"""The same where registration was asked for: farther the two are different frames."""
STEP = 0.25
"""Pixels by which the mask is moved for a derivative: over less, few of its edges cross a pixel
centre, whose interpolation has kinks."""
ROUNDS = 8
"""Gauss-Newton steps, at most."""
LEAST_STEP = 1e-3
"""Pixels below which another step is not worth it."""
WHOLE = 0.05
"""Pixels within which a map is taken as a shift by whole pixels, where that explains no less."""

LIKELY = 2.0
"""Noise as a share of the least found, up to which another kind of explanation is worth a search: a
wrong density leaves so much of the right one."""
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


class Map(NamedTuple):
    """Where the target's pixels lie in the mask: by axis, rows first, ``scale`` and ``shift``, in
    the mask's pixels for each of the target's and in the mask's pixels."""

    scale: np.ndarray
    shift: np.ndarray

    def corners(self, size: tuple[int, int]) -> np.ndarray:
        """(4,) places of the target's first and last edge by axis, which are what is fitted: scale
        and shift trade with each other."""
        return np.concatenate([self.shift, self.scale * size + self.shift])

    @staticmethod
    def of(corners: np.ndarray, size: tuple[int, int]) -> Map:
        """The map with these ``corners`` for a target of ``size``."""
        return Map((corners[2:] - corners[:2]) / size, corners[:2])

    @property
    def whole(self) -> bool:
        """Whether it is a shift by whole pixels."""
        return bool((self.scale == 1).all() and (self.shift == np.round(self.shift)).all())

    def applied(self, mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """(h, w, ...) the ``mask`` at the target's pixels, its edge repeated."""
        from scipy import ndimage

        offset = 0.5 * self.scale + self.shift - 0.5

        def one(channel):
            places: Any = offset
            moved: Any = ndimage.affine_transform(
                channel, self.scale, places, size, order=1, mode="nearest"
            )
            return moved

        if mask.ndim == 2:
            return one(mask)
        return np.stack([one(mask[..., c]) for c in range(mask.shape[-1])], -1)


IDENTITY = Map(np.ones(2), np.zeros(2))
"""The map of a mask of the target's size and frame."""


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


def _least(explanations: list[Explanation]) -> Explanation:
    """That which leaves the least noise."""
    return min(explanations, key=lambda one: one.settled.sigma)


def may_register(mask: tuple[int, ...], target: tuple[int, ...], asked: bool) -> bool:
    """Whether a mask of a size (h, w) can be registered with a target of another; unasked only
    where the two differ, by little: a light pass at lower resolution is smaller by more."""
    ratio = np.array(mask[:2]) / np.array(target[:2])
    if asked:
        return bool((np.abs(ratio - 1) <= REGISTERED).all())
    near = (np.abs(ratio - 1) <= NEAR).all() and abs(ratio[0] / ratio[1] - 1) <= NEAR_ASPECT
    return bool(near and mask[:2] != target[:2])


def fitted_size(mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The mask at the target's size, as one frame: what registration begins with."""
    return Map(np.array(mask.shape[:2]) / size, np.zeros(2)).applied(mask, size)


def unregistered(
    mask: np.ndarray, size: tuple[int, ...], asked: bool, pass_scale: float
) -> np.ndarray | None:
    """The mask, where it is to be registered with a target of a ``size``; None where it is taken as
    it is. Raises InputError where registration was ``asked`` for and is not possible."""
    if pass_scale != 1:
        if asked:
            raise InputError("register: expected no --pass-scale with it; leave one of them out")
        return None
    if asked:
        check_registered(mask.shape, size)
    elif not may_register(mask.shape, size, asked=False):
        return None
    return mask


def check_registered(mask: tuple[int, ...], target: tuple[int, ...]) -> None:
    """Raise InputError for a mask that is too far from its target's size to be registered."""
    if not may_register(mask, target, asked=True):
        (h, w), (height, width) = mask[:2], target[:2]
        raise InputError(
            f"register: expected a mask within {REGISTERED:.0%} of the target's {width}x{height} "
            f"pixels, got {w}x{h}; crop or scale it first"
        )


def registered(
    problem: Problem, mask: np.ndarray, given: dict[str, float], report: Report
) -> Registered:
    """The ``problem`` under ``mask`` (H, W, ...) moved and scaled to fit it best."""
    report("shift and scale of the mask")
    size = problem.picture.size
    sides = np.array(mask.shape[:2])
    guesses = [Map(sides / size, np.zeros(2))]
    for down, right in itertools.product(*(sorted({0, n // 2, n}) for n in sides - size)):
        guesses.append(Map(np.ones(2), np.array([down, right], float)))
    solver = _Solver(problem, mask)
    begun = [solver.begin(guess, given) for guess in guesses]
    before = begun[0].sigma
    crops = sorted(zip(guesses[1:], begun[1:], strict=True), key=lambda pair: pair[1].sigma)
    masks = solver.masks_before_resize(guesses[0], begun[0])
    targets = solver.targets_before_resize(begun[0])
    # None of these has a number to be fitted: the right one leaves rounding alone, at the right
    # density.
    kinds = [[solver.cropped(*pair) for pair in crops[:1]], masks, targets]
    kinds = sorted(filter(None, kinds), key=lambda kind: _least(kind).settled.sigma)
    for kind in kinds:
        if _least(kind).settled.sigma > LIKELY * _least(kinds[0]).settled.sigma:
            break
        sure = solver.searched(kind, report)
        if sure.settled.sigma <= ROUNDING_ONLY:
            return _with_doubt(sure, before, ())
    # A crop may resemble a resize: the best crop and the same frame both go on.
    ends = [solver.solve(guesses[0].corners(size), begun[0])]
    ends += [solver.solve(guess.corners(size), z) for guess, z in crops[:1]]
    corners, settled, slopes, errors = max(ends, key=lambda end: end[1].log_likelihood)
    best = Explanation(solver.posed(corners), settled, Map.of(corners, size))
    whole = Map(np.ones(2), np.round(best.map.shift))
    if np.abs(whole.corners(size) - corners).max() < WHOLE:
        masks = [*masks, solver.cropped(whole, settled)]
    tried = [solver.settled(one, settled.coordinates) for one in masks]
    near = max(tried, key=lambda one: one.settled.log_likelihood, default=best)
    if near is not best and near.settled.log_likelihood >= settled.log_likelihood - 1:
        best, errors = near, np.zeros((0, 4))
    targets = [solver.settled(one, settled.coordinates) for one in targets]
    there = _least([best, *targets])
    if there is not best:
        return _with_doubt(there, before, ())
    return _with_doubt(best, before, tuple(slopes @ error for error in errors))


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


class _Solver:
    """Maps of ``mask`` (H, W, ...) onto the target of a ``problem``."""

    def __init__(self, problem: Problem, mask: np.ndarray) -> None:
        self.problem, self.mask = problem, np.asarray(mask, np.float32)
        if problem.picture.mask.ndim == 2 and self.mask.ndim == 3:
            self.mask = self.mask[..., 0]
        self.size = problem.picture.size
        self.observation = problem.observe(SEARCH_PIXELS)

    def posed(self, corners: np.ndarray) -> Problem:
        """The problem under the mask mapped so."""
        moved = Map.of(corners, self.size).applied(self.mask, self.size)
        return self.problem.replaced(picture=self.problem.picture.with_mask(moved))

    def begin(self, guess: Map, given: dict[str, float]) -> Settled:
        """Where a search from no start settles under the mask mapped by ``guess``."""
        problem = self.posed(guess.corners(self.size))
        starts = starting_points(problem, given)
        if problem.free.any():
            climbed = multigrid.climb(
                problem.small, starts, lambda text: None, stages=stages(problem.model)
            )
            starts = [climbed.coordinates]
        return settle(starts[0], problem, self._view(problem))[0]

    def _view(self, problem: Problem):
        return self.observation.with_mask(problem.picture.mask)

    def at(self, corners: np.ndarray, start: np.ndarray) -> tuple[Settled, Tangent, Problem]:
        """Where the parameters settle under a map, with the tangent there."""
        return self.under(Map.of(corners, self.size).applied(self.mask, self.size), start)

    def under(self, moved: np.ndarray, start: np.ndarray) -> tuple[Settled, Tangent, Problem]:
        """The same under a mask of the target's size."""
        problem = self.problem.replaced(picture=self.problem.picture.with_mask(moved))
        settled, tangent = settle(start, problem, self._view(problem))
        return settled, tangent, problem

    def settled(self, one: Explanation, start: np.ndarray) -> Explanation:
        """The explanation settled from another start, where that is likelier."""
        again = one.settled_from(start, SEARCH_PIXELS)
        better = again.settled.log_likelihood > one.settled.log_likelihood
        return again if better else one

    def searched(self, kind: list[Explanation], report: Report) -> Explanation:
        """The best of the explanations of a kind at the best of its densities. A density that is
        found under one of them serves the others."""
        one = _least(kind)
        if one.settled.sigma > ROUNDING_ONLY and self.problem.model.banded:
            for z in on_subset(one.problem, one.settled.coordinates, report):
                kind = [self.settled(other, z) for other in kind]
        alike = [one for one in kind if one.settled.sigma <= ROUNDING_ONLY]
        if len(alike) < 2:
            return _least(kind)
        # A few thousand pixels may be content with several; all of them tell a kernel from another.
        return _least([one.settled_from(one.settled.coordinates) for one in alike])

    def cropped(self, whole: Map, start: Settled) -> Explanation:
        """The target as a crop of the mask's frame."""
        settled, _, problem = self.under(whole.applied(self.mask, self.size), start.coordinates)
        return Explanation(problem, settled, whole)

    def masks_before_resize(self, frame: Map, start: Settled) -> list[Explanation]:
        """The mask as it was at the target's size, by each kernel."""
        found = []
        for before in before_resize(self.mask, self.size):
            settled, _, problem = self.under(before.mask, start.coordinates)
            found.append(Explanation(problem, settled, frame, before.variance))
        return found

    def targets_before_resize(self, start: Settled) -> list[Explanation]:
        """The target as it was at the mask's size, by each kernel. One that is not in bytes is
        interpolated from a light pass of that size instead."""
        if is_larger(self.mask.shape[:2], self.size):
            return []
        settled, _, problem = self.under(self.mask, start.coordinates)
        pictures = resized_bytes.before_resize(problem.picture, self.mask.shape[:2])
        found = []
        for kernel, picture in pictures.items():
            one = Explanation(problem.replaced(picture=picture), settled, kernel=kernel)
            found.append(one.settled_from(settled.coordinates, SEARCH_PIXELS))
        return found or [Explanation(problem, settled, kernel="bilinear")]

    def solve(
        self, corners: np.ndarray, begun: Settled
    ) -> tuple[np.ndarray, Settled, np.ndarray, np.ndarray]:
        """The corners that explain the picture best, where the parameters settle there, the slopes
        (p, 4) of these by the corners, and errors (4, 4): an error of the corners a row."""
        best, tangent, problem = self.at(corners, begun.coordinates)
        step, slopes, errors = self._step(corners, best, tangent, problem)
        part = 1.0
        for _ in range(ROUNDS):
            if np.abs(step * part).max() < LEAST_STEP:
                break
            other = corners + part * step
            settled, moved, there = self.at(other, best.coordinates + slopes @ (part * step))
            if settled.log_likelihood <= best.log_likelihood:
                part /= 2
                continue
            corners, best = other, settled
            step, slopes, errors = self._step(corners, best, moved, there)
            part = 1.0
        return corners, best, slopes, errors

    def _step(
        self, corners: np.ndarray, settled: Settled, tangent: Tangent, problem: Problem
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The Gauss-Newton step of the corners, the slopes (p, 4) of the parameters by them, and
        the errors (4, 4) of the corners."""
        lo, hi = np.asarray(self.observation.lo), np.asarray(self.observation.hi)
        known = np.isfinite(lo) & np.isfinite(hi)
        residual = ((lo + hi) / 2 - tangent.prediction)[known].astype(np.float64)
        columns = []
        for k in range(4):
            ends = [self._levels(corners + sign * STEP * np.eye(4)[k], settled) for sign in (1, -1)]
            columns.append((ends[0] - ends[1])[known] / (2 * STEP))
        free = problem.free
        inner = tangent.jacobian[free][:, known].T.astype(np.float64)
        jacobian = np.concatenate([inner, np.stack(columns, -1)], 1)
        size = np.maximum(np.sqrt((jacobian**2).sum(0)), 1e-12)
        solution, *_ = np.linalg.lstsq(jacobian / size, residual, rcond=None)
        count = int(free.sum())
        by_corner, *_ = np.linalg.lstsq(inner, -np.stack(columns, -1), rcond=None)
        slopes = np.zeros((len(free), 4))
        slopes[free] = by_corner * np.asarray(tangent.scale, float)[free, None]
        spread = np.linalg.pinv((jacobian / size).T @ (jacobian / size))
        spread = spread * max(float((residual**2).mean()), 1e-12)
        covariance = (spread / np.outer(size, size))[count:, count:]
        values, vectors = np.linalg.eigh(covariance)
        errors = np.sqrt(np.maximum(values, 0))[:, None] * vectors.T
        return (solution / size)[count:], slopes, errors

    def _levels(self, corners: np.ndarray, settled: Settled) -> np.ndarray:
        problem = self.posed(corners)
        model = problem.at(settled.coordinates)
        return np.asarray(self._view(problem).predict(model), np.float64)

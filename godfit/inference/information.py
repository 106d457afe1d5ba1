"""Information about the fitted point: covariance, undetermined coordinates, residual structure."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from godfit.inference.allowances.shared_noise import shared_slopes
from godfit.inference.likelihood import interval
from godfit.inference.noise import EXPLAINED, noise_of
from godfit.inference.observation import Observation
from godfit.inference.settle import Settled
from godfit.inference.solver import Intervals, Tangent
from godfit.runtime.parallel import parallel_map
from godfit.runtime.program_cache import cached_jit

MAX_TAILS = 3.5
"""Kurtosis up to which a residual may be noise: Gaussian noise has 3, chance adds a few tenths."""
MAX_CORRELATION = 0.3
"""Correlation of neighbours up to which a residual may be noise: rounding alone leaves some."""
UNEVEN = 1.5
"""Widths of intervals of one picture, as a ratio, up to which they are alike."""
EVIDENCE_VALUES = 1 << 17
"""Values that are worked on together, so that memory does not grow with the picture."""
OPEN_ENTRY = 0.3
"""Entry of an open direction's unit vector from which a coordinate takes part in it: its share of
the power is then a tenth."""
HELD_LAST_WEIGHT = 0.3
"""Factor on the entry of the coordinate that is held last: only a dominant one is held before."""
OUTLIER_SPREADS = 5.0
"""Robust standard deviations beyond which a value counts as an outlier: noise is never as far."""
LEAST_SPREAD = 0.3
"""Robust standard deviation in levels, at least: rounding alone has 1 / sqrt(12)."""

CELLS = 2304
"""Cells of the map of information: 64 x 36 on a wide picture, each some tens of pixels wide."""
CELL_VALUES = 1 << 16
"""Values that the map is summed over, at most: some thirty in each cell."""
TINY_INFORMATION = 1e-30
"""Stands for no information in a divisor."""
SINGULAR = 1e-9
"""Eigenvalue of a scaled information, as a share of the largest, up to which it is none."""


class Evidence(NamedTuple):
    """The likelihood about the fitted point.

    By coordinate: ``curvature`` (p, p) is the sum of -d2 log-likelihood, ``scores`` (p, p) that of
    the outer products of its slopes, ``gradient`` (p,) that of the slopes; ``blunt`` is the
    curvature with the rounding counted as noise, which is the information of least squares.
    ``prediction`` (m,) is in levels, ``score`` (m,) the slope of each value's log-likelihood in
    units of sigma. ``cells`` (p, p, rows, columns) is the information of least squares, in units of
    one level of noise, that each cell of the picture holds. ``shared`` (p, p) is the covariance of
    the slopes of different values by noise that they share, None where none is known. ``counts`` is
    how many values determine each of some directions (p, k).
    """

    curvature: np.ndarray
    scores: np.ndarray
    blunt: np.ndarray
    gradient: np.ndarray
    prediction: np.ndarray
    score: np.ndarray
    cells: np.ndarray
    counts: Callable[[np.ndarray], np.ndarray]
    shared: np.ndarray | None = None

    def within(self, ranges: np.ndarray) -> Evidence:
        """The evidence with a prior: coordinates lie within plausible ``ranges`` (p,). Some can
        trade until only the prior limits them."""
        known = np.diag(1 / ranges**2)
        return self._replace(
            curvature=self.curvature + known, scores=self.scores + known, blunt=self.blunt + known
        )

    def thinned(self, repeats: float) -> Evidence:
        """The evidence of a picture whose every line is repeated ``repeats`` times, as least
        squares counts it. The roundings of so few different pixels are no random sample, and the
        ends of intervals that they happen to touch would promise far too much."""
        return self if repeats <= 1 else self._of_least_squares(repeats)

    def _of_least_squares(self, repeats: float = 1.0) -> Evidence:
        """The evidence without what the ends of intervals promise."""
        blunt = self.blunt / repeats
        return self._replace(curvature=blunt, scores=blunt, blunt=blunt, shared=None)

    def without_shared_noise(self) -> Evidence:
        """The evidence as if all noise were of each value alone."""
        return self if self.shared is None else self._replace(shared=np.zeros_like(self.shared))

    def covariance(self, free: np.ndarray) -> np.ndarray:
        """(p, p) covariance of the coordinates, zero for those that are not free.

        It inverts the information: curvature or scores, in every direction the lesser. With noise
        the two agree. Where rounding is the only noise, the problem is not regular: intervals from
        the curvature alone cover too seldom, those from the scores cover often enough. There the
        likelihood may also be flat at its top, all values inside their intervals. The information
        is never taken to be less than that of least squares. Nor is it more than that times the
        number of values that determine a direction: n values between ends know a number n^2 times
        as well as one, and least squares n times.

        Where the noise of each value is known, the problem is regular, and the curvature counts.
        The scores are then a sum over the few values that happened to be pushed over the end of
        their interval. With noise that values share, the covariance is that of a sandwich, the
        curvature's inverse about the covariance of the slopes (White, Econometrica 50 (1982), 1).
        """
        covariance = np.zeros_like(self.curvature)
        curvature, scores, blunt = (
            m[np.ix_(free, free)] for m in (self.curvature, self.scores, self.blunt)
        )
        # Scaled to a unit diagonal first: the coordinates' units differ by orders of magnitude.
        size = np.sqrt(np.maximum(np.diag(blunt), 1e-30))
        values, vectors = np.linalg.eigh(blunt / np.outer(size, size))
        known = values > 1e-9 * max(values.max(initial=0), 1e-30)
        root = vectors[:, known] / np.sqrt(values[known])

        def against_blunt(information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            gain, turn = np.linalg.eigh(root.T @ (information / np.outer(size, size)) @ root)
            directions = np.zeros((len(free), len(gain)))
            directions[free] = root @ turn / size[:, None]
            return np.clip(gain, 1.0, np.maximum(self.counts(directions), 1.0)), turn

        gain, turn = against_blunt(curvature)
        whiten = turn / np.sqrt(gain)
        if self.shared is None:
            other, other_turn = against_blunt(scores)
            share, last = np.linalg.eigh(whiten.T @ (other_turn * other) @ other_turn.T @ whiten)
            root = root @ whiten @ last / np.sqrt(np.minimum(share, 1.0))
        else:
            root = root @ whiten
            shared = self.shared[np.ix_(free, free)] / np.outer(size, size)
            growth, last = np.linalg.eigh(root.T @ shared @ root)
            # Values whose noise cancels are not counted on.
            root = root @ last * np.sqrt(1 + np.maximum(growth, 0.0))
        covariance[np.ix_(free, free)] = root @ root.T / np.outer(size, size)
        return covariance


@cached_jit
def _evidence(prediction, jacobian, intervals, sigma, blunt_sigma):
    lo, hi, foreign, own_noise = intervals
    noise, blunt_noise = noise_of(sigma, own_noise), noise_of(blunt_sigma, own_noise)

    def pixels(noise):
        return interval((lo - prediction) / noise, (hi - prediction) / noise, foreign)

    def information(pull):
        return (jacobian * pull[None]) @ jacobian.T

    sharp = pixels(noise)
    score, pull = sharp.slope / noise, sharp.curvature / noise**2
    slopes = jacobian * score[None]
    # A value that is bounded from one side alone may be anything on the other.
    both = jnp.isfinite(lo) & jnp.isfinite(hi)
    blunt = information(jnp.where(both, pixels(blunt_noise).curvature / blunt_noise**2, 0))
    return information(pull), slopes @ slopes.T, blunt, slopes.sum(1), score * sigma, pull


def evidence(settled: Settled, tangent: Tangent, observation: Observation) -> Evidence:
    """The evidence at a settled point."""
    lo, hi = np.asarray(observation.lo), np.asarray(observation.hi)
    width = hi - lo
    sigma = settled.sigma
    blunt_sigma = np.hypot(sigma, width[np.isfinite(width)].max(initial=0) / math.sqrt(12))

    def of(rows: slice) -> list[np.ndarray]:
        own = None if observation.own_noise is None else observation.own_noise[rows]
        intervals = Intervals(lo[rows], hi[rows], observation.foreign, own)
        values = tangent.prediction[rows], tangent.jacobian[:, rows], intervals
        found = _evidence(*values, np.float32(sigma), np.float32(blunt_sigma))
        return [np.asarray(z) for z in found]

    parts = parallel_map(
        of, [slice(b, b + EVIDENCE_VALUES) for b in range(0, len(lo), EVIDENCE_VALUES)]
    )
    curvature, scores, blunt, gradient = (
        np.sum([part[i] for part in parts], 0, np.float64) for i in range(4)
    )
    if tangent.prior is not None:
        known = tangent.prior.information
        curvature, scores, blunt = curvature + known, scores + known, blunt + known
        gradient = gradient + tangent.prior.slope
    # Summed in scaled coordinates, where float32 holds all entries alike.
    size = np.outer(tangent.scale, tangent.scale).astype(np.float64)
    shared = None
    # What is less than other noise by far does not matter, and would take long for every value.
    if observation.shared_noise is not None and sigma <= EXPLAINED:
        pull = np.concatenate([part[5] for part in parts])
        shared = shared_slopes(tangent.jacobian, pull, observation) / size
    found = Evidence(
        curvature / size,
        scores / size,
        blunt / size,
        gradient / tangent.scale,
        tangent.prediction,
        np.concatenate([part[4] for part in parts]),
        cell_information(tangent, observation),
        partial(_counts, tangent, width),
        shared,
    )
    # A tangent that holds on average says nothing about the few values at ends of intervals.
    return found._of_least_squares() if tangent.jumps else found


def _counts(tangent: Tangent, width: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(k,) how many of the values that are bounded from both sides, with intervals of a ``width``
    (m,), determine each of the ``directions`` (p, k) of coordinates: (sum of q)^2 / sum of q^2 for
    information q. Where all intervals are alike, a picture is as it was stored, and many do."""
    bounded = np.isfinite(width)
    if width[bounded].max(initial=0) < UNEVEN * width[bounded].min(initial=np.inf):
        return np.full(directions.shape[1], np.inf)
    scaled = np.float32(directions / np.asarray(tangent.scale)[:, None])
    squares = np.square(scaled.T @ np.asarray(tangent.jacobian)) * bounded
    total, spread = squares.sum(1), np.array([one @ one for one in squares])
    return total**2 / np.maximum(spread, 1e-30)


def cell_information(tangent: Tangent, observation: Observation) -> np.ndarray:
    """(p, p, rows, columns) the sum of J^T J over a sample of the values in each cell of the
    picture. Clipped values have no slope and count nothing."""
    height, width = observation.size
    side = max(1, round(math.sqrt(height * width / CELLS)))
    rows, columns = -(-height // side), -(-width // side)
    pixels, channels = np.asarray(observation.pixels), observation.channels
    chosen = np.arange(0, len(pixels), max(1, len(pixels) * channels // CELL_VALUES))
    values = (chosen[:, None] * channels + np.arange(channels)).reshape(-1)
    lo, hi = np.asarray(observation.lo)[values], np.asarray(observation.hi)[values]
    slopes = tangent.jacobian[:, values] * (np.isfinite(lo) & np.isfinite(hi))
    at = np.repeat(pixels[chosen], channels)
    cell = at // width // side * columns + at % width // side
    count = len(slopes)
    found = np.zeros((count, count, rows * columns), np.float32)
    for i in range(count):
        for j in range(i + 1):
            both = np.bincount(cell, slopes[i] * slopes[j], rows * columns)
            found[i, j] = found[j, i] = both / (tangent.scale[i] * tangent.scale[j])
    return found.reshape(count, count, rows, columns)


def shares(cells: np.ndarray, free: np.ndarray, slopes: np.ndarray) -> list[np.ndarray | None]:
    """The share (rows, columns) of the information on each parameter that each cell holds; None for
    a parameter on which there is none.

    **Arguments:**

    - `cells`: (p, p, rows, columns), as in ``Evidence``.
    - `free`: (p,) which coordinates were fitted.
    - `slopes`: (p, p) derivatives of the parameters by the coordinates.

    The estimate of a parameter moves by v^T J r for a residual r, with v the covariance times the
    parameter's slopes: the variance is a sum over the pixels of (v^T J)^2. What trades with other
    parameters is so left out.
    """
    used = np.flatnonzero(free)
    part = cells[np.ix_(used, used)].astype(np.float64)
    information = part.sum((-2, -1))
    size = np.sqrt(np.maximum(np.diag(information), TINY_INFORMATION))
    covariance = np.linalg.pinv(information / np.outer(size, size), SINGULAR, hermitian=True)
    found: list[np.ndarray | None] = []
    for slope in slopes[:, used]:
        along = covariance @ (slope / size) / size
        share = np.einsum("i,ijrc,j->rc", along, part, along)
        total = share.sum()
        known = np.isfinite(total) and total > 0
        found.append(np.maximum(share / total, 0).astype(np.float32) if known else None)
    return found


def undetermined(
    information: np.ndarray, ranges: np.ndarray, free: np.ndarray, keep: int
) -> list[tuple[int, list[int]]]:
    """Coordinates to hold because the picture leaves them open, each with those it trades with.

    ``information`` is (p, p), ``ranges`` and ``free`` are (p,). A direction is open if moving along
    it over the coordinates' plausible ``ranges`` changes the log-likelihood by less than 1/2. The
    coordinate with the largest entry is held, and the rest is tested again. The coordinate ``keep``
    is held last: it remains when only one number is determined.
    """
    open_: list[tuple[int, list[int]]] = []
    remaining = [int(i) for i in np.flatnonzero(free)]
    while remaining:
        scales = np.outer(ranges[remaining], ranges[remaining])
        block = information[np.ix_(remaining, remaining)] * scales
        values, vectors = np.linalg.eigh(block)
        if values[0] >= 1:
            break
        direction = np.abs(vectors[:, 0])
        weights = np.where(np.array(remaining) == keep, HELD_LAST_WEIGHT, 1.0)

        largest = int(np.argmax(weights * direction))
        partners = [
            remaining[int(i)] for i in np.flatnonzero(direction > OPEN_ENTRY) if i != largest
        ]
        open_.append((remaining[largest], partners))
        del remaining[largest]
    return open_


class Misfit(NamedTuple):
    """How much the residual differs from noise: ``tails``, the fourth moment over the squared
    second (3 for Gaussian noise), and ``correlation`` of horizontal neighbours (0)."""

    tails: float
    correlation: float

    @property
    def like_noise(self) -> bool:
        return self.tails < MAX_TAILS and self.correlation < MAX_CORRELATION


def misfit(prediction: np.ndarray, observation: Observation) -> Misfit:
    """``Misfit`` of the values that are not clipped."""
    lo, hi = np.asarray(observation.lo), np.asarray(observation.hi)
    inside = np.isfinite(lo) & np.isfinite(hi)
    residual = (np.where(inside, lo, 0) + np.where(inside, hi, 0)) / 2
    residual = np.where(inside, np.asarray(prediction) - residual, 0.0)
    if observation.own_noise is not None and not observation.foreign:
        # What is known to differ from value to value is no sign of a misfit.
        rounding = np.where(inside, hi - lo, 0.0) / math.sqrt(12)
        noise = np.hypot(np.asarray(observation.own_noise), rounding)
        residual = residual / np.maximum(noise, LEAST_SPREAD)
    if observation.foreign:
        # Foreign pixels may have any level: they are no sample of the noise.
        spread = 1.4826 * float(np.median(np.abs(residual[inside]))) if inside.any() else 0.0
        inside &= np.abs(residual) < OUTLIER_SPREADS * max(spread, LEAST_SPREAD)
        residual = np.where(inside, residual, 0.0)
    count = max(int(np.count_nonzero(inside)), 1)
    square = np.square(residual)
    power = float(square.sum(dtype=np.float64)) / count
    if power == 0:
        return Misfit(0.0, 0.0)
    tails = float(np.square(square).sum(dtype=np.float64)) / count / power**2
    rows = residual.reshape(-1, observation.channels)
    known = inside.reshape(-1, observation.channels)
    pixels = np.asarray(observation.pixels)
    beside = (np.diff(pixels) == 1) & (pixels[1:] % observation.size[1] != 0)
    both = known[:-1] & known[1:] & beside[:, None]
    pairs = max(int(np.count_nonzero(both)), 1)
    products = np.where(both, rows[:-1] * rows[1:], 0)
    correlation = float(products.sum(dtype=np.float64)) / pairs / power
    return Misfit(tails, correlation)

"""The bytes of a picture before an image program resized it, within bounds.

A pixel after the resize is a weighted mean of a few pixels before it, rounded to a byte. So it
bounds each of them by the bounds of the others, and bounds are narrowed in turn (propagation of
intervals: Davis, Artificial Intelligence 32 (1987), 281). What a resize leaves nearly alone is
known to the byte; what it mixes evenly stays open. Bounds of a kernel that was not the resize's
exclude each other at edges.

The fit is then that of an ordinary picture, some of whose pixels are known less well: nothing is
interpolated, and no rounding of another picture passes for noise.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from godfit.inference.observation import Picture
from godfit.io.image import LEVELS
from godfit.io.jpeg import was_jpeg
from godfit.io.resampling import KERNELS, Resize, columns_of, picture_of

if TYPE_CHECKING:
    from scipy import sparse

EVERY_BYTE = np.arange(LEVELS + 1)
HALF_LEVEL = 0.5
"""Half the distance between two bytes, in levels."""
ROUNDS = 20
"""Rounds in which bounds are narrowed, at most."""
TIE = 1e-6
"""Levels within which a program may have rounded up or down."""
LEAST_WEIGHT = 1e-6
"""Weights below which a pixel is not seen: they are zeros of a kernel, computed in float64."""
WIDEST = 2.0
"""Levels between the bounds of a pixel that is fitted, at most; the others would cost time and tell
nothing."""
CONTRADICTED = 1e-2
"""Share of pixels whose bounds exclude each other from which the kernel is another one."""


class Bounds(NamedTuple):
    """The least and the largest byte, ``low`` and ``high`` (h, w, c) in levels, that each pixel may
    have had; where they exclude each other, nothing is known. ``contradicted`` is the share of
    values of which they did, after the rows or after the columns."""

    low: np.ndarray
    high: np.ndarray
    contradicted: float

    @property
    def known(self) -> np.ndarray:
        """(h, w) pixels that are bounded well in every channel."""
        width = self.high - self.low
        known: np.ndarray = np.all((width >= 0) & (width <= WIDEST), -1)
        return known


def narrowed(
    low: np.ndarray, high: np.ndarray, weights: sparse.csr_array, values: np.ndarray = EVERY_BYTE
) -> tuple[np.ndarray, np.ndarray]:
    """(n, k) bounds in levels of the bytes, some of ``values`` (v,) in order, of k columns of which
    ``weights`` (m, n) made columns with bytes from ``low`` to ``high`` (m, k)."""
    low = np.where(low <= 0, -np.inf, low - HALF_LEVEL)
    high = np.where(high >= LEVELS, np.inf, high + HALF_LEVEL)
    weights = weights.copy()
    weights.data[np.abs(weights.data) < LEAST_WEIGHT] = 0
    weights.eliminate_zeros()
    rising, falling = weights.maximum(0), weights.minimum(0)
    seen = _seen_in(weights)
    below = np.full((len(seen[0][0]), low.shape[1]), values[0])
    above = np.full_like(below, values[-1])
    # By byte, the nearest of the values up and down from it. Beyond the ends there is one more, so
    # that bounds that exclude each other are seen; index -1 is the last.
    every = np.arange(LEVELS + 2)
    next_up = np.append(values, LEVELS + 1)[values.searchsorted(every)]
    next_down = np.append(-1.0, values)[values.searchsorted(every, "right")]
    next_down[-1] = -1
    for _ in range(ROUNDS):
        least, most = rising @ below + falling @ above, rising @ above + falling @ below
        before = below, above
        for rows, own in seen:
            ends = own * before[0], own * before[1]
            # What is left for the pixel's own part, when the others are at their ends.
            first = (low[rows] - (most[rows] - np.maximum(*ends))) / own
            last = (high[rows] - (least[rows] - np.minimum(*ends))) / own
            below = np.maximum(below, np.ceil(np.minimum(first, last) - TIE))
            above = np.minimum(above, np.floor(np.maximum(first, last) + TIE))
        below = next_up[below.clip(0, LEVELS + 1).astype(int)]
        above = next_down[above.clip(-1, LEVELS).astype(int)]
        done = (below == before[0]).all() and (above == before[1]).all()
        if done or (below > above).mean() > CONTRADICTED:
            break
    return below, above


def _seen_in(weights: sparse.csr_array) -> list[tuple[np.ndarray, np.ndarray]]:
    """For the first, second, ... row (n,) of ``weights`` (m, n) in which each column is seen: that
    row and the weight (n, 1) there. Columns that are seen in fewer rows repeat their last one; one
    that is seen in none has a row of no weight, which bounds nothing."""
    columns = weights.tocsc()
    count = np.diff(columns.indptr)
    rows = np.append(columns.indices, 0)
    shares = np.append(columns.data, 1e-30)
    found = []
    for k in range(int(count.max())):
        at = columns.indptr[:-1] + np.minimum(k, count - 1)
        at = np.where(count > 0, at, len(rows) - 1)
        found.append((rows[at], shares[at][:, None]))
    return found


def bytes_before(
    levels: np.ndarray, valid: np.ndarray, resize: Resize, values: np.ndarray = EVERY_BYTE
) -> Bounds:
    """The bounds of the picture, of ``values`` (v,) in order, of which a ``resize``, columns first
    and rounded to bytes in between, made the ``levels`` (H, W, c), of which those that are
    ``valid`` (H, W) are known."""
    shown = valid[..., None]
    low, high = np.where(shown, levels, 0.0), np.where(shown, levels, LEVELS)
    contradicted = 0.0
    for axis, weights in enumerate(resize.weights):
        # Where bounds exclude each other, nothing is known.
        low, high = np.where(low > high, 0.0, low), np.where(low > high, LEVELS, high)
        # Rows come last, and what they were made of is any byte.
        own = EVERY_BYTE if axis == 0 else values
        shape, columns = low.shape, [columns_of(z.astype(np.float64), axis) for z in (low, high)]
        low, high = (picture_of(z, axis, shape) for z in narrowed(*columns, weights, own))
        contradicted = max(contradicted, float((low > high).mean()))
    return Bounds(low, high, contradicted)


def before_resize(picture: Picture, size: tuple[int, int]) -> dict[str, Picture]:
    """The ``picture`` as it was at ``size`` (h, w), by each of ``KERNELS`` that may have resized
    it: those without a contradiction, or all with few where each has some, as programs differ in
    what they round. Empty where it is not in bytes, or was changed after that, or has a
    background."""
    jpeg = picture.half > 0 and was_jpeg(picture.levels[..., 0])
    exact = picture.half == HALF_LEVEL and picture.rounding is None
    if not exact or jpeg or picture.background is not None:
        return {}
    found: dict[str, tuple[Bounds, Resize]] = {}
    for name in KERNELS:
        resize = Resize.of(size, picture.size, name)
        bounds = bytes_before(picture.levels, picture.valid, resize)
        if bounds.contradicted < CONTRADICTED and bounds.known.any():
            found[name] = bounds, resize
    least = min((bounds.contradicted for bounds, _ in found.values()), default=0.0)
    return {
        name: _bounded(picture, *one)
        for name, one in found.items()
        if one[0].contradicted == 0 or least > 0
    }


def _bounded(picture: Picture, bounds: Bounds, resize: Resize) -> Picture:
    """The ``picture`` before the ``resize``, by least squares within its ``bounds``."""
    low, high = np.minimum(bounds.low, bounds.high), np.maximum(bounds.low, bounds.high)

    def allowed(values: np.ndarray) -> np.ndarray:
        return np.round(values * LEVELS).clip(low, high) / LEVELS

    levels = np.round(resize.undone(picture.levels / LEVELS, allowed) * LEVELS)
    below, above = levels - low + HALF_LEVEL, high - levels + HALF_LEVEL
    # A value that may have been clipped is bounded from below alone.
    above = np.where(high >= LEVELS, np.inf, above)
    return dataclasses.replace(
        picture,
        levels=levels.astype(np.float32),
        valid=bounds.known,
        rounding=(below.astype(np.float32), above.astype(np.float32)),
    )

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
from godfit.io.resampling import (
    ROUNDED_ONCE,
    ROUNDED_TWICE,
    Resize,
    columns_of,
    picture_of,
)

if TYPE_CHECKING:
    from scipy import sparse

EVERY_BYTE = np.arange(LEVELS + 1)
HALF_LEVEL = 0.5
"""Half the distance between two bytes, in levels."""
ROUNDS, PASSES = 20, 5
"""Rounds in which bounds along an axis are narrowed, and passes over both axes, at most."""
LEAST_GAIN = 1e-2
"""Share of bounds that a pass moves, below which another is not worth it."""
TIE = 1e-3
"""Levels within which a program may have rounded up or down: Pillow's weights have 22 bits."""
FIXED_POINT = 0.4
"""Levels by which weights of few bits may be off, as OpenCV's are: .26 with two taps, .35 with
eight."""
LEAST_MOVE = 1e-2
"""Levels below which bounds move no more."""
LEAST_WEIGHT = 1e-6
"""Weights by which a pixel is not bounded: what is small is divided by them."""
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
    low: np.ndarray,
    high: np.ndarray,
    weights: sparse.csr_array,
    bounds: tuple[np.ndarray, np.ndarray],
    values: np.ndarray | None = EVERY_BYTE,
) -> tuple[np.ndarray, np.ndarray]:
    """The ``bounds`` (n, k) in levels, narrowed, of k columns of which ``weights`` (m, n) made
    columns from ``low`` to ``high`` (m, k): of bytes that are some of ``values`` (v,), in order; of
    any numbers where these are None."""
    rising, falling = weights.maximum(0), weights.minimum(0)
    used = weights.copy()
    used.data[np.abs(used.data) < LEAST_WEIGHT] = 0
    used.eliminate_zeros()
    seen = _seen_in(used)
    below, above = bounds
    low, high = low - TIE, high + TIE
    for _ in range(ROUNDS):
        least, most = rising @ below + falling @ above, rising @ above + falling @ below
        before = below, above
        for rows, own in seen:
            parts = own * before[0], own * before[1]
            # What is left for the pixel's own part, when the others are at their ends.
            first = (low[rows] - (most[rows] - np.maximum(*parts))) / own
            last = (high[rows] - (least[rows] - np.minimum(*parts))) / own
            below = np.maximum(below, np.minimum(first, last))
            above = np.minimum(above, np.maximum(first, last))
        if values is not None:
            below, above = _to_values(below, above, values)
        moved = max((below - before[0]).max(), (before[1] - above).max())
        if moved < LEAST_MOVE or (below > above).mean() > CONTRADICTED:
            break
    return below, above


def _to_values(
    below: np.ndarray, above: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The nearest of ``values`` (v,) up from ``below`` and down from ``above``. Beyond the ends
    there is one more, so that bounds that exclude each other are seen."""
    up = np.append(values, LEVELS + 1).astype(float)
    down = np.append(-1, values).astype(float)
    every = np.arange(LEVELS + 2)
    next_up = up[values.searchsorted(every)]
    # Index -1 is the last.
    next_down = np.append(down[values.searchsorted(every, "right")][:-1], -1.0)
    rounded = np.ceil(below).clip(0, LEVELS + 1), np.floor(above).clip(-1, LEVELS)
    return next_up[rounded[0].astype(int)], next_down[rounded[1].astype(int)]


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
    levels: np.ndarray,
    valid: np.ndarray,
    resize: Resize,
    values: np.ndarray = EVERY_BYTE,
    once: bool = False,
) -> Bounds:
    """The bounds of the picture, of ``values`` (v,) in order, of which a ``resize``, columns first,
    made the ``levels`` (H, W, c), of which those that are ``valid`` (H, W) are known. It rounded to
    bytes in between too, or ``once``."""
    shown, half = valid[..., None], HALF_LEVEL
    if once:
        # Programs differ in what they take to be beyond the edge.
        inside = resize.inside[0][:, None] & resize.inside[1]
        shown, half = shown & inside[..., None], HALF_LEVEL + FIXED_POINT
    low, high = np.where(shown, levels, 0.0), np.where(shown, levels, LEVELS)
    low, high = before_rounding(low, high, half)
    given = columns_of(low, 0), columns_of(high, 0)
    # Rows come last. What they were made of is any byte, or a number that may overshoot.
    rows, columns = resize.weights
    (h, w), c = (z.shape[1] for z in resize.bands), levels.shape[2]
    shape = h, levels.shape[1], c
    rising, falling = columns.maximum(0), columns.minimum(0)
    ends = (float(falling.sum(1).min()), float(rising.sum(1).max())) if once else (0.0, 1.0)
    everything = LEVELS * ends[0], LEVELS * ends[1]
    between = _of_size((h, shape[1] * c), *everything)
    before = _of_size((w, h * c), float(values[0]), float(values[-1]))
    contradicted = 0.0
    for _ in range(PASSES):
        between = narrowed(*given, rows, between, None if once else EVERY_BYTE)
        low, high = (columns_of(picture_of(z, 0, shape), 1) for z in between)
        # Where bounds exclude each other, nothing is known.
        unknown = low > high
        contradicted = max(contradicted, float(unknown.mean()))
        if once:
            unknown |= ~resize.inside[1][:, None]
        low, high = np.where(unknown, -np.inf, low), np.where(unknown, np.inf, high)
        if not once:
            low, high = before_rounding(low, high, half)
        last, before = before, narrowed(low, high, columns, before, values)
        contradicted = max(contradicted, float((before[0] > before[1]).mean()))
        moved = ((last[0] != before[0]) | (last[1] != before[1])).mean()
        if contradicted > CONTRADICTED or moved < LEAST_GAIN:
            break
        low, high = np.minimum(*before), np.maximum(*before)
        low, high = rising @ low + falling @ high - TIE, rising @ high + falling @ low + TIE
        if not once:
            low, high = np.ceil(low - half), np.floor(high + half)
            low, high = low.clip(0, LEVELS), high.clip(0, LEVELS)
        low, high = np.where(unknown, -np.inf, low), np.where(unknown, np.inf, high)
        low, high = (columns_of(picture_of(z, 1, shape), 0) for z in (low, high))
        wrong = between[0] > between[1]
        between = (
            np.where(wrong, everything[0], np.maximum(between[0], low)),
            np.where(wrong, everything[1], np.minimum(between[1], high)),
        )
    low, high = (picture_of(z, 1, shape) for z in before)
    return Bounds(low, high, contradicted)


def _of_size(shape: tuple[int, ...], low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    return np.full(shape, low), np.full(shape, high)


def before_rounding(
    low: np.ndarray, high: np.ndarray, half: float
) -> tuple[np.ndarray, np.ndarray]:
    """What is rounded to bytes from ``low`` to ``high``, by at most ``half``, after it was clipped
    to black and white."""
    return np.where(low <= 0, -np.inf, low - half), np.where(high >= LEVELS, np.inf, high + half)


def before_resize(
    picture: Picture, size: tuple[int, int], once: bool = False
) -> dict[str, Picture]:
    """The ``picture`` as it was at ``size`` (h, w), by each of the kernels of ``ROUNDED_TWICE`` or
    ``once`` that may have resized it: those without a contradiction, or all with few where each has
    some. Empty where it is not in bytes, or was changed after that, or has a background."""
    jpeg = picture.half > 0 and was_jpeg(picture.levels[..., 0])
    exact = picture.half == HALF_LEVEL and picture.rounding is None
    if not exact or jpeg or picture.background is not None:
        return {}
    found: dict[str, tuple[Bounds, Resize]] = {}
    for name in ROUNDED_ONCE if once else ROUNDED_TWICE:
        resize = Resize.of(size, picture.size, name)
        bounds = bytes_before(picture.levels, picture.valid, resize, once=once)
        if bounds.contradicted < CONTRADICTED and bounds.known.any():
            found[name] = bounds, resize
    least = min((bounds.contradicted for bounds, _ in found.values()), default=0.0)
    return {
        name: _bounded(picture, *one)
        for name, one in found.items()
        if once or one[0].contradicted == 0 or least > 0
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

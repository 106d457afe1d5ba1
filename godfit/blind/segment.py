"""What of a finished picture is open background, and what stands in the way or lies on top.

White light adds the same to every channel, so that whatever the rays do, an open pixel keeps the
differences between the channels of its background; an object of another colour does not. The
differences are a smooth field, fitted robustly; clipped channels say only that their value is at
least so much. Of a light of a colour channels change in a ratio: it is the one for which most of
the picture has such a field.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyvander
from scipy import ndimage

from godfit.io.filters import over_channels
from godfit.io.image import LEVELS
from godfit.models.background import TERM_COUNTS, TERM_POWERS, term_values
from godfit.runtime.parallel import parallel_map

# A difference of channels this many levels off, or this many times its own spread, is another
# colour.
LEAST, SPREADS = 4.0, 5.0
# An edge that light does not make: levels from one pixel to the next.
SHARP = 10.0
# Regions smaller than this share of the picture are told apart from nothing.
SPECK = 2e-5
PIXELS = 20_000
# The light has a colour if channels change in another ratio by so much. Pixels are explained if
# they are no more levels off, and a ratio is believed that explains so large a share of them, and
# so much more than white does.
COLOURED, NEAR, MOST, MORE = 0.015, 1.5, 0.7, 0.005


class Segments(NamedTuple):
    """``other`` (h, w): the colour is not the background's; ``doubtful``: the colour is, but edges
    cut it off; ``noise``: spread of the differences in levels; ``variation``: that of what is
    expected of them over the picture."""

    other: np.ndarray
    doubtful: np.ndarray
    noise: float
    variation: float


class Field(NamedTuple):
    """A polynomial of the place and ``slope`` times what it was to go along with: what it is over
    the picture (h, w), and the ``spread`` of the values about it."""

    whole: np.ndarray
    spread: float
    slope: float


def field(
    values: np.ndarray,
    known: np.ndarray,
    degree: int,
    along: np.ndarray | None = None,
    rounds: int = 30,
) -> Field:
    """Through most of ``values`` (h, w) where ``known``: a polynomial of the place, and a multiple
    of ``along`` (h, w) if there is one. Cauchy weights, their width lowered to the spread."""
    h, w = values.shape
    at = np.flatnonzero(known)
    if len(at) > PIXELS:
        at = np.random.default_rng(0).choice(at, PIXELS, replace=False)
    x, y = 2 * (at % w + 0.5) / w - 1, 1 - 2 * (at // w + 0.5) / h
    basis = np.stack(term_values(x, y, TERM_COUNTS[degree]), -1)
    goal = values.reshape(-1)[at].astype(np.float64)
    coefficients = np.zeros(TERM_COUNTS[degree] + (along is not None))
    left = goal
    if along is not None:
        basis = np.column_stack([basis, along.reshape(-1)[at]])
        coefficients[-1] = 1.0
        left = goal - basis[:, -1]
    # The commonest value to begin with.
    counts, ends = np.histogram(left, bins=np.arange(left.min() - 1, left.max() + 3, 2.0))
    counts = ndimage.uniform_filter1d(counts.astype(float), 3)
    best = int(counts.argmax())
    coefficients[0] = (ends[best] + ends[best + 1]) / 2
    width = 40.0
    for _ in range(rounds):
        off = goal - basis @ coefficients
        weight = 1 / (1 + (off / width) ** 2) ** 2
        gram = basis.T @ (basis * weight[:, None]) + 1e-9 * np.eye(basis.shape[1])
        coefficients = np.linalg.solve(gram, basis.T @ (weight * goal))
        close = np.abs(off)[weight > 0.25]
        spread = 1.4826 * float(np.median(close)) if len(close) else 1.0
        width = max(0.7 * width, 3 * spread, 1.0)
    rows, columns = np.arange(h), np.arange(w)
    px, py = 2 * (columns + 0.5) / w - 1, 1 - 2 * (rows + 0.5) / h
    grid = np.zeros((degree + 1, degree + 1))
    for coefficient, (i, j) in zip(coefficients, TERM_POWERS[: TERM_COUNTS[degree]], strict=False):
        grid[j, i] = coefficient
    whole = polyvander(py, degree) @ grid @ polyvander(px, degree).T
    slope = 0.0 if along is None else float(coefficients[-1])
    return Field(whole if along is None else whole + slope * along, max(spread, 0.3), slope)


def light_colour(levels: np.ndarray, half: float, valid: np.ndarray) -> np.ndarray:
    """The light's (c,), green 1, in a picture (h, w, c) in levels; ones where it is white, or
    nothing is known of it. ``half`` is half the step between two levels."""
    channels = levels.shape[-1]
    white = np.ones(channels)
    if channels != 3:
        return white
    top, bottom = levels >= LEVELS - half - 0.5, levels <= half

    def against_green(a: int) -> float | None:
        known = valid & ~(top[..., a] | top[..., 1] | bottom[..., a] | bottom[..., 1])
        if known.mean() < 0.02:
            return None
        one, other = levels[..., a].astype(np.float64), levels[..., 1].astype(np.float64)
        found, plain = field(one, known, 2, other), field(one - other, known, 2)
        near = _share(np.abs(one - found.whole) < NEAR * max(1.0, found.slope), known)
        if found.slope <= 0 or near < MOST:
            return None
        # A background that varies as the light does passes for a colour of the light's.
        better = near > _share(np.abs(one - other - plain.whole) < NEAR, known) + MORE
        return found.slope if better else 1.0

    red, blue = parallel_map(against_green, (0, 2))
    if red is None or blue is None:
        return white
    colour = np.array([red, 1.0, blue])
    return colour if np.abs(colour - 1).max() > COLOURED else white


def _share(region: np.ndarray, of: np.ndarray) -> float:
    return np.count_nonzero(region & of) / np.count_nonzero(of)


def segments(
    levels: np.ndarray, half: float, valid: np.ndarray, colour: np.ndarray | None = None
) -> Segments:
    """Regions of a picture (h, w, c) in levels; ``half`` is half the step between two levels,
    ``colour`` (c,) the light's, white if it is not given."""
    h, w, channels = levels.shape
    top, bottom = levels >= LEVELS - half - 0.5, levels <= half
    other, noise, variation = np.zeros((h, w), bool), 0.3, 0.0
    colour = np.ones(channels) if colour is None else colour
    # Against the channel that is lit most, next to which no other's rounding is enlarged.
    b = max((1, 0, 2), key=lambda channel: colour[channel]) if channels == 3 else 0

    def of_another_colour(a: int) -> tuple[np.ndarray, float, float] | None:
        known = valid & ~(top[..., a] | top[..., b] | bottom[..., a] | bottom[..., b])
        if known.mean() < 0.02:
            return None
        difference = levels[..., a].astype(np.float64) - colour[a] / colour[b] * levels[..., b]
        expected, spread, _ = field(difference, known, 2)
        limit = max(LEAST, SPREADS * spread)
        off = difference - expected
        # a clipped at the top is at least so large, b at the bottom at most so small.
        more = (top[..., a] | bottom[..., b]) & ~(top[..., b] | bottom[..., a])
        less = (top[..., b] | bottom[..., a]) & ~(top[..., a] | bottom[..., b])
        neither = (top[..., a] & top[..., b]) | (bottom[..., a] & bottom[..., b])
        wrong = np.abs(off) > limit
        wrong = np.where(more, off > limit, np.where(less, off < -limit, wrong))
        return wrong & ~neither, spread, float(expected.std())

    for found in parallel_map(of_another_colour, [i for i in range(channels) if i != b]):
        if found is not None:
            wrong, spread, varies = found
            other, noise, variation = other | wrong, max(noise, spread), max(variation, varies)
    other = _without_specks(other & valid, SPECK if noise < 1 else 30 * SPECK)
    doubtful = _cut_off(
        levels, other, valid, over_channels(np.logical_or, top), max(SHARP, 4 * noise)
    )
    return Segments(other, doubtful, noise, variation)


def regions(region: np.ndarray) -> tuple[np.ndarray, int]:
    """(h, w) numbers of the connected regions, 0 outside them, and how many there are."""
    label = np.zeros(region.shape, np.int32)
    return label, int(ndimage.label(region, output=label))  # pyright: ignore[reportArgumentType]


def grown(region: np.ndarray, by: int = 1) -> np.ndarray:
    """``region`` (h, w) and what lies within ``by`` steps of it."""
    return np.asarray(ndimage.binary_dilation(region, iterations=by))


def _without_specks(region: np.ndarray, speck: float = SPECK) -> np.ndarray:
    """Without what is a pixel wide, and with holes as small filled."""
    region = np.asarray(ndimage.median_filter(region.astype(np.uint8), 3)) > 0
    label, count = regions(region)
    if not count:
        return region
    size = np.bincount(label.ravel())
    small = size < max(6, speck * region.size)
    return region & ~small[label]


def _cut_off(levels, other, valid, clipped, sharp) -> np.ndarray:
    """What sharp edges cut off from the largest region of the background's colour."""
    bright = over_channels(np.maximum, levels)
    steep = np.zeros(bright.shape, bool)
    for axis in (0, 1):
        step = np.abs(np.diff(bright, axis=axis)) > sharp
        pad = [(0, 1), (0, 0)] if axis == 0 else [(0, 0), (0, 1)]
        steep |= np.pad(step, pad)
        steep |= np.pad(step, [p[::-1] for p in pad])
    ground = ~steep & ~other & valid & ~clipped
    label, count = regions(ground)
    if not count:
        return np.zeros_like(other)
    size = np.bincount(label.ravel())
    size[0] = 0
    main = label == size.argmax()
    rest = ~main & ~other & valid & ~clipped
    # Steep pixels beside the main region are its own rays' edges until a fit says otherwise.
    cut = np.asarray(ndimage.binary_opening(rest & ~grown(main, 2)))
    return _without_specks(cut)


def panels(other: np.ndarray, levels: np.ndarray) -> list[tuple[int, int, int, int]]:
    """(x, y, width, height) of flat rectangles with hard, upright edges among what is ``other``."""
    h, w = other.shape
    found = []
    closed = ndimage.binary_closing(np.pad(other, 12, mode="edge"), iterations=6)
    closed = np.asarray(closed)[12:-12, 12:-12]
    label, _ = regions(closed)
    for number, where in enumerate(ndimage.find_objects(label), 1):
        if where is None:
            continue
        rows, columns = where
        tall, wide = rows.stop - rows.start, columns.stop - columns.start
        if tall * wide < 2e-3 * h * w or min(tall, wide) < 10:
            continue
        inside = np.asarray(ndimage.binary_fill_holes(label[where] == number))
        if inside.mean() < 0.93:
            continue
        # Flat: most of it is of very few colours.
        colours = levels[where].reshape(-1, levels.shape[-1]).astype(np.int64)
        code = np.array([1 << 16, 1 << 8, 1])[: colours.shape[1]]
        _, counts = np.unique(colours @ code, return_counts=True)
        if np.sort(counts)[::-1][:4].sum() > 0.5 * counts.sum():
            found.append((columns.start, rows.start, wide, tall))
    return found

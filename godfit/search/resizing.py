"""Masks as they were before an image program resized them.

A shader read the mask at one size, and a stranger has it at another: its edges are grey then, and
rays of wrong edges are no noise. A resize is linear, and one by little loses nearly nothing: only
what alternates from pixel to pixel, and only where new pixels lie halfway between old ones.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from godfit.io.image import LEVELS
from godfit.io.resampling import KERNELS, kernel_taps

if TYPE_CHECKING:
    from scipy import sparse

MOST_VALUES = 8
"""Values of a mask that is in few colours, at most: a clear colour, a light, and a few objects."""
SAME_BYTE = 1e-3
"""Levels within which values are whole: those of bytes that float32 holds."""
PRIOR = 1e-5
"""Variance of a resized mask's rounding to bytes, as a share of that of a mask's values: 1/12 level
squared of a hundred."""
ROUNDS = 4
"""Corrections of what was undone, for what has values that a mask has."""


class Before(NamedTuple):
    """A ``mask`` (h, w, ...) as it was before a resize, and the ``variance`` of its texels, None
    where nothing is known of it."""

    mask: np.ndarray
    variance: np.ndarray | None = None


def before_resize(mask: np.ndarray, size: tuple[int, int]) -> list[Before]:
    """The ``mask`` (H, W, ...) as it was at ``size`` (h, w), if it was resized from that by each of
    ``KERNELS``, in few colours first where it has few. Empty where it has that size."""
    if mask.shape[:2] == size:
        return []
    whole_bytes = np.abs(mask * LEVELS - np.round(mask * LEVELS)).max() < SAME_BYTE
    values = few_values(mask)

    def allowed(mask: np.ndarray) -> np.ndarray:
        mask = mask.clip(0, 1)
        return np.round(mask * LEVELS) / LEVELS if whole_bytes else mask

    found = []
    for name in KERNELS:
        resize = Resize.of(size, mask.shape[:2], name)
        grey = resize.undone(mask, allowed).astype(np.float32)
        if values is not None:
            few = resize.undone(mask, partial(snapped, values=values)).astype(np.float32)
            # What the resize left undetermined lies between two colours.
            found.append(Before(few, (few - grey) ** 2))
        found.append(Before(grey))
    return found


class Resize(NamedTuple):
    """A resize of rows and of columns: by axis, what is multiplied with, and ``_band`` of it."""

    weights: list[sparse.csr_array]
    bands: list[np.ndarray]

    @staticmethod
    def of(size: tuple[int, ...], resized: tuple[int, ...], name: str) -> Resize:
        weights = [resize_weights(*n, name) for n in zip(size, resized, strict=True)]
        return Resize(weights, [_band(*one) for one in zip(weights, size, strict=True)])

    def undone(
        self, resized: np.ndarray, allowed: Callable[[np.ndarray], np.ndarray]
    ) -> np.ndarray:
        """(h, w, ...) what was ``resized`` (H, W, ...), of ``allowed`` values.

        Kernels that overshoot were clipped to black and white, which only bounds what was there.
        """
        before = allowed(self._solved(resized))
        for _ in range(ROUNDS):
            before = allowed(before + self._solved(self._left(resized, before)))
        return before

    def _left(self, resized: np.ndarray, before: np.ndarray) -> np.ndarray:
        """(H, W, ...) what is left of the ``resized`` mask without what is resized from another."""
        after = before
        for axis, weights in enumerate(self.weights):
            after = _along(axis, after, weights.__matmul__)
        beyond = (resized <= 0) & (after < 0) | (resized >= 1) & (after > 1)
        return np.where(beyond, 0, resized - after)

    def _solved(self, picture: np.ndarray) -> np.ndarray:
        """What is resized to the ``picture``, by least squares."""
        from scipy.linalg import solveh_banded

        for axis, (weights, band) in enumerate(zip(self.weights, self.bands, strict=True)):
            picture = _along(axis, picture, weights.T.__matmul__)
            picture = _along(axis, picture, partial(solveh_banded, band, lower=True))
        return picture


def _along(
    axis: int, picture: np.ndarray, function: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """A ``function`` of columns (n, k), (m, k), applied along one axis."""
    lines = np.moveaxis(picture, axis, 0)
    columns = function(lines.reshape(len(lines), -1))
    return np.moveaxis(columns.reshape(len(columns), *lines.shape[1:]), 0, axis)


def _band(weights: sparse.csr_array, n: int) -> np.ndarray:
    """(k, n) the normal equations under the prior: their diagonals from the main one down."""
    from scipy import sparse

    normal = sparse.dia_array(weights.T @ weights)
    band = np.zeros((int(normal.offsets.max()) + 1, n))
    for k in range(len(band)):
        band[k, : n - k] = normal.diagonal(-k)
    band[0] += PRIOR
    return band


def resize_weights(size: int, resized: int, name: str) -> sparse.csr_array:
    """(resized, size) the weights with which a side of ``size`` pixels becomes one of ``resized``;
    see ``kernel_taps``."""
    from scipy import sparse

    taps, weights = kernel_taps(size, resized, name)
    rows = np.broadcast_to(np.arange(resized)[:, None], taps.shape)
    used = weights != 0
    return sparse.csr_array((weights[used], (rows[used], taps[used])), shape=(resized, size))


def few_values(mask: np.ndarray) -> np.ndarray | None:
    """The values of a mask that was drawn with few colours and without anti-aliasing, and resized:
    those of its flat parts, where a pixel and its neighbours have one value. None where there are
    many."""
    from scipy import ndimage

    around = (3, 3) + (1,) * (mask.ndim - 2)
    flat = ndimage.maximum_filter(mask, around) == ndimage.minimum_filter(mask, around)
    values = np.unique(mask[flat])
    return values if 0 < len(values) <= MOST_VALUES else None


def snapped(mask: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The ``mask`` with each value replaced by the nearest of ``values``: as it was before a resize
    made its edges grey."""
    middles = (values[1:] + values[:-1]) / 2
    return values[np.searchsorted(middles, mask)].astype(np.float32)

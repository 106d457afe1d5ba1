"""How image programs resize a picture: kernels, their weights along one side, and a resize of both
that is undone by least squares."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from scipy import sparse

PRIOR = 1e-5
"""Variance of a resized mask's rounding to bytes, as a share of that of a mask's values: 1/12 level
squared of a hundred."""
ROUNDS = 4
"""Corrections of what was undone, for what has values that a mask has."""


def _bilinear(x: np.ndarray) -> np.ndarray:
    return np.maximum(1 - np.abs(x), 0)


def _bicubic(x: np.ndarray, a: float = -0.5) -> np.ndarray:
    """Keys, IEEE ASSP 29 (1981), eq. 8; a = -1/2 is his choice, eq. 15."""
    x = np.abs(x)
    near, far = ((a + 2) * x - (a + 3)) * x * x + 1, a * (((x - 5) * x + 8) * x - 4)
    return np.where(x < 1, near, np.where(x < 2, far, 0))


def _lanczos(x: np.ndarray, lobes: int = 3) -> np.ndarray:
    """Lanczos (Duchon, J. Appl. Meteorology 18 (1979))."""
    return np.where(np.abs(x) < lobes, np.sinc(x) * np.sinc(x / lobes), 0)


def _box(x: np.ndarray) -> np.ndarray:
    """The mean of the pixels within; the nearest neighbour, where a picture is enlarged."""
    return ((x > -0.5) & (x <= 0.5)).astype(float)


def _overlap(x: np.ndarray, scale: float) -> np.ndarray:
    """The part of a pixel that lies within another picture's pixel of ``scale`` times its size."""
    ends = np.minimum(0.5, x + scale / 2) - np.maximum(-0.5, x - scale / 2)
    return np.maximum(ends, 0) / scale


def _wider(kernel: Callable[[np.ndarray], np.ndarray]) -> Kernel:
    """A kernel that is as much wider as a picture is made smaller, so that every pixel counts."""
    return lambda x, scale: kernel(x / max(scale, 1.0))


def _as_wide(kernel: Callable[[np.ndarray], np.ndarray]) -> Kernel:
    """A kernel that drops pixels where a picture is made smaller."""
    return lambda x, scale: kernel(x)


Kernel = Callable[[np.ndarray, float], np.ndarray]
"""Weights by distance in pixels, and by how many pixels were made one."""
KERNELS: dict[str, tuple[Kernel, float]] = {
    "box": (_wider(_box), 0.5),
    "bilinear": (_wider(_bilinear), 1.0),
    "bicubic": (_wider(_bicubic), 2.0),
    "lanczos": (_wider(_lanczos), 3.0),
    "area": (_overlap, 1.0),
    "two taps": (_as_wide(_bilinear), 1.0),
    "four taps": (_as_wide(partial(_bicubic, a=-0.75)), 2.0),
    "eight taps": (_as_wide(partial(_lanczos, lobes=4)), 4.0),
}
"""Kernels by name, and how many pixels each reaches to either side; a smaller picture's pixels each
take as many more of the larger's."""
ROUNDED_TWICE = ("box", "bilinear", "bicubic", "lanczos")
"""Kernels of programs that round to bytes after the rows and after the columns, as Pillow does."""
ROUNDED_ONCE = (
    "bilinear", "bicubic", "lanczos", "area", "two taps", "four taps", "eight taps",
)  # fmt: skip
"""Kernels of programs that round at the end alone. The last four are OpenCV's."""


def kernel_taps(size: int, resized: int, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(resized, k) the pixels that make up each pixel of a side of ``resized`` ones, and their
    weights, where the side had ``size``; and (resized,) whether all of them are in the picture.

    Pixel centres lie at i + 1/2. Beyond the edge there is nothing: such taps have no weight.
    """
    kernel, reach = KERNELS[name]
    scale = size / resized
    wide = reach * max(scale, 1.0)
    centre = (np.arange(resized) + 0.5) * scale - 0.5
    taps = np.floor(centre - wide)[:, None] + np.arange(int(2 * wide) + 2)
    weights = kernel(taps - centre[:, None], scale)
    there = (taps >= 0) & (taps < size)
    inside = (there | (weights == 0)).all(1)
    weights = weights * there
    weights /= weights.sum(1, keepdims=True)
    return taps.clip(0, size - 1).astype(int), weights, inside


class Resize(NamedTuple):
    """A resize of rows and of columns: by axis, what is multiplied with, ``_band`` of it, and which
    of the new lines do not depend on what a program assumes beyond the edge."""

    weights: list[sparse.csr_array]
    bands: list[np.ndarray]
    inside: list[np.ndarray]

    @staticmethod
    def of(size: tuple[int, ...], resized: tuple[int, ...], name: str) -> Resize:
        taps = [kernel_taps(*n, name) for n in zip(size, resized, strict=True)]
        weights = [_matrix(*one[:2], n) for one, n in zip(taps, size, strict=True)]
        bands = [_band(*one) for one in zip(weights, size, strict=True)]
        return Resize(weights, bands, [inside for _, _, inside in taps])

    def interior(self) -> np.ndarray:
        """(h, w) the pixels that no line has of those that are not ``inside``."""
        rows, columns = (
            abs(weights[~inside]).sum(0) == 0
            for weights, inside in zip(self.weights, self.inside, strict=True)
        )
        return rows[:, None] & columns

    def made(self, before: np.ndarray) -> np.ndarray:
        """(H, W, ...) what a picture (h, w, ...) becomes, before it is rounded or clipped."""
        for axis, weights in enumerate(self.weights):
            before = _along(axis, before, weights.__matmul__)
        return before

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
        after = self.made(before)
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
    return picture_of(function(columns_of(picture, axis)), axis, picture.shape)


def columns_of(picture: np.ndarray, axis: int) -> np.ndarray:
    """(n, k) the values of a ``picture`` along one axis, in a column each."""
    lines = np.moveaxis(picture, axis, 0)
    return lines.reshape(len(lines), -1)


def picture_of(columns: np.ndarray, axis: int, shape: tuple[int, ...]) -> np.ndarray:
    """The picture of which these are the ``columns_of``; its other sides are those of ``shape``."""
    others = shape[:axis] + shape[axis + 1 :]
    return np.moveaxis(columns.reshape(len(columns), *others), 0, axis)


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
    taps, weights, _ = kernel_taps(size, resized, name)
    return _matrix(taps, weights, size)


def _matrix(taps: np.ndarray, weights: np.ndarray, size: int) -> sparse.csr_array:
    """(resized, size) the ``weights`` (resized, k) at their ``taps``."""
    from scipy import sparse

    rows = np.broadcast_to(np.arange(len(taps))[:, None], taps.shape)
    used = weights != 0
    return sparse.csr_array((weights[used], (rows[used], taps[used])), shape=(len(taps), size))

"""Kernels with which image programs resize a picture, and their weights along one side."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def _bilinear(x: np.ndarray) -> np.ndarray:
    return np.maximum(1 - np.abs(x), 0)


def _bicubic(x: np.ndarray) -> np.ndarray:
    """Keys, IEEE ASSP 29 (1981), eq. 15: a = -1/2."""
    x = np.abs(x)
    near, far = (1.5 * x - 2.5) * x * x + 1, ((2.5 - 0.5 * x) * x - 4) * x + 2
    return np.where(x < 1, near, np.where(x < 2, far, 0))


def _lanczos(x: np.ndarray) -> np.ndarray:
    """Lanczos with three lobes (Duchon, J. Appl. Meteorology 18 (1979))."""
    return np.where(np.abs(x) < 3, np.sinc(x) * np.sinc(x / 3), 0)


def _box(x: np.ndarray) -> np.ndarray:
    """The mean of the pixels within; the nearest neighbour, where a picture is enlarged."""
    return ((x > -0.5) & (x <= 0.5)).astype(float)


Kernel = Callable[[np.ndarray], np.ndarray]
KERNELS: dict[str, tuple[Kernel, float]] = {
    "box": (_box, 0.5),
    "bilinear": (_bilinear, 1.0),
    "bicubic": (_bicubic, 2.0),
    "lanczos": (_lanczos, 3.0),
}
"""Kernels by name, and how many pixels each reaches to either side; a smaller picture's pixels each
take as many more of the larger's."""


def kernel_taps(size: int, resized: int, name: str) -> tuple[np.ndarray, np.ndarray]:
    """(resized, k) the pixels that make up each pixel of a side of ``resized`` ones, and their
    weights, where the side had ``size``.

    Pixel centres lie at i + 1/2. Beyond the edge there is nothing: such taps have no weight.
    """
    kernel, reach = KERNELS[name]
    scale = size / resized
    wide = max(scale, 1.0)
    centre = (np.arange(resized) + 0.5) * scale - 0.5
    taps = np.floor(centre - reach * wide)[:, None] + np.arange(int(2 * reach * wide) + 2)
    weights = kernel((taps - centre[:, None]) / wide) * ((taps >= 0) & (taps < size))
    weights /= weights.sum(1, keepdims=True)
    return taps.clip(0, size - 1).astype(int), weights

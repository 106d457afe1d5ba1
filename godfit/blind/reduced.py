"""A small copy of a finished picture, in values to which the light pass adds.

A scene S and a light pass L make a picture S + L where the shader adds, and 1 - (1 - S)(1 - L)
where it blends by "screen". The logarithm of 1 minus the picture is then a sum again, as long as
the values are linear.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from godfit.io.filters import over_channels, shrink
from godfit.io.image import LEVELS, decode
from godfit.scattering.conventions import Convention

SIDE = 320
"""Pixels of the copy's longer side: rays are many pixels wide there, and a cost takes half a
millisecond."""
CLIPPED_LEVEL = 253.5
"""Level of a byte from which a value is taken as clipped: browsers round the last one down."""
LARGEST_SCREENED = 0.985
"""Largest linear value whose logarithm is used: above it a byte is a large step of light."""
SCREENED_UNIT = 4.0
"""Divisor of the logarithm, -ln(1 - LARGEST_SCREENED) rounded: values then lie from 0 to 1."""


class Reduced(NamedTuple):
    """``values`` (h, w, 3) to which the light pass adds, 1 the brightest; ``valid`` (h, w) pixels
    that the user did not exclude, and that lie in no panel; ``clipped`` (h, w) those that were at
    the top of the scale in some channel."""

    values: np.ndarray
    valid: np.ndarray
    clipped: np.ndarray

    @property
    def usable(self) -> np.ndarray:
        """(h, w) pixels whose value is known."""
        return self.valid & ~self.clipped


def reduced(levels: np.ndarray, valid: np.ndarray, convention: Convention) -> Reduced:
    """The copy of a picture (h, w, c) in 8-bit levels of its encoding, averaged over cells."""
    h, w, channels = levels.shape
    factor = max(1.0, max(h, w) / SIDE)
    size = max(1, round(h / factor)), max(1, round(w / factor))
    clipped = shrink(clipped_pixels(levels).astype(np.float32), size) > 0
    values = additive(levels / np.float32(LEVELS), convention)
    copy = np.broadcast_to(shrink(values, size), (*size, max(3, channels)))
    inside = shrink(valid.astype(np.float32), size) > 0.999
    return Reduced(np.ascontiguousarray(copy, np.float64), inside, clipped)


def clipped_pixels(levels: np.ndarray) -> np.ndarray:
    """(h, w) pixels of a picture (h, w, c) that are at the top of the scale in some channel."""
    return over_channels(np.logical_or, levels >= CLIPPED_LEVEL)


def additive(values: np.ndarray, convention: Convention) -> np.ndarray:
    """Encoded values (h, w, c) in a scale in which scene and light pass of a shader add up."""
    if convention.blend != "screen":
        return values
    linear = np.clip(decode(np.asarray(values, np.float32), "srgb"), 0, LARGEST_SCREENED)
    return np.asarray(-np.log(1 - linear) / np.float32(SCREENED_UNIT))

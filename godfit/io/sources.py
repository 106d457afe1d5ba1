"""Images as users give them: files, arrays, and masks made from them."""

from __future__ import annotations

import os

import numpy as np

from godfit.errors import InputError
from godfit.io.filters import shrink
from godfit.io.image import Image, decode, read_image

MAX_SAMPLE = 1e12
"""Largest value that is fitted: the sum of the squares of 2^29 values is finite in float32."""
Source = str | os.PathLike[str] | np.ndarray | Image


def read_source(source: Source, transfer: str) -> Image:
    """The image of a path or an array; an ``Image`` is returned as it is.

    Arrays (h, w) or (h, w, 3) hold encoded values: bytes and 16-bit integers up to their largest,
    floats up to 1. Raises InputError for other shapes, and for numbers that are not finite.
    """
    if isinstance(source, Image):
        return _checked_size(source)
    if isinstance(source, (str, os.PathLike)):
        return _checked_size(read_image(source, transfer=transfer))
    array = np.asarray(source)
    if array.ndim not in (2, 3) or array.shape[2:] not in ((), (3,)) or 0 in array.shape:
        raise InputError(f"image: expected shape (h, w) or (h, w, 3), got {array.shape}")
    quantum = {np.dtype(np.uint8): 1 / 255, np.dtype(np.uint16): 1 / 65535}.get(array.dtype)
    top = 1.0 if quantum is None else round(1 / quantum)
    values = (array.astype(np.float64) / top).astype(np.float32)
    if not np.isfinite(values).all():
        raise InputError("image: expected finite numbers, got NaN or infinity")
    return _checked_size(Image(np.asarray(decode(values, transfer)), quantum, transfer, "", ""))


def _checked_size(image: Image) -> Image:
    """The image; raises InputError where sums of its squares are not finite in float32."""
    values = image.values
    if values.size and max(values.max(), -values.min()) > MAX_SAMPLE:
        raise InputError(
            f"{image.path or 'image'}: expected values of at most {MAX_SAMPLE:g}, got "
            f"{abs(values).max():.3g}; scale them first"
        )
    return image


def occluder_mask(occluder: Image, target: Image) -> np.ndarray:
    """(h, w) True where the occluder's image is not black. Raises InputError for a size other than
    the target's."""
    (h, w), (height, width) = target.values.shape[:2], occluder.values.shape[:2]
    if (h, w) != (height, width):
        raise InputError(
            f"occluder: expected the target's {w}x{h} pixels, got {width}x{height}; "
            "draw it over the target"
        )
    return np.asarray((np.atleast_3d(occluder.values) > 0).any(-1))


def shrink_mask(mask: np.ndarray, pass_scale: float) -> np.ndarray:
    """The mask (h, w, ...) averaged over cells to the light pass's size, ``pass_scale`` of its own.

    Raises InputError for a scale that is not above 0 and at most 1.
    """
    if not 0 < pass_scale <= 1:
        raise InputError(f"pass scale: expected a number above 0, at most 1, got {pass_scale:g}")
    if pass_scale == 1:
        return mask
    h, w = (max(1, round(n * pass_scale)) for n in mask.shape[:2])
    return shrink(mask, (h, w))

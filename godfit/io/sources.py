"""Images as users give them: files, arrays, and masks made from them."""

from __future__ import annotations

import os

import numpy as np

from godfit.errors import InputError
from godfit.io.filters import shrink
from godfit.io.image import Image, decode, read_image

Source = str | os.PathLike[str] | np.ndarray | Image


def read_source(source: Source, transfer: str) -> Image:
    """The image of a path or an array; an ``Image`` is returned as it is.

    Arrays (h, w) or (h, w, 3) hold encoded values: bytes and 16-bit integers up to their largest,
    floats up to 1. Raises InputError for other shapes, and for numbers that are not finite.
    """
    if isinstance(source, Image):
        return source
    if isinstance(source, (str, os.PathLike)):
        return read_image(source, transfer=transfer)
    array = np.asarray(source)
    if array.ndim not in (2, 3) or array.shape[2:] not in ((), (3,)) or 0 in array.shape:
        raise InputError(f"image: expected shape (h, w) or (h, w, 3), got {array.shape}")
    quantum = {np.dtype(np.uint8): 1 / 255, np.dtype(np.uint16): 1 / 65535}.get(array.dtype)
    top = 1.0 if quantum is None else round(1 / quantum)
    values = (array.astype(np.float64) / top).astype(np.float32)
    if not np.isfinite(values).all():
        raise InputError("image: expected finite numbers, got NaN or infinity")
    return Image(np.asarray(decode(values, transfer)), quantum, transfer, "", "")


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

    Raises InputError as ``pass_size`` does.
    """
    size = pass_size(mask.shape[:2], pass_scale)
    return mask if size == mask.shape[:2] else shrink(mask, size)


def pass_size(size: tuple[int, ...], pass_scale: float) -> tuple[int, int]:
    """Height and width of a light pass whose mask has ``size`` (height, width), in whole pixels.

    Raises InputError for a scale that is not above 0 and at most 1.
    """
    if not 0 < pass_scale <= 1:
        raise InputError(f"pass scale: expected a number above 0, at most 1, got {pass_scale:g}")
    height, width = (max(1, round(n * pass_scale)) for n in size)
    return height, width

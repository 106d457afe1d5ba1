"""Images as users give them: files, arrays, and masks made from them."""

from __future__ import annotations

import dataclasses
import os
from typing import Any

import numpy as np

from godfit.errors import InputError
from godfit.io.arrays import host_array, levels_of
from godfit.io.filters import shrink
from godfit.io.image import Image, decode, not_finite, quantum_of, read_image, with_alpha

MAX_SAMPLE = 1e12
"""Largest value that is fitted: the sum of the squares of 2^29 values is finite in float32."""
Source = Any
"""An image as users give it: a file's name, an ``Image``, or an array of any library."""


FLIPS: dict[str, tuple[str, tuple[int, ...]]] = {
    "vertical": ("upside down", (0,)),
    "horizontal": ("mirrored", (1,)),
    "both": ("turned by 180 degrees", (0, 1)),
}
"""How a target may be turned against its mask, by the value of --flip: in words, and the axes."""


def turned(image: Image, flip: str | None) -> Image:
    """The image turned over as ``flip``, a key of ``FLIPS``, says; as it is for None."""
    if flip is None:
        return image
    axes = FLIPS[flip][1]
    rounding = image.rounding
    if rounding is not None:
        rounding = np.flip(rounding[0], axes), np.flip(rounding[1], axes)
    values = np.ascontiguousarray(np.flip(image.values, axes))
    return dataclasses.replace(image, values=values, rounding=rounding)


def read_source(
    source: Source, transfer: str, name: str = "image", *, finite: bool = True
) -> Image:
    """The image of a path or an array; an ``Image`` is returned as it is.

    Arrays (h, w) or (h, w, 3) hold encoded values: bytes and 16-bit integers up to their largest,
    floats up to 1. Floats that are all bytes divided by 255, as some readers return them, are
    bytes. Raises InputError for other shapes and scales, and where ``finite`` for numbers that are
    not. ``name`` says in errors what the image is.
    """
    if isinstance(source, Image):
        return _checked_size(source)
    if isinstance(source, (str, os.PathLike)):
        return _checked_size(read_image(source, transfer=transfer, finite=finite))
    array = host_array(source, name)
    if array.ndim not in (2, 3) or array.shape[2:] not in ((), (1,), (3,), (4,)):
        raise InputError(f"{name}: expected shape (h, w) or (h, w, 3), got {array.shape}")
    if 0 in array.shape:
        raise InputError(f"{name}: expected shape (h, w) or (h, w, 3), got {array.shape}")
    values, quantum = levels_of(array, name)
    notes, alpha = (), None
    if values.ndim == 3 and values.shape[2] == 4:
        values, alpha = values[..., :3], values[..., 3]
    if values.ndim == 3 and values.shape[2] == 1:
        values = values[..., 0]
    bad = np.asarray(~np.isfinite(values))
    if finite and bad.any():
        raise InputError(f"{name}: {not_finite(bad)}")
    if quantum is None and array.dtype.kind == "f" and not bad.any():
        quantum = quantum_of(values)
    image = Image(np.asarray(decode(values, transfer)), quantum, transfer, "", "", notes)
    return _checked_size(image if alpha is None else with_alpha(image, alpha))


def _checked_size(image: Image) -> Image:
    """The image; raises InputError where sums of its squares are not finite in float32."""
    values = image.values
    largest = max(values.max(), -values.min()) if values.size else 0.0
    # What is not finite is reported by whoever needs it to be.
    if np.isfinite(largest) and largest > MAX_SAMPLE:
        raise InputError(
            f"{image.path or 'image'}: expected values of at most {MAX_SAMPLE:g}, got "
            f"{largest:.3g}; scale them first"
        )
    return image


def without_holes(target: Image, valid: np.ndarray | None, name: str = "target") -> Image:
    """The target with zeros where it is not finite. Raises InputError where one of those pixels is
    not among the ignored ones, ``valid`` (h, w) False."""
    bad = np.asarray(~np.isfinite(target.values))
    if not bad.any():
        return target
    used = np.asarray(bad.reshape(*bad.shape[:2], -1).any(-1))
    if valid is not None and valid.shape == used.shape:
        used = used & valid
    if used.any():
        raise InputError(f"{target.path or name}: {not_finite(used)}")
    return dataclasses.replace(target, values=np.where(bad, np.float32(0), target.values))


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

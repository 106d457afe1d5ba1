"""A fit of the light in the plane: its arguments checked, its model and its picture set up."""

from __future__ import annotations

import dataclasses
import hashlib
import os
from pathlib import Path

import numpy as np

# Importing this registers the search.
import godfit.flatland.starts  # noqa: F401
from godfit.errors import InputError
from godfit.flatland.canvas import Canvas, read_canvas
from godfit.flatland.model import FIT_RAYS, Flatland, basis
from godfit.flatland.sky import Sky
from godfit.inference.observation import Picture
from godfit.io.image import Image

MAX_FIT_RAYS = 1024
"""Rays of a pixel in a fit, which holds one number for every pixel and ray."""

MAX_BASIS_VALUES = 1 << 31
"""Numbers that a fit holds for all pixels and rays: 8 GiB of float32."""

CanvasSource = str | os.PathLike[str] | Canvas
"""The path of a canvas's file, or a canvas."""


def prepare_fit(
    target: Image, source: CanvasSource, rays: int | None, valid: np.ndarray | None
) -> tuple[Flatland, Picture, Image]:
    """The model with default parameters, the picture with the canvas's ``basis`` in place of a
    mask, and a record of the canvas's file: an image without pixels, its path and digest.

    ``valid`` (h, w) is False at ignored pixels. Raises InputError.
    """
    rays = FIT_RAYS if rays is None else rays
    if not 1 <= rays <= MAX_FIT_RAYS:
        raise InputError(f"rays: expected a whole number from 1 to {MAX_FIT_RAYS}, got {rays}")
    record = Image(np.zeros((1, 1), np.float32), None, "none", "", "")
    canvas = source if isinstance(source, Canvas) else read_canvas(source)
    if not isinstance(source, Canvas):
        name = os.fsdecode(source)
        digest = hashlib.sha256(Path(name).read_bytes()).hexdigest()
        record = Image(record.values, None, "none", name, digest)
    size = target.values.shape[:2]
    if canvas.size != size:
        raise InputError(
            f"canvas: expected the target's {size[1]}x{size[0]} pixels, got "
            f"{canvas.size[1]}x{canvas.size[0]}; draw it for the same frame"
        )
    if size[0] * size[1] * (rays + 3) > MAX_BASIS_VALUES:
        raise InputError(
            f"rays: expected at most {MAX_BASIS_VALUES // (size[0] * size[1]) - 3} for "
            f"{size[1]}x{size[0]} pixels, got {rays}; give fewer or a smaller target"
        )
    if valid is not None and not valid.any():
        raise InputError("ignore: expected pixels to be left, got all of them ignored; ignore less")
    picture = Picture.make(target, record.values, None, valid, 3)
    picture = dataclasses.replace(picture, mask=basis(canvas, rays))
    return Flatland(1.0, Sky(), rays), picture, record

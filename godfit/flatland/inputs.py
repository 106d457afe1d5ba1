"""What the fit and the command line are given for the light in the plane, or one line that says why
not."""

from __future__ import annotations

import dataclasses
import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from godfit.errors import InputError
from godfit.flatland.canvas import Canvas, read_canvas
from godfit.flatland.drawing import read_drawing
from godfit.flatland.model import PARAMETERS, RAYS, Flatland, basis
from godfit.flatland.rendering import render
from godfit.flatland.sky import ANGLE, SKY, SUN, WIDTH, Sky, check_sky
from godfit.inference.observation import Picture
from godfit.io.image import Image

# A fit holds one number for every pixel and ray.
MOST_RAYS = 1024
LARGEST_BASIS = 1 << 31
# Of a render, beside sky and exposure.
OPTIONS = ("rays", "method", "steps", "jitter", "grain", "seed", "published")

Source = str | os.PathLike[str] | Canvas


def prepared(
    target: Image, source: Source, rays: int | None, valid: np.ndarray | None
) -> tuple[Flatland, Picture, Image]:
    """The model at no particular point, the picture with what a canvas gives every pixel in place
    of a mask, and a record of the canvas's file."""
    rays = RAYS if rays is None else rays
    if not 1 <= rays <= MOST_RAYS:
        raise InputError(f"rays: expected a whole number from 1 to {MOST_RAYS}, got {rays}")
    record = Image(np.zeros((1, 1), np.float32), None, "none", "", "")
    made = source if isinstance(source, Canvas) else read_canvas(source)
    if not isinstance(source, Canvas):
        name = os.fsdecode(source)
        digest = hashlib.sha256(Path(name).read_bytes()).hexdigest()
        record = Image(record.values, None, "none", name, digest)
    size = target.values.shape[:2]
    if made.size != size:
        raise InputError(
            f"canvas: expected the target's {size[1]}x{size[0]} pixels, got "
            f"{made.size[1]}x{made.size[0]}; draw it for the same frame"
        )
    if size[0] * size[1] * (rays + 3) > LARGEST_BASIS:
        raise InputError(
            f"rays: expected at most {LARGEST_BASIS // (size[0] * size[1]) - 3} for "
            f"{size[1]}x{size[0]} pixels, got {rays}; give fewer or a smaller target"
        )
    if valid is not None and not valid.any():
        raise InputError("ignore: expected pixels to be left, got all of them ignored; ignore less")
    picture = Picture.make(target, record.values, None, valid, 3)
    picture = dataclasses.replace(picture, mask=basis(made, rays))
    return Flatland(1.0, Sky(), rays), picture, record


def rendered(path: str, given: Mapping[str, Any]) -> np.ndarray:
    """The picture of the canvas at ``path``, (h, w, 3), not clamped: ``given`` has OPTIONS,
    sun_angle, sun_width, sun, sky and exposure, or parameters under the names that a fit gives
    them; what is left out is the drawing's, or the published sky's."""
    settings: dict[str, Any] = {}
    if path.endswith(".toml"):
        drawing = read_drawing(path)
        settings, made = dict(drawing.settings), drawing.drawn()
    else:
        made = read_canvas(path)
    settings |= {k: v for k, v in given.items() if v is not None}
    for row in PARAMETERS[3:]:
        name, channel = row.name.split("_")
        if row.name in settings and given.get(name) is None:
            colour = list(settings.get(name, (0.0, 0.0, 0.0)))
            colour["rgb".index(channel)] = settings[row.name]
            settings[name] = tuple(colour)
    sky = (
        settings.get("sun_angle", ANGLE), settings.get("sun_width", WIDTH),
        settings.get("sun", SUN), settings.get("sky", SKY),
    )  # fmt: skip
    check_sky(*sky)
    exposure = settings.get("exposure", 1.0)
    if not 0 <= exposure < np.inf:
        raise InputError(f"exposure: expected a finite number of 0 or more, got {exposure:g}")
    options: dict[str, Any] = {"rays": RAYS}
    options |= {k: settings[k] for k in OPTIONS if k in settings}
    return np.asarray(render(made, Sky(*sky), exposure=exposure, **options))

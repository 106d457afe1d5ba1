"""The picture of a canvas file, from settings by name: a user's, a fit's or the file's own."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from godfit.errors import InputError
from godfit.flatland.canvas import read_canvas
from godfit.flatland.drawing import read_drawing
from godfit.flatland.model import FIT_RAYS, PLANE_PARAMETERS
from godfit.flatland.rendering import RenderOptions, render
from godfit.flatland.sky import (
    SKY_RADIANCE,
    SUN_ANGLE,
    SUN_RADIANCE,
    SUN_WIDTH,
    Sky,
    check_sky,
)

OPTION_NAMES = tuple(
    field.name for field in dataclasses.fields(RenderOptions) if field.name != "plain"
)
"""Options of ``render`` that a user can set, beside the sky and the exposure."""


def render_file(path: str, given: Mapping[str, Any]) -> np.ndarray:
    """The picture of the canvas at ``path``, (h, w, 3), not clamped.

    ``given`` has OPTION_NAMES, sun_angle, sun_width, sun, sky and exposure, or parameters by the
    names that a fit gives them, in degrees and linear radiance. What is missing is the drawing's,
    or the published sky's. Raises InputError.
    """
    settings: dict[str, Any] = {}
    if path.endswith(".toml"):
        drawing = read_drawing(path)
        settings, canvas = dict(drawing.settings), drawing.drawn()
    else:
        canvas = read_canvas(path)
    settings |= {k: v for k, v in given.items() if v is not None}
    for parameter in PLANE_PARAMETERS[3:]:
        name, channel = parameter.name.split("_")
        if parameter.name in settings and given.get(name) is None:
            colour = list(settings.get(name, (0.0, 0.0, 0.0)))
            colour["rgb".index(channel)] = settings[parameter.name]
            settings[name] = tuple(colour)
    sky = (
        settings.get("sun_angle", SUN_ANGLE), settings.get("sun_width", SUN_WIDTH),
        settings.get("sun", SUN_RADIANCE), settings.get("sky", SKY_RADIANCE),
    )  # fmt: skip
    check_sky(*sky)
    exposure = settings.get("exposure", 1.0)
    if not 0 <= exposure < np.inf:
        raise InputError(f"exposure: expected a finite number of 0 or more, got {exposure:g}")
    options: dict[str, Any] = {"rays": FIT_RAYS}
    options |= {k: settings[k] for k in OPTION_NAMES if k in settings}
    return np.asarray(render(canvas, Sky(*sky), exposure=exposure, **options))

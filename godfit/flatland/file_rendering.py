"""The picture of a canvas file, from settings by name: a user's, a fit's or the file's own."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from godfit.errors import InputError
from godfit.flatland.accumulate import accumulated
from godfit.flatland.canvas import Canvas, read_canvas
from godfit.flatland.drawing import read_drawing
from godfit.flatland.model import FIT_RAYS, PLANE_PARAMETERS
from godfit.flatland.published import PUBLISHED, GlobalIllumination, render_published
from godfit.flatland.rendering import RenderOptions, check_film_grain, film_grain_of, render
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

SKY_NAMES = ("sun_angle", "sun_width", "sun", "sky")
"""Settings of the sky, all with values of their own in the published gi pass too."""

FRAME_NAMES = ("frames", "accumulate")
"""Settings of what has frames: how many, and how they are accumulated."""


def option_names(published: str | None) -> tuple[str, ...]:
    """Settings of ``render_file`` that mean something to a published shader, or without one.

    Raises InputError for a name that no published shader has.
    """
    common = ("exposure", "film_grain", "seed")
    if published is None:
        return *common, *OPTION_NAMES, *SKY_NAMES, *FRAME_NAMES
    if published not in PUBLISHED:
        raise InputError(f"published: expected {' or '.join(PUBLISHED)}, got {published!r}")
    own = tuple(field.name for field in dataclasses.fields(PUBLISHED[published]))
    # The naive march has no time, so that its frames are all alike.
    return (*common, *own, *FRAME_NAMES) if "time" in own else (*common, *own)


def render_file(path: str, given: Mapping[str, Any]) -> np.ndarray:
    """The picture of the canvas at ``path``, (h, w, 3), not clamped.

    ``given`` may have the published shader's name and ``option_names`` of it, or parameters by the
    names that a fit gives them, in degrees and linear radiance. What is missing is the drawing's,
    or the default. Frames are those of consecutive seeds, or of consecutive times of a published
    shader. Raises InputError.
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
    exposure, frames = settings.get("exposure", 1.0), settings.get("frames", 1)
    if not 0 <= exposure < np.inf:
        raise InputError(f"exposure: expected a finite number of 0 or more, got {exposure:g}")
    if frames < 1:
        raise InputError(f"frames: expected 1 or more, got {frames}")
    published = settings.get("published")
    draw = _published_frame if published else _own_frame
    frame = draw(canvas, settings)
    how = settings.get("accumulate", "mix" if published else "mean")
    return np.asarray(accumulated(map(frame, range(frames)), how))


def _own_frame(canvas: Canvas, settings: dict[str, Any]) -> Callable[[int], Any]:
    """Frame k of godfit's own methods: that of the k-th seed."""
    sky = (
        settings.get("sun_angle", SUN_ANGLE), settings.get("sun_width", SUN_WIDTH),
        settings.get("sun", SUN_RADIANCE), settings.get("sky", SKY_RADIANCE),
    )  # fmt: skip
    check_sky(*sky)
    options: dict[str, Any] = {"rays": FIT_RAYS, "seed": 0}
    options |= {k: settings[k] for k in OPTION_NAMES if k in settings}
    if settings.get("frames", 1) > 1 and not (options.get("jitter") or options.get("film_grain")):
        raise InputError(
            "frames: expected jitter or film grain, got neither, so that all are alike; "
            "add one of them"
        )
    exposure = settings.get("exposure", 1.0)
    return lambda k: render(
        canvas, Sky(*sky), exposure=exposure, **options | {"seed": options["seed"] + k}
    )


def _published_frame(canvas: Canvas, settings: dict[str, Any]) -> Callable[[int], Any]:
    """Frame k of a published shader: that of the k-th time, with film grain of the k-th seed."""
    make = PUBLISHED[settings["published"]]
    names = [field.name for field in dataclasses.fields(make)]
    shader = make(**{name: settings[name] for name in names if name in settings})
    exposure, seed = settings.get("exposure", 1.0), settings.get("seed", 0)
    sigma = settings.get("film_grain", 0.0)
    check_film_grain(sigma)

    def frame(k: int) -> np.ndarray:
        later = shader
        if isinstance(shader, GlobalIllumination):
            later = dataclasses.replace(shader, time=shader.time + k)
        light = exposure * render_published(canvas, later)
        return light + np.asarray(film_grain_of(jnp.asarray(light), sigma, seed + k))

    return frame

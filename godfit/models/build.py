"""Models from settings: Mitchell's sum, a scene's own mask, or daylight.

A *template* is a model of the right kind at no particular point, as a fit starts from. The
functions ``mitchell_at`` and ``daylight_at`` return a model at given values, as a rendering needs
it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from godfit.errors import InputError, shown
from godfit.models.atmosphere import Air
from godfit.models.base import AbstractModel
from godfit.models.hoffman_preetham import HoffmanPreetham, View
from godfit.models.mitchell import BLACK, EDGE, Mitchell
from godfit.models.staged import Staged
from godfit.models.tinted import TintedMask
from godfit.scattering.conventions import convention
from godfit.scattering.parameters import is_light
from godfit.scenes.labels import FIRST_OBJECT_LABEL
from godfit.scenes.scene import MAX_SAMPLES, MIN_SAMPLES, Scene
from godfit.scenes.view import visible_surfaces

DEFAULT_FOV = 60.0
"""Vertical field of view of a daylight picture, in degrees, where none is given: the default of
Unity's cameras."""
DEFAULT_DISTANCE = 1000.0
"""Distance of a daylight picture's surfaces, in metres, where none is given: over a kilometre clear
air begins to be visible."""
DEFAULT_AVERAGE_SAMPLES = 100
"""Taps that the occlusion of daylight is averaged over, where none are given; as many as a shader
without a published number takes."""
MAX_LIGHTS = 8
"""Largest number of lights of one picture."""


def check_values(model: AbstractModel, values: Mapping[str, float], option: str) -> None:
    """Raise InputError, in the name of ``option``, for a value outside its parameter's bounds."""
    for name, value in values.items():
        row = model.parameters[name]
        if not (row.lower <= value <= row.upper and np.isfinite(value)):
            raise InputError(
                f"{option}: expected {name} from {row.lower:g} to {row.upper:g}, got {value:g}"
            )


def _check_samples(samples: int | None) -> None:
    if samples is not None and not MIN_SAMPLES <= samples <= MAX_SAMPLES:
        raise InputError(
            f"samples: expected a whole number from {MIN_SAMPLES} to {MAX_SAMPLES}, got {samples}"
        )


def mitchell_template(
    shader: str, samples: int | None, lights: int, border: str = EDGE
) -> Mitchell:
    """Mitchell's sum with a number of ``lights``, at no particular point. ``samples`` None is the
    shader's own number; ``border`` as in ``Mitchell``. Raises InputError for numbers out of
    range."""
    _check_samples(samples)
    if not 1 <= lights <= MAX_LIGHTS:
        raise InputError(f"lights: expected 1 to {MAX_LIGHTS}, got {lights}")
    if border not in (EDGE, BLACK):
        raise InputError(f"border: expected {EDGE} or {BLACK}, got {shown(border)}")
    if border != EDGE and not convention(shader).plain:
        raise InputError(f"border: expected {EDGE} with {shader}, got {border}; leave it out")
    return Mitchell(1.0, 0.9, 0.5, 0.5, [[0.5, 0.5]] * lights, shader, samples, border=border)


def mitchell_at(
    settings: Mapping[str, Any], values: Mapping[str, float], lights: Sequence[tuple[float, float]]
) -> Mitchell:
    """Mitchell's sum at a point.

    ``values`` and ``lights`` (texture coordinates) come before ``settings`` (of a fit), and these
    before the shader's defaults. A light that neither gives is in the middle of the picture. Raises
    InputError for a value that is missing or out of bounds.
    """
    shader = convention(settings.get("shader", "mitchell"))
    count = len(lights) or sum(is_light(k) for k in settings) // 2 or 1
    border = settings.get("border", EDGE)
    model = mitchell_template(shader.key, settings.get("samples"), count, border)
    places = {}
    for i, (u, v) in enumerate(lights):
        stem = "light" if i == 0 else f"light{i + 1}"
        places |= {f"{stem}_x": u, f"{stem}_y": v}
    point = {}
    for name in model.parameters:
        fallback = 0.5 if is_light(name) else model.defaults.get(name)
        value = places.get(name, values.get(name, settings.get(name, fallback)))
        if value is None and name in shader.parameters:
            raise InputError(f"{name}: expected a value, got none; '{shader.name}' has no default")
        point[name] = 1.0 if value is None else float(value)
    check_values(model, point, "render")
    light = [point[name] for name in point if is_light(name)]
    return Mitchell(
        point["exposure"],
        point["decay"],
        point["density"],
        point["weight"],
        light,
        shader.key,
        model.samples,
        settings.get("full_size", False),
        border=border,
    )


def staged_template(model: AbstractModel, scene: Scene, names: Sequence[str]) -> Staged:
    """Mitchell's sum over the mask of ``scene``, with the numbers ``names`` of the scene free.
    Raises InputError for several lights, and for names that are unknown or given twice."""
    assert isinstance(model, Mitchell)
    if model.light.shape[0] != 1:
        raise InputError("lights: expected 1 with a scene, which has one; fit with a mask instead")
    if len(set(names)) < len(names):
        raise InputError(f"free: expected each name once, got {', '.join(names)}")
    for name in names:
        scene.value(name)
    return Staged(model, scene, names)


def template(
    kind: str,
    settings: Mapping[str, Any],
    lights: int,
    geometry: tuple[Scene | None, float | None, float | np.ndarray | None],
) -> tuple[AbstractModel, tuple[str, ...]]:
    """A model of the ``kind`` named, at no particular point, and notes on what was assumed for it.
    ``geometry`` is the scene, or the field of view in degrees and the distance without one."""
    samples = settings.get("samples")
    if kind == HoffmanPreetham.name:
        return daylight_template(*geometry, samples)
    border = settings.get("border", EDGE)
    model = mitchell_template(settings.get("shader", "mitchell"), samples, lights, border)
    return (TintedMask(model) if settings.get("tint") else model), ()


def daylight_template(
    scene: Scene | None,
    fov: float | None,
    distance: float | np.ndarray | None,
    samples: int | None,
) -> tuple[HoffmanPreetham, tuple[str, ...]]:
    """The model of Hoffman and Preetham at no particular point, and notes on assumed numbers.

    ``fov`` is in degrees, ``distance`` in metres, a number or (h, w). Raises InputError for numbers
    out of range, and for a geometry that contradicts the scene.
    """
    samples = DEFAULT_AVERAGE_SAMPLES if samples is None else samples
    _check_samples(samples)
    if scene is not None:
        if fov is not None:
            raise InputError("fov: expected none with a scene, whose camera has one; leave it out")
        if isinstance(distance, np.ndarray):
            raise InputError("distance: expected a number with a scene, got an array")
        view, assumed = view_of_scene(scene, distance), ()
    else:
        assumed = tuple(
            f"{name}: {number:g} {unit} assumed; give --{name}"
            for name, number, unit, value in (
                ("fov", DEFAULT_FOV, "degrees", fov),
                ("distance", DEFAULT_DISTANCE, "metres", distance),
            )
            if value is None
        )
        view = View(DEFAULT_DISTANCE if distance is None else distance, fov or DEFAULT_FOV)
    return HoffmanPreetham(Air(), [0.5, 0.5], view, samples), assumed


def daylight_at(
    settings: Mapping[str, Any],
    values: Mapping[str, float],
    lights: Sequence[tuple[float, float]],
    scene: Scene | None,
) -> HoffmanPreetham:
    """The model of Hoffman and Preetham at a point; arguments as in ``mitchell_at``. Raises
    InputError where the sun's irradiance or the air's scale, which have no default, are missing."""
    fov = None if scene is not None else settings.get("fov")
    model, _ = daylight_template(scene, fov, settings.get("distance"), settings.get("samples"))
    places: dict[str, float] = {}
    if lights:
        places = {"light_x": lights[0][0], "light_y": lights[0][1]}
    point = {}
    for name in model.parameters:
        fallback = 0.5 if is_light(name) else model.defaults.get(name)
        value = places.get(name, values.get(name, settings.get(name, fallback)))
        if value is None:
            option = name.replace("_", "-")
            raise InputError(f"{name}: expected a value, got none; give --{option}")
        point[name] = float(value)
    check_values(model, point, "render")
    air = Air(
        point["turbidity"], point["g"], point["e_sun"], point["scale"],
        phase=settings.get("phase", "normalised"),
    )  # fmt: skip
    return HoffmanPreetham(air, (point["light_x"], point["light_y"]), model.view, model.samples)


def view_of_scene(scene: Scene, distance: float | None = None) -> View:
    """The view of the scene's camera: directions, and distances to the surfaces along the rays.

    Pixels without a surface, and those of the light, which stands for the sun, are ``distance``
    away, by default ``camera.far``.
    """
    surfaces = visible_surfaces(scene)
    label, depth = np.asarray(surfaces.label), np.asarray(surfaces.depth)
    sky = scene.camera.far if distance is None else distance
    h, w = scene.size
    flat = View(1.0, float(scene.camera.fov_y))
    direction = np.asarray(flat.rays((h, w), jnp.arange(h * w))[1]).reshape(h, w, 3)
    is_object = label >= FIRST_OBJECT_LABEL
    # Depth is along the camera's axis, distance along the ray.
    along = np.where(is_object, depth, 1.0) / -direction[..., 2]
    up = np.asarray(scene.camera_axes(), float) @ np.array([0.0, 1.0, 0.0])
    away = np.where(is_object, np.minimum(along, sky), sky).astype(np.float32)
    return View(away, float(scene.camera.fov_y), (up[0], up[1], up[2]))

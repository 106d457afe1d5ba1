"""From what the user gives to what the fit works on, or one line that says why not."""

from __future__ import annotations

import dataclasses
import difflib
import os
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from godfit.errors import InputError
from godfit.flatland.model import Flatland
from godfit.inference.observation import Picture
from godfit.io.filters import shrink
from godfit.io.image import Image, decode, read_image
from godfit.models.atmosphere import Air
from godfit.models.hoffman_preetham import HoffmanPreetham, View
from godfit.models.mitchell import AbstractModel, Mitchell
from godfit.models.staged import Staged, resized
from godfit.scattering.parameters import is_light
from godfit.scattering.taps import convention
from godfit.scenes.raster import on_screen, rasterise, visible
from godfit.scenes.scene import Scene

MODELS = (Mitchell.name, HoffmanPreetham.name, Flatland.name)
# Of Hoffman-Preetham where nothing is said: degrees, metres, taps that D is averaged over.
FOV, DISTANCE, AVERAGED = 60.0, 1000.0, 100

Source = str | os.PathLike[str] | np.ndarray | Image


def image(source: Source, transfer: str) -> Image:
    """A file, an ``Image`` as it is, or an array; see ``godfit.fit``."""
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


def picture(
    target: Image,
    mask: Image,
    background: Image | None,
    valid: np.ndarray | None,
    pass_scale: float,
    channels: int = 1,
) -> Picture:
    """Target, mask and background as one, checked against each other; see ``godfit.fit``."""
    size, values = target.values.shape[:2], mask.values
    if background is not None and background.values.shape[:2] != size:
        raise InputError(
            f"background: expected the target's {size[1]}x{size[0]} pixels, got "
            f"{background.values.shape[1]}x{background.values.shape[0]}; render it at that size"
        )
    values = shrink_mask(values, pass_scale)
    (h, w), (height, width) = values.shape[:2], size
    if h > height or w > width:
        raise InputError(
            f"mask: expected at most the target's {width}x{height} pixels, got {w}x{h}; "
            "scale the mask down or give the target at full size"
        )
    # A pass at a fraction of an odd size is rounded to whole pixels: one pixel either way.
    if abs(w * height - h * width) > max(width, height):
        raise InputError(
            f"mask: expected the target's aspect {width}:{height}, got {w}:{h}; "
            "crop or render the mask for the same frame"
        )
    if valid is not None and not valid.any():
        raise InputError("ignore: expected pixels to be left, got all of them ignored; ignore less")
    back = None if background is None else background.values
    return Picture.make(target, values, back, valid, channels)


def check_unaided(
    model: str,
    lights: int,
    background: Source | None,
    occluder: Source | None,
    bright_pass: bool,
) -> None:
    """Raise InputError for what a fit without mask and scene does not do."""
    if model != Mitchell.name:
        raise InputError(f"mask: expected --mask or --scene with the model {model}, got neither")
    if lights != 1:
        raise InputError(f"lights: expected 1 without a mask, got {lights}; give --mask")
    if background is not None:
        raise InputError("background: expected none without a mask, got one; give --mask as well")
    if bright_pass and occluder is not None:
        raise InputError("occluder: expected none with --bright-pass, got one; give either")


def blocked(occluder: Image, target: Image) -> np.ndarray:
    """(h, w) True where the image is not black."""
    (h, w), (height, width) = target.values.shape[:2], occluder.values.shape[:2]
    if (h, w) != (height, width):
        raise InputError(
            f"occluder: expected the target's {w}x{h} pixels, got {width}x{height}; "
            "draw it over the target"
        )
    return np.asarray((np.atleast_3d(occluder.values) > 0).any(-1))


def shrink_mask(mask: np.ndarray, pass_scale: float) -> np.ndarray:
    """The mask at the light pass's own size, averaged over cells."""
    if not 0 < pass_scale <= 1:
        raise InputError(f"pass scale: expected a number above 0, at most 1, got {pass_scale:g}")
    if pass_scale == 1:
        return mask
    h, w = (max(1, round(n * pass_scale)) for n in mask.shape[:2])
    return shrink(mask, (h, w))


def model_from(
    settings: Mapping[str, Any], values: Mapping[str, float], lights: Sequence[tuple[float, float]]
) -> Mitchell:
    """A model at a point. ``settings`` (of a fit) give way to ``values`` and ``lights``, and what
    neither gives is the shader's default; a light without any is in the middle."""
    shader = convention(settings.get("shader", "mitchell"))
    count = len(lights) or sum(is_light(k) for k in settings) // 2 or 1
    model = template(shader.name, settings.get("samples"), count)
    places = {}
    for i, (u, v) in enumerate(lights):
        stem = "light" if i == 0 else f"light{i + 1}"
        places |= {f"{stem}_x": u, f"{stem}_y": v}
    point = {}
    for name in model.parameters:
        fallback = 0.5 if is_light(name) else shader.defaults.get(name)
        value = places.get(name, values.get(name, settings.get(name, fallback)))
        if value is None and name in shader.parameters:
            raise InputError(f"{name}: expected a value, got none; '{shader.name}' has no default")
        point[name] = 1.0 if value is None else float(value)
    _check(model, point, "render")
    light = [point[name] for name in point if is_light(name)]
    return Mitchell(
        point["exposure"],
        point["decay"],
        point["density"],
        point["weight"],
        light,
        shader.name,
        model.samples,
    )


def template(shader: str, samples: int | None, lights: int) -> Mitchell:
    """A model of the right kind, at no particular point."""
    if samples is not None and not 2 <= samples <= 100_000:
        raise InputError(f"samples: expected a whole number from 2 to 100000, got {samples}")
    if not 1 <= lights <= 8:
        raise InputError(f"lights: expected 1 to 8, got {lights}")
    return Mitchell(1.0, 0.9, 0.5, 0.5, [[0.5, 0.5]] * lights, shader, samples)


def parameters(
    model: AbstractModel, fix: Mapping[str, float | None], start: Mapping[str, float]
) -> tuple[dict[str, float], np.ndarray]:
    """Values that the search takes as they are, and (p,) held parameters, NaN where free."""
    table = model.parameters
    given: dict[str, float] = {}
    for option, values in (("start", start), ("fix", fix)):
        for name, value in values.items():
            if name not in table:
                near = difflib.get_close_matches(name, table, n=1, cutoff=0.0)[0]
                raise InputError(
                    f"{option}: expected one of {', '.join(table)}, got '{name}'; "
                    f"did you mean '{near}'?"
                )
            if value is None:
                value = given.get(name, model.defaults.get(name))
            if value is None:
                raise InputError(
                    f"fix: expected {name}=VALUE, got no value; it has no default here"
                )
            given[name] = float(value)
        _check(model, {n: given[n] for n in values}, option)
    held = np.array([given[n] if n in fix else np.nan for n in table], np.float32)
    return given, held


def _check(model: AbstractModel, values: Mapping[str, float], option: str) -> None:
    for name, value in values.items():
        row = model.parameters[name]
        if not (row.lower <= value <= row.upper and np.isfinite(value)):
            raise InputError(
                f"{option}: expected {name} from {row.lower:g} to {row.upper:g}, got {value:g}"
            )


def single(scene: Scene) -> Scene:
    """The scene in float32."""
    return jax.tree.map(
        lambda z: jnp.asarray(np.asarray(z, np.float32 if z.dtype.kind == "f" else np.int32)),
        scene,
    )


def scene_for(scene: Scene, target: Image, pass_scale: float) -> Scene:
    """The scene at the size of the light pass: its own, or the target's where that is less, times
    ``pass_scale``."""
    if not 0 < pass_scale <= 1:
        raise InputError(f"pass scale: expected a number above 0, at most 1, got {pass_scale:g}")
    (h, w), (height, width) = scene.size, target.values.shape[:2]
    if abs(w * height - h * width) > max(width, height):
        raise InputError(
            f"scene: expected the target's aspect {width}:{height}, got [image] {w}x{h}; "
            "set width and height to the target's"
        )
    if h > height:
        h, w = height, width
    return resized(scene, (max(1, round(h * pass_scale)), max(1, round(w * pass_scale))))


def place_of(scene: Scene) -> dict[str, float]:
    """Where the scene's light is on the screen."""
    u, v = np.asarray(on_screen(scene), float)
    return {"light_x": float(u), "light_y": float(v)}


def check_model(
    model: str,
    free: Sequence[str],
    shader: str | None,
    lights: int,
    fov: float | None,
    distance: float | np.ndarray | None,
) -> None:
    """Raise InputError for what does not go together."""
    if model not in MODELS:
        near = difflib.get_close_matches(model, MODELS, n=1, cutoff=0.0)[0]
        raise InputError(
            f"model: expected one of {', '.join(MODELS)}, got '{model}'; did you mean '{near}'?"
        )
    if model == Mitchell.name:
        for name, value in (("fov", fov), ("distance", distance)):
            if value is not None:
                raise InputError(f"{name}: expected --model {HoffmanPreetham.name} with it")
        return
    for name, wrong in (("free", free), ("shader", shader), ("lights", lights != 1)):
        if wrong:
            raise InputError(f"{name}: expected none with the model {model}, got one; leave it out")
    if model == Flatland.name:
        for name, value in (("fov", fov), ("distance", distance)):
            if value is not None:
                raise InputError(f"{name}: expected none with the model {model}; leave it out")
        return
    if fov is not None and not 0 < fov < 180:
        raise InputError(f"fov: expected degrees above 0 and below 180, got {fov:g}")
    away = np.asarray(1.0 if distance is None else distance)
    if away.ndim not in (0, 2) or not ((away > 0) & (away < np.inf)).all():
        got = f"{away:g}" if away.ndim == 0 else f"an array {away.shape} with others in it"
        raise InputError(f"distance: expected a finite number above 0 or (h, w) of them, got {got}")


def daylight(
    scene: Scene | None,
    fov: float | None,
    distance: float | np.ndarray | None,
    samples: int | None,
) -> tuple[HoffmanPreetham, tuple[str, ...]]:
    """The model of Hoffman and Preetham at no particular point, and what was assumed for it."""
    samples = AVERAGED if samples is None else samples
    if not 2 <= samples <= 100_000:
        raise InputError(f"samples: expected a whole number from 2 to 100000, got {samples}")
    if scene is not None:
        if fov is not None:
            raise InputError("fov: expected none with a scene, whose camera has one; leave it out")
        if isinstance(distance, np.ndarray):
            raise InputError("distance: expected a number with a scene, got an array")
        view, assumed = view_of(scene, distance), ()
    else:
        assumed = tuple(
            f"{name}: {number:g} {unit} assumed; give --{name}"
            for name, number, unit, value in (
                ("fov", FOV, "degrees", fov), ("distance", DISTANCE, "metres", distance)
            )
            if value is None
        )  # fmt: skip
        view = View(DISTANCE if distance is None else distance, fov or FOV)
    return HoffmanPreetham(Air(), [0.5, 0.5], view, samples), assumed


def daylight_from(
    settings: Mapping[str, Any],
    values: Mapping[str, float],
    lights: Sequence[tuple[float, float]],
    scene: Scene | None,
) -> HoffmanPreetham:
    """Hoffman and Preetham's model at a point, as ``model_from``. Raises InputError where the sun's
    irradiance or the air's scale, which have no default, are not given."""
    fov = None if scene is not None else settings.get("fov")
    model, _ = daylight(scene, fov, settings.get("distance"), settings.get("samples"))
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
    _check(model, point, "render")
    air = Air(
        point["turbidity"], point["g"], point["e_sun"], point["scale"],
        phase=settings.get("phase", "normalised"),
    )  # fmt: skip
    return HoffmanPreetham(air, (point["light_x"], point["light_y"]), model.view, model.samples)


def view_of(scene: Scene, distance: float | None = None) -> View:
    """How the scene's camera sees it: what lies where nothing is drawn, and the light, which stands
    for the sun, are ``distance`` away, or at ``camera.far``."""
    seen = _visible(scene)
    label, depth = np.asarray(seen.label), np.asarray(seen.depth)
    sky = scene.camera.far if distance is None else distance
    h, w = scene.size
    flat = View(1.0, float(scene.camera.fov_y))
    direction = np.asarray(flat.seen((h, w), jnp.arange(h * w))[1]).reshape(h, w, 3)
    # Depth is along the view, distance along the ray.
    along = np.where(label >= 2, depth, 1.0) / -direction[..., 2]
    up = np.asarray(scene.camera_axes(), float) @ np.array([0.0, 1.0, 0.0])
    away = np.where(label >= 2, np.minimum(along, sky), sky).astype(np.float32)
    return View(away, float(scene.camera.fov_y), (up[0], up[1], up[2]))


def open_sky(scene: Scene) -> Scene:
    """The scene as a mask of what is not occluded: objects black, all else white."""
    white, black = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
    return dataclasses.replace(
        scene,
        background=white,
        light=dataclasses.replace(scene.light, colour=white),
        objects=tuple(dataclasses.replace(thing, colour=black) for thing in scene.objects),
    )


@eqx.filter_jit
def _visible(scene: Scene):
    return visible(scene)


def staged(model: Mitchell, scene: Scene, names: Sequence[str]) -> Staged:
    """The model that draws its own mask, ``names`` of the scene free."""
    if model.light.shape[0] != 1:
        raise InputError("lights: expected 1 with a scene, which has one; fit with a mask instead")
    if len(set(names)) < len(names):
        raise InputError(f"free: expected each name once, got {', '.join(names)}")
    for name in names:
        scene.value(name)
    return Staged(model, scene, names)


def drawn(scene: Scene, antialias: bool) -> np.ndarray:
    """The scene's mask in the bytes that a light pass reads, (h, w) or (h, w, 3) float32."""
    try:
        mask = np.asarray(_rasterised(scene, antialias))
    except jax.errors.JaxRuntimeError as error:
        raise InputError.within(error) or error from error
    return np.round(255 * mask).astype(np.float32) / 255


@eqx.filter_jit
def _rasterised(scene: Scene, antialias: bool):
    return rasterise(scene, antialias=antialias, still=True)

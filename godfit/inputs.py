"""From what the user gives to what the fit works on, or one line that says why not."""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from godfit.errors import InputError
from godfit.image import Image, decode, read_image
from godfit.models import AbstractModel, Mitchell
from godfit.observation import Picture, shrink
from godfit.parameters import is_light
from godfit.raster import on_screen, rasterise
from godfit.scene import Scene
from godfit.staged import Staged, resized
from godfit.taps import convention

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
    return Picture.make(target, values, None if background is None else background.values, valid)


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
                    f"fix: expected {name}=VALUE, got no value; '{model.shader}' has no default of "
                    f"{name}, so give one"
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
    return rasterise(scene, antialias=antialias)

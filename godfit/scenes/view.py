"""How a scene is viewed: its size, its light on the screen, the mask that it draws."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from godfit.errors import InputError
from godfit.io.image import Image
from godfit.scenes.raster import on_screen, rasterise, visible
from godfit.scenes.scene import Scene


def resized(scene: Scene, size: tuple[int, int]) -> Scene:
    """The scene in a picture of another size."""
    return dataclasses.replace(scene, size=size)


def in_single_precision(scene: Scene) -> Scene:
    """The scene in float32."""
    return jax.tree.map(
        lambda z: jnp.asarray(np.asarray(z, np.float32 if z.dtype.kind == "f" else np.int32)),
        scene,
    )


def scene_at_pass_size(scene: Scene, target: Image, pass_scale: float) -> Scene:
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


def light_on_screen(scene: Scene) -> dict[str, float]:
    """Where the scene's light is on the screen."""
    u, v = np.asarray(on_screen(scene), float)
    return {"light_x": float(u), "light_y": float(v)}


def as_sky_mask(scene: Scene) -> Scene:
    """The scene as a mask of what is not occluded: objects black, all else white."""
    white, black = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
    return dataclasses.replace(
        scene,
        background=white,
        light=dataclasses.replace(scene.light, colour=white),
        objects=tuple(dataclasses.replace(thing, colour=black) for thing in scene.objects),
    )


@eqx.filter_jit
def visible_in(scene: Scene):
    return visible(scene)


def drawn_mask(scene: Scene, antialias: bool) -> np.ndarray:
    """The scene's mask in the bytes that a light pass reads, (h, w) or (h, w, 3) float32."""
    try:
        mask = np.asarray(_rasterised(scene, antialias))
    except jax.errors.JaxRuntimeError as error:
        raise InputError.within(error) or error from error
    return np.round(255 * mask).astype(np.float32) / 255


@eqx.filter_jit
def _rasterised(scene: Scene, antialias: bool):
    return rasterise(scene, antialias=antialias, still=True)

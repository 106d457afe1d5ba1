"""A scene in a picture: its size, its light on the screen, and the mask that it draws."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from godfit.errors import InputError
from godfit.io.image import Image
from godfit.io.sources import pass_size
from godfit.runtime.guest import as_guest
from godfit.scenes.raster import Visible, on_screen, rasterise, visible
from godfit.scenes.scene import BLACK, WHITE, Scene


def in_single_precision(scene: Scene) -> Scene:
    """The scene with its numbers in float32 and int32, the precision of a fit."""
    kinds = {"f": np.float32, "b": np.bool_}
    return jax.tree.map(
        lambda z: jnp.asarray(np.asarray(z, kinds.get(z.dtype.kind, np.int32))), scene
    )


def resized(scene: Scene, size: tuple[int, int]) -> Scene:
    """The scene in a picture of another size (height, width)."""
    return dataclasses.replace(scene, size=size)


def framed(scene: Scene, target: Image) -> Scene:
    """The scene in a picture of the target's size, where its file gives none. The vertical field of
    view stays, as three.js has it where a canvas is not as wide as the camera's aspect ratio."""
    if not scene.any_size:
        return scene
    return resized(scene, (target.values.shape[0], target.values.shape[1]))


def scene_at_pass_size(scene: Scene, target: Image, pass_scale: float) -> Scene:
    """The scene at the size of the light pass: the smaller of the scene's own size and the
    target's, times ``pass_scale``. Raises InputError for a ``pass_scale`` outside (0, 1], and for a
    scene with another aspect than the target's."""
    scene = framed(scene, target)
    (h, w), (height, width) = scene.size, target.values.shape[:2]
    if abs(w * height - h * width) > max(width, height):
        raise InputError(
            f"scene: expected the target's aspect {width}:{height}, got [image] {w}x{h}; "
            "set width and height to the target's"
        )
    return resized(scene, pass_size((height, width) if h > height else (h, w), pass_scale))


def as_sky_mask(scene: Scene) -> Scene:
    """The scene with colours that make its mask one of the open sky: objects black, all else
    white."""
    return dataclasses.replace(
        scene,
        background=WHITE,
        light=dataclasses.replace(scene.light, colour=WHITE),
        objects=tuple(dataclasses.replace(obj, colour=BLACK) for obj in scene.objects),
    )


def light_on_screen(scene: Scene) -> dict[str, float]:
    """Texture coordinates of the scene's light, as the parameters ``light_x`` and ``light_y``."""
    u, v = np.asarray(on_screen(scene), float)
    return {"light_x": float(u), "light_y": float(v)}


@eqx.filter_jit
def visible_surfaces(scene: Scene) -> Visible:
    """``raster.visible``, compiled."""
    return visible(scene)


def drawn_mask(scene: Scene, antialias: bool) -> np.ndarray:
    """The scene's mask as the 8-bit texture that a light pass reads: (h, w) or (h, w, 3) float32,
    multiples of 1/255. Raises InputError as ``raster.rasterise`` does."""
    try:
        with as_guest(any_precision=True):
            mask = np.asarray(_rasterised(scene, antialias))
    except jax.errors.JaxRuntimeError as error:
        # An error in a callback comes back inside one of XLA's.
        raise InputError.within(error) or error from error
    return np.round(255 * mask).astype(np.float32) / 255


@eqx.filter_jit
def _rasterised(scene: Scene, antialias: bool):
    return rasterise(scene, antialias=antialias, still=True)

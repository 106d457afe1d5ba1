"""The camera and the light of a glTF file, in the terms of a scene file."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from godfit.errors import InputError
from godfit.scenes.gltf import Gltf, Placed

NO_ZFAR = 1e6
"""Depth, in the scene's unit, that stands for the infinite far plane of a camera without zfar."""
LIGHT_SIZE = 0.1
"""Radius of a light over its distance from the camera. glTF's lights have no size; those of the
published god-ray scenes have about this one (0.8 at a distance of 7)."""
DIRECTIONAL_SHARE = 0.5
"""Share of the far depth at which a directional light is placed: its sphere lies before far."""
PICTURE_HEIGHT = 1080
"""Height in pixels of a picture whose size nothing gives."""
PICTURE_ASPECT = 16 / 9
"""Width over height of a picture whose camera has no aspectRatio."""
LEAST_ASPECT, MOST_ASPECT = 0.1, 10.0
"""Bounds of the aspect ratio: a damaged file may have any."""


class GltfView(NamedTuple):
    """The camera's position, target and up (3,), its vertical field of view in degrees, near and
    far; the light's position (3,) and radius; the picture's size (h, w); and notes."""

    position: np.ndarray
    target: np.ndarray
    up: np.ndarray
    fov_y: float
    near: float
    far: float
    light: np.ndarray
    radius: float
    size: tuple[int, int]
    notes: tuple[str, ...]


def view_of(file: Gltf) -> GltfView:
    """The first perspective camera and the first light of a file. Raises InputError where it has
    none, which shows how to write a scene file."""
    cameras, lights = file.cameras(), file.lights()
    perspective = [placed for placed in cameras if placed.table.get("type") == "perspective"]
    if not perspective or not lights:
        got = [] if perspective else ["no camera" if not cameras else "an orthographic camera"]
        got += [] if lights else ["no light"]
        raise InputError(
            f"'{file.path}': expected a perspective camera and a light (KHR_lights_punctual), got "
            f"{' and '.join(got)}; export them, or write a scene file: [image] width, height; "
            f"[camera] position, target, fov_y; [light] position, radius; [[object]] "
            f"mesh = '{file.path.name}'"
        )
    camera, light = perspective[0], lights[0]
    lens = camera.table["perspective"]
    far = float(lens.get("zfar", NO_ZFAR))
    position, back = camera.world[:3, 3], _direction(camera, 2)
    directional = light.table.get("type") == "directional"
    place = light.world[:3, 3]
    if directional:
        # The light shines along its own -z.
        place = position + DIRECTIONAL_SHARE * far * _direction(light, 2)
    radius = LIGHT_SIZE * float(np.linalg.norm(place - position))
    notes = [
        f"'{file.path}': {len(several)} {what}; the first is used"
        for what, several in (("perspective cameras", perspective), ("lights", lights))
        if len(several) > 1
    ]
    notes.append(
        f"'{file.path}': glTF's lights have no radius; {radius:.3g} is assumed, a tenth of the "
        "distance from the camera. Write a scene file for another, or fit it with "
        "--free light.radius"
    )
    aspect = float(np.clip(lens.get("aspectRatio", PICTURE_ASPECT), LEAST_ASPECT, MOST_ASPECT))
    return GltfView(
        position, position - back, _direction(camera, 1), float(np.rad2deg(lens["yfov"])),
        float(lens["znear"]), far, place, radius,
        (PICTURE_HEIGHT, round(PICTURE_HEIGHT * aspect)), tuple(notes),
    )  # fmt: skip


def _direction(placed: Placed, axis: int) -> np.ndarray:
    """An axis of a node in the world, of length 1."""
    direction = placed.world[:3, axis]
    return direction / np.linalg.norm(direction)

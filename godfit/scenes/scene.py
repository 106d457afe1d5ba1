"""Scenes: a camera, a light and objects, read from a TOML file.

Conventions are three.js's: right-handed, y up, the camera looks along its own -z, rotations are
Euler angles in the order XYZ (the matrix Rx Ry Rz), fields of view are vertical. Colours are the
bytes of the picture, not decoded: "#111111" is 17/255.
"""

from __future__ import annotations

import dataclasses
import difflib
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from godfit.errors import InputError
from godfit.io.image import TRANSFERS
from godfit.io.sidecar import SIDECAR_SCATTERING
from godfit.io.toml_table import Colour, Table
from godfit.scattering.parameters import SCATTERING as PARAMETERS
from godfit.scattering.taps import convention
from godfit.scenes import mesh

# Numbers of the scene that a fit can free.
CAMERA, LIGHT = ("position", "target", "up", "fov_y"), ("position", "radius")
OBJECT = ("position", "rotation", "scale")
MAX_SIZE = 16384
# What [scattering] may hold: a target's settings, and parameters for rendering.
SETTINGS: dict[str, type] = {
    k: v for k, v in SIDECAR_SCATTERING.items() if k not in ("lights", "model", "rays")
} | dict.fromkeys(("exposure", "decay", "density", "weight"), float)

# From and to, both included.
LIMITS = {p.name: (p.lower, min(p.upper, 1e18)) for p in PARAMETERS} | {
    "samples": (2, 100000),
    "pass_scale": (1e-3, 1),
}


class Camera(eqx.Module):
    """position, target, up (3,), fov_y () in degrees; near and far are depths."""

    position: Float[Array, "3"]
    target: Float[Array, "3"]
    up: Float[Array, "3"]
    fov_y: Float[Array, ""]
    near: float = eqx.field(static=True)
    far: float = eqx.field(static=True)


class Light(eqx.Module):
    """A sphere: position (3,), radius ()."""

    position: Float[Array, "3"]
    radius: Float[Array, ""]
    colour: Colour = eqx.field(static=True)


class Object(eqx.Module):
    """A mesh and its pose: vertices (v, 3) of its own, faces (f, 3), edges (e, 4) as in
    ``godfit.scenes.mesh.edges``, position (3,), rotation (3,) in degrees, scale ()."""

    vertices: Float[Array, "v 3"]
    faces: Int[Array, "f 3"]
    edges: Int[Array, "e 4"]
    position: Float[Array, "3"]
    rotation: Float[Array, "3"]
    scale: Float[Array, ""]
    colour: Colour = eqx.field(static=True)

    def world(self) -> Float[Array, "v 3"]:
        """The vertices where the pose puts them."""
        x, y, z = jnp.deg2rad(self.rotation)
        turn = _turn(x, 1, 2) @ _turn(y, 2, 0) @ _turn(z, 0, 1)
        return self.position[None] + (self.scale * self.vertices) @ turn.T


class Scene(eqx.Module):
    """What a mask is drawn from. ``size`` is (height, width); ``antialias`` is None where the file
    leaves it open; ``scattering`` holds the shader's settings; ``notes`` are for the user."""

    camera: Camera
    light: Light
    objects: tuple[Object, ...]
    background: Colour = eqx.field(static=True)
    size: tuple[int, int] = eqx.field(static=True)
    antialias: bool | None = eqx.field(static=True, default=None)
    scattering: tuple[tuple[str, Any], ...] = eqx.field(static=True, default=())
    notes: tuple[str, ...] = eqx.field(static=True, default=())

    @property
    def settings(self) -> dict[str, Any]:
        """The [scattering] table: shader, samples, and parameters for rendering."""
        return dict(self.scattering)

    @property
    def names(self) -> list[str]:
        """All numbers of the scene that can be asked for and replaced."""
        objects = [f"object[{i}].{n}" for i in range(len(self.objects)) for n in OBJECT]
        return [f"camera.{n}" for n in CAMERA] + [f"light.{n}" for n in LIGHT] + objects

    def value(self, name: str) -> Float[Array, "..."]:
        """The number (or three) of a name like ``object[0].position``; raises InputError."""
        return _find(self, self._path(name))

    def replaced(self, values: Mapping[str, Array]) -> Scene:
        """The scene with other numbers."""
        paths = [self._path(name) for name in values]
        return eqx.tree_at(lambda s: [_find(s, p) for p in paths], self, list(values.values()))

    def camera_axes(self) -> Float[Array, "3 3"]:
        """World to camera, rows right, up and back: three.js's lookAt."""
        camera = self.camera
        back = camera.position - camera.target
        back = back / jnp.linalg.norm(back)
        right = jnp.cross(camera.up, back)
        right = right / jnp.linalg.norm(right)
        return jnp.stack([right, jnp.cross(back, right), back])

    def _path(self, name: str) -> tuple[str, int, str]:
        if name not in self.names:
            near = difflib.get_close_matches(name, self.names, n=1, cutoff=0.0)[0]
            raise InputError(
                f"scene: expected one of {', '.join(self.names)}, got '{name}'; "
                f"did you mean '{near}'?"
            )
        part, number, key = re.fullmatch(r"(\w+)(?:\[(\d+)\])?\.(\w+)", name).groups()  # pyright: ignore[reportOptionalMemberAccess]
        return part, int(number or 0), key


def _find(scene: Scene, path: tuple[str, int, str]) -> Any:
    part, number, key = path
    return getattr(scene.objects[number] if part == "object" else getattr(scene, part), key)


def _turn(angle: Float[Array, ""], i: int, j: int) -> Float[Array, "3 3"]:
    """Rotation from axis i towards axis j."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    rows = [
        [jnp.asarray(float(row == column), angle.dtype) for column in range(3)] for row in range(3)
    ]
    rows[i][i], rows[i][j], rows[j][i], rows[j][j] = c, -s, s, c
    # Not by ``.at[].set``: a scatter takes long to compile, and every object turns three times.
    return jnp.stack([jnp.stack(row) for row in rows])


def read_scene(path: str | os.PathLike[str]) -> Scene:
    """Read a scene file; raises InputError naming the file, the key, what was expected and got."""
    path = Path(path)
    root = Table.read(path, "a scene file")
    image, camera, light = (root.table(key) for key in ("image", "camera", "light"))
    background, scattering = root.table("background", {}), root.table("scattering", {})
    parts = [_object(Table(path, f"object[{i}]", t)) for i, t in enumerate(root.tables("object"))]
    root.finish()
    scattering.may_have(*SETTINGS)
    scene = Scene(
        Camera(
            _array(camera.three("position")),
            _array(camera.three("target", [0.0, 0.0, 0.0])),
            _array(camera.three("up", [0.0, 1.0, 0.0])),
            _array(camera.number("fov_y", 75.0, above=0.0, below=180.0)),
            camera.number("near", 0.1, above=0.0),
            camera.number("far", 2000.0, above=0.0),
        ),
        Light(
            _array(light.three("position")),
            _array(light.number("radius", above=0.0)),
            light.colour("colour", "#ffffff"),
        ),
        tuple(thing for thing, _ in parts),
        background.colour("colour", "#000000"),
        (image.whole("height", 1, MAX_SIZE), image.whole("width", 1, MAX_SIZE)),
        image.switch("antialias"),
        tuple((key, _setting(scattering, key)) for key in list(scattering.data)),
        tuple(note for _, notes in parts for note in notes),
    )
    for table in (image, camera, light, background, scattering):
        table.finish()
    notes = _check(path, scene)
    notes += tuple(f"the camera is inside object[{i}]" for i in _around_camera(scene))
    return dataclasses.replace(scene, notes=scene.notes + notes)


def _object(table: Table) -> tuple[Object, tuple[str, ...]]:
    """One [[object]] and what is to be said of its mesh."""
    file, kind = table.text("mesh"), table.text("primitive")
    if (file is None) == (kind is None):
        raise table.error("mesh", "mesh or primitive", "both" if file else "neither")
    if file is not None:
        shape = mesh.load(table.path.parent / file)
    else:
        assert kind is not None
        if kind not in mesh.PRIMITIVES:
            raise table.error("primitive", f"one of {', '.join(mesh.PRIMITIVES)}", repr(kind))
        sizes = {}
        for key, default in mesh.PRIMITIVES[kind][1].items():
            if isinstance(default, list):
                sizes[key] = table.three(key, default, above=0.0)
            elif key in mesh.COUNTS:
                sizes[key] = table.whole(key, *mesh.COUNTS[key], default)
            else:
                sizes[key] = table.number(key, default, above=0.0)
        shape = mesh.primitive(kind, **sizes)
    thing = Object(
        _array(shape.vertices),
        jnp.asarray(shape.faces),
        jnp.asarray(mesh.edges(shape.faces)),
        _array(table.three("position", [0.0, 0.0, 0.0])),
        _array(table.three("rotation", [0.0, 0.0, 0.0])),
        _array(table.number("scale", 1.0, above=0.0)),
        table.colour("colour", "#000000"),
    )
    table.finish()
    return thing, shape.notes


def _setting(table: Table, key: str) -> Any:
    """A key of [scattering]."""
    if key not in SETTINGS:
        return None
    value = table.optional(key, SETTINGS[key])
    expected = LIMITS.get(key)
    if expected and not expected[0] <= value <= expected[1]:
        raise table.error(key, f"from {expected[0]:g} to {expected[1]:g}", repr(value))
    if key == "transfer" and value not in TRANSFERS:
        raise table.error(key, " or ".join(map(repr, TRANSFERS)), repr(value))
    if key == "shader":
        try:
            convention(value)
        except InputError as error:
            raise InputError(f"'{table.path}': scattering.{error}") from None
    return value


def _array(value: Any) -> Array:
    return jnp.asarray(value, float)


def _check(path: Path, scene: Scene) -> tuple[str, ...]:
    """What no key is to blame for alone; notes on what is allowed and seldom meant."""
    camera, light = scene.camera, scene.light
    position, target, up, place = (
        np.asarray(z, float) for z in (camera.position, camera.target, camera.up, light.position)
    )
    if camera.near >= camera.far:
        raise InputError(
            f"'{path}': camera.near: expected less than far, got near {camera.near:g} and far "
            f"{camera.far:g}"
        )
    along = target - position
    if not np.linalg.norm(along) > 0:
        raise InputError(f"'{path}': camera.target: expected a place other than position, got it")
    across = np.linalg.norm(np.cross(along, up))
    if not across > 1e-6 * np.linalg.norm(along) * np.linalg.norm(up):
        raise InputError(
            f"'{path}': camera.up: expected a direction other than the view's, got "
            f"{up.tolist()}; give another up"
        )
    away = np.linalg.norm(place - position)
    if away <= float(light.radius):
        raise InputError(
            f"'{path}': light.radius: expected less than the camera's distance {away:g}, got "
            f"{float(light.radius):g}: the camera is inside the light"
        )
    depth = (place - position) @ along / np.linalg.norm(along)
    if depth <= camera.near:
        raise InputError(
            f"'{path}': light.position: expected it before the camera, got depth {depth:g}, behind "
            "it or nearer than near; its rays would be mirrored. Move the camera or the light"
        )
    if depth - float(light.radius) >= camera.far:
        return ("the light lies beyond camera.far: nothing of it is drawn",)
    return ()


def _around_camera(scene: Scene) -> list[int]:
    """Objects that the camera is in."""
    found = []
    for i, thing in enumerate(scene.objects):
        world = np.asarray(thing.world(), np.float64)
        position = np.asarray(scene.camera.position, np.float64)
        if (world.min(0) < position).all() and (position < world.max(0)).all():
            shape = mesh.Mesh(world, np.asarray(thing.faces))
            found += [i] if mesh.contains(shape, position) else []
    return found

"""Scenes: a camera, a light and objects, from a TOML file or from a glTF file with all three.

Conventions are three.js's: right-handed, y up, the view of the camera is along its own -z,
rotations are Euler angles in the order XYZ (the matrix Rx Ry Rz), fields of view are vertical.
Colours are the bytes of the picture, not decoded: "#111111" is 17/255.

A scene is drawn twice, as in three.js with layers: the mask, in which objects have their `colour`
and the light is a sphere, and the ordinary pass, in which objects have their `albedo` and the light
lights them. An object can be in one of the two alone.
"""

from __future__ import annotations

import dataclasses
import difflib
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from godfit.errors import InputError, shown
from godfit.io.sidecar import SIDECAR_SCATTERING, shader_beside
from godfit.io.toml_table import Colour, Table
from godfit.io.transfer import TRANSFERS, checked_transfer
from godfit.runtime.guest import own_settings
from godfit.runtime.host_state import warnings_kept
from godfit.runtime.memory import check_memory
from godfit.runtime.program_cache import cached_jit
from godfit.scattering.conventions import AUTO, convention
from godfit.scattering.parameters import SCATTERING as PARAMETERS
from godfit.scenes import mesh
from godfit.scenes.gltf_view import view_of
from godfit.scenes.in_view import Frustum, why_not_in_view

CAMERA_FIELDS = ("position", "target", "up", "fov_y")
"""Fields of a camera that a fit can free."""
LIGHT_FIELDS = ("position", "radius")
"""Fields of a light that a fit can free."""
OBJECT_FIELDS = ("position", "rotation", "scale")
"""Fields of an object that a fit can free."""
GREY = (0.5, 0.5, 0.5)
"""Albedo of an object that has none: it leaves room for the light pass."""
MAX_PICTURE_SIDE = 16384
"""Largest height and width of a picture, in pixels: a mask of that side takes a gigabyte."""
DRAWING_BYTES = 50
"""Memory that drawing a mask takes a pixel, in bytes, measured at 4096x4096."""
SCATTERING_KEYS: dict[str, type] = {
    k: v for k, v in SIDECAR_SCATTERING.items() if k not in ("lights", "model", "rays")
} | dict.fromkeys(("exposure", "decay", "density", "weight"), float)
"""Keys of [scattering] and their types: a target's settings, and parameters for rendering."""
MIN_SAMPLES = 2
"""Least number of samples: one sample has no spacing."""
MAX_SAMPLES = 100_000
"""Largest number of samples, far above any shader's: the time of a sum grows with it."""
MAX_SETTING = 1e18
"""Largest value of a parameter without an upper bound: its square is finite in float32."""
SCATTERING_LIMITS = {p.name: (p.lower, min(p.upper, MAX_SETTING)) for p in PARAMETERS} | {
    "samples": (MIN_SAMPLES, MAX_SAMPLES),
    "pass_scale": (1e-3, 1),
}
"""Least and greatest value of a key of [scattering], both allowed."""
BLACK = (0.0, 0.0, 0.0)
"""Colour of objects and of the background where a file gives none."""
WHITE = (1.0, 1.0, 1.0)
"""Colour of a light whose file gives none."""
MIN_UP_SINE = 1e-6
"""Least sine of the angle between ``camera.up`` and the view: below it the camera has no sides."""


class Camera(eqx.Module):
    """A pinhole camera: position, target and up (3,); fov_y () in degrees; depths near and far."""

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
    """A mesh and its pose: vertices (v, 3) in the object's own space, faces (f, 3), edges (e, 4) as
    in ``godfit.scenes.mesh.edges``; position (3,), rotation (3,) in degrees, scale (); and which
    faces (f,) are drawn only from in front, where they are counter-clockwise (None for none)."""

    vertices: Float[Array, "v 3"]
    faces: Int[Array, "f 3"]
    edges: Int[Array, "e 4"]
    position: Float[Array, "3"]
    rotation: Float[Array, "3"]
    scale: Float[Array, ""]
    colour: Colour = eqx.field(static=True)
    albedo: Colour = eqx.field(static=True, default=GREY)
    in_mask: bool = eqx.field(static=True, default=True)
    in_ordinary: bool = eqx.field(static=True, default=True)
    single_sided: Bool[Array, " f"] | None = None

    def world(self) -> Float[Array, "v 3"]:
        """The vertices in the world."""
        return _posed(self.vertices, self.position, self.rotation, self.scale)


class Shading(NamedTuple):
    """How the ordinary pass is lit: the ``colour`` that it is cleared to, and what an object of
    albedo 1 gets from everywhere, ``ambient``, and from the light where it faces it, ``diffuse``.
    """

    colour: Colour = (0.0, 0.0, 0.0)
    ambient: float = 0.2
    diffuse: float = 0.8


class Scene(eqx.Module):
    """A scene whose mask can be drawn. ``size`` is (height, width) in pixels; ``antialias`` is None
    where the file leaves it open; ``scattering`` holds the shader's settings; ``shading`` is that
    of the ordinary pass; ``notes`` are for the user. With ``any_size`` the file gives no size, and
    a target's replaces the one here.

    >>> import godfit
    >>> godfit.read_scene("scene.toml").size
    (24, 32)
    """

    camera: Camera
    light: Light
    objects: tuple[Object, ...]
    background: Colour = eqx.field(static=True)
    size: tuple[int, int] = eqx.field(static=True)
    antialias: bool | None = eqx.field(static=True, default=None)
    scattering: tuple[tuple[str, Any], ...] = eqx.field(static=True, default=())
    notes: tuple[str, ...] = eqx.field(static=True, default=())
    shading: Shading = eqx.field(static=True, default=Shading())

    any_size: bool = eqx.field(static=True, default=False)

    @property
    def occluders(self) -> list[Object]:
        """The objects of the mask."""
        return [obj for obj in self.objects if obj.in_mask]

    @property
    def settings(self) -> dict[str, Any]:
        """The [scattering] table: shader, samples, and parameters for rendering."""
        return dict(self.scattering)

    @property
    def names(self) -> list[str]:
        """The names of all numbers that ``value`` returns and ``replaced`` replaces."""
        objects = [f"object[{i}].{n}" for i in range(len(self.objects)) for n in OBJECT_FIELDS]
        camera = [f"camera.{n}" for n in CAMERA_FIELDS]
        return camera + [f"light.{n}" for n in LIGHT_FIELDS] + objects

    def value(self, name: str) -> Float[Array, "..."]:
        """The number, () or (3,), of a name like ``object[0].position``. Raises InputError for an
        unknown name."""
        return _field(self, self._path(name))

    def replaced(self, values: Mapping[str, Array]) -> Scene:
        """The scene with other numbers, by name. Raises InputError for an unknown name."""
        paths = [self._path(name) for name in values]
        return eqx.tree_at(lambda s: [_field(s, p) for p in paths], self, list(values.values()))

    def camera_axes(self) -> Float[Array, "3 3"]:
        """The rotation from the world to the camera, its rows right, up and back: three.js's
        lookAt."""
        camera = self.camera
        back = camera.position - camera.target
        back = back / jnp.linalg.norm(back)
        right = jnp.cross(camera.up, back)
        right = right / jnp.linalg.norm(right)
        return jnp.stack([right, jnp.cross(back, right), back])

    def _path(self, name: str) -> tuple[str, int, str]:
        """A name as part, number of the object (0 for camera and light), and field."""
        if name not in self.names:
            near = difflib.get_close_matches(name, self.names, n=1, cutoff=0.0)[0]
            raise InputError(
                f"scene: expected one of {', '.join(self.names)}, got '{name}'; "
                f"did you mean '{near}'?"
            )
        part, number, key = re.fullmatch(r"(\w+)(?:\[(\d+)\])?\.(\w+)", name).groups()  # pyright: ignore[reportOptionalMemberAccess]
        return part, int(number or 0), key


def _field(scene: Scene, path: tuple[str, int, str]) -> Any:
    part, number, key = path
    return getattr(scene.objects[number] if part == "object" else getattr(scene, part), key)


def _rotation(angle: Float[Array, ""], i: int, j: int) -> Float[Array, "3 3"]:
    """The rotation by ``angle`` (radians) from axis i towards axis j."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    rows = [
        [jnp.asarray(float(row == column), angle.dtype) for column in range(3)] for row in range(3)
    ]
    rows[i][i], rows[i][j], rows[j][i], rows[j][j] = c, -s, s, c
    # A scatter (``.at[].set``) takes long to compile, and every object has three rotations.
    return jnp.stack([jnp.stack(row) for row in rows])


@cached_jit
def _posed(vertices, position, rotation, scale):
    x, y, z = jnp.deg2rad(rotation)
    turned = _rotation(x, 1, 2) @ _rotation(y, 2, 0) @ _rotation(z, 0, 1)
    return position[None] + (scale * vertices) @ turned.T


@warnings_kept()
def read_scene(path: str | os.PathLike[str]) -> Scene:
    """Read a scene file, or a glTF file with a camera and a light of its own. Raises InputError
    that names the file, the key, the expected and the actual value.

    >>> import godfit
    >>> len(godfit.read_scene("scene.toml").objects)
    1
    """
    with own_settings(any_precision=True):
        return _read_scene(Path(path))


def _read_scene(path: Path) -> Scene:
    """As ``read_scene``, under whatever settings JAX has."""
    suffix = path.suffix.lower()
    if suffix in mesh.GLTF_SUFFIXES:
        scene = _gltf_scene(path)
    elif suffix in mesh.MESH_SUFFIXES:
        raise InputError(
            f"'{path}': expected a scene file, got a mesh, which has no camera; write a .toml with "
            f"[image] width, height; [camera] position; [light] position, radius; [[object]] "
            f"mesh = '{path.name}'"
        )
    else:
        scene = _scene_file(path)
    notes = _check_scene(path, scene) + _placement_notes(scene)
    return dataclasses.replace(scene, notes=scene.notes + notes)


def _gltf_scene(path: Path) -> Scene:
    """The scene of a glTF file: its own camera and light, and all of its meshes as one object."""
    if not path.is_file():
        raise InputError(f"'{path}': expected a scene, got no such file; check the path")
    file = mesh.open_gltf(path)
    try:
        view = view_of(file)
    except InputError:
        raise
    except (ArithmeticError, LookupError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"'{path}': expected a camera and a light of glTF 2.0, got {type(error).__name__}: "
            f"{error}; export them again"
        ) from error
    numbers = (*view.position, *view.target, *view.light, view.fov_y, view.near, view.far)
    if not np.isfinite(numbers).all() or not (0 < view.fov_y < 180 and view.near > 0):
        raise InputError(
            f"'{path}': expected a camera with yfov below 180 degrees and znear above 0, got "
            f"{view.fov_y:g} and {view.near:g}; export it again"
        )
    camera = Camera(
        _array(view.position), _array(view.target), _array(view.up), _array(view.fov_y),
        view.near, view.far,
    )  # fmt: skip
    light = Light(_array(view.light), _array(view.radius), WHITE)
    shape = mesh.load(path)
    at_rest = _array([0.0, 0.0, 0.0]), _array([0.0, 0.0, 0.0]), _array(1.0)
    obj = _placed(shape, at_rest, BLACK)
    return Scene(
        camera, light, (obj,), BLACK, view.size, notes=shape.notes + view.notes, any_size=True
    )


def _scene_file(path: Path) -> Scene:
    """The scene of a TOML file."""
    root = Table.read(path, "a scene file")
    image, camera, light = (root.table(key) for key in ("image", "camera", "light"))
    size = tuple(image.whole(side, 1, MAX_PICTURE_SIDE) for side in ("height", "width"))
    check_memory(DRAWING_BYTES * size[0] * size[1], f"'{path}': {size[1]}x{size[0]} pixels")
    background, scattering, ordinary = (
        root.table(key, {}) for key in ("background", "scattering", "ordinary")
    )
    parts = [_object(Table(path, f"object[{i}]", t)) for i, t in enumerate(root.tables("object"))]
    root.finish()
    scattering.may_have(*SCATTERING_KEYS)
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
        tuple(obj for obj, _ in parts),
        background.colour("colour", "#000000"),
        (size[0], size[1]),
        image.switch("antialias"),
        tuple((key, _setting(scattering, key)) for key in list(scattering.data)),
        tuple(note for _, notes in parts for note in notes),
        Shading(
            ordinary.colour("colour", "#000000"),
            _share(ordinary, "ambient", Shading().ambient),
            _share(ordinary, "diffuse", Shading().diffuse),
        ),
    )
    for table in (image, camera, light, background, scattering, ordinary):
        table.finish()
    return scene


def _object(table: Table) -> tuple[Object, tuple[str, ...]]:
    """One [[object]], and notes on its mesh."""
    file, kind = table.text("mesh"), table.text("primitive")
    if (file is None) == (kind is None):
        raise table.error("mesh", "mesh or primitive", "both" if file else "neither")
    if file is not None:
        shape = mesh.load(table.path.parent / file)
    else:
        assert kind is not None
        if kind not in mesh.PRIMITIVES:
            raise table.error("primitive", f"one of {', '.join(mesh.PRIMITIVES)}", shown(kind))
        sizes = {}
        for key, default in mesh.PRIMITIVES[kind][1].items():
            if isinstance(default, list):
                sizes[key] = table.three(key, default, above=0.0)
            elif key in mesh.COUNT_LIMITS:
                sizes[key] = table.whole(key, *mesh.COUNT_LIMITS[key], default)
            else:
                sizes[key] = table.number(key, default, above=0.0)
        shape = mesh.primitive(kind, **sizes)
    pose = (
        _array(table.three("position", [0.0, 0.0, 0.0])),
        _array(table.three("rotation", [0.0, 0.0, 0.0])),
        _array(table.number("scale", 1.0, above=0.0)),
    )
    obj = dataclasses.replace(
        _placed(shape, pose, table.colour("colour", "#000000")),
        albedo=table.colour("albedo", list(GREY)),
        in_mask=table.switch("mask") is not False,
        in_ordinary=table.switch("ordinary") is not False,
    )
    table.finish()
    if not (obj.in_mask or obj.in_ordinary):
        raise table.error("mask", "true here or for ordinary", "false for both; leave it out")
    return obj, shape.notes


def _share(table: Table, key: str, default: float) -> float:
    """A number from 0 to 1."""
    value = table.number(key, default)
    if not 0 <= value <= 1:
        raise table.error(key, "a number from 0 to 1", repr(value))
    return value


def _placed(shape: mesh.Mesh, pose: tuple[Array, Array, Array], colour: Colour) -> Object:
    """A mesh as an object: ``pose`` has its position, rotation and scale."""
    return Object(
        _array(shape.vertices),
        jnp.asarray(shape.faces),
        jnp.asarray(mesh.edges(shape.faces, shape.single_sided)),
        *pose,
        colour,
        single_sided=None if shape.single_sided is None else jnp.asarray(shape.single_sided),
    )


def _setting(table: Table, key: str) -> Any:
    """The value of a key of [scattering], checked."""
    if key not in SCATTERING_KEYS:
        return None
    value = table.optional(key, SCATTERING_KEYS[key])
    expected = SCATTERING_LIMITS.get(key)
    if expected and not expected[0] <= value <= expected[1]:
        raise table.error(key, f"from {expected[0]:g} to {expected[1]:g}", shown(value))
    if key == "transfer":
        try:
            checked_transfer(value)
        except InputError:
            raise table.error(key, " or ".join(map(repr, TRANSFERS)), shown(value)) from None
    if key == "shader" and value != AUTO:
        value = shader_beside(table.path, value)
        try:
            convention(value)
        except InputError as error:
            raise InputError(f"'{table.path}': scattering.{error}") from None
    return float(value) if SCATTERING_KEYS[key] is float else value


def world_mesh(objects: Sequence[Object]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (v, 3) float64 of objects in the world, faces (f, 3) int32, and the place in
    ``objects`` (f,) int32 of the one that each face belongs to."""
    parts = [np.asarray(obj.world(), np.float64) for obj in objects]
    faces = [np.asarray(obj.faces, np.int32) for obj in objects]
    offsets = np.cumsum([0, *map(len, parts)])
    moved = [f + np.int32(o) for f, o in zip(faces, offsets[:-1], strict=True)]
    owner = np.repeat(np.arange(len(objects), dtype=np.int32), list(map(len, faces)))
    none = np.zeros((0, 3))
    return np.concatenate([*parts, none]), np.concatenate([*moved, none.astype(np.int32)]), owner


def _array(value: Any) -> Array:
    return jnp.asarray(value, float)


def _check_scene(path: Path, scene: Scene) -> tuple[str, ...]:
    """Check keys against each other. Raises InputError; returns notes on a scene that is allowed
    but seldom intended."""
    camera, light = scene.camera, scene.light
    position, target, up, light_position = (
        np.asarray(z, float) for z in (camera.position, camera.target, camera.up, light.position)
    )
    if camera.near >= camera.far:
        raise InputError(
            f"'{path}': camera.near: expected less than far, got near {camera.near:g} and far "
            f"{camera.far:g}"
        )
    view = target - position
    if not np.linalg.norm(view) > 0:
        raise InputError(f"'{path}': camera.target: expected a place other than position, got it")
    across = np.linalg.norm(np.cross(view, up))
    if not across > MIN_UP_SINE * np.linalg.norm(view) * np.linalg.norm(up):
        raise InputError(
            f"'{path}': camera.up: expected a direction other than the view's, got "
            f"{up.tolist()}; give another up"
        )
    distance = np.linalg.norm(light_position - position)
    if distance <= float(light.radius):
        raise InputError(
            f"'{path}': light.radius: expected less than the camera's distance {distance:g}, got "
            f"{float(light.radius):g}: the camera is inside the light"
        )
    depth = (light_position - position) @ view / np.linalg.norm(view)
    if depth <= camera.near:
        raise InputError(
            f"'{path}': light.position: expected it before the camera, got depth {depth:g}, behind "
            "it or nearer than near; its rays would be mirrored. Move the camera or the light"
        )
    if depth - float(light.radius) >= camera.far:
        return ("the light lies beyond camera.far: nothing of it is drawn",)
    return ()


def _placement_notes(scene: Scene) -> tuple[str, ...]:
    """Notes on the objects that the camera is inside of, or that it does not have in view."""
    notes, camera = [], scene.camera
    position = np.asarray(camera.position, np.float64)
    axes = np.asarray(scene.camera_axes(), np.float64)
    half = float(np.tan(np.deg2rad(float(camera.fov_y)) / 2))
    aspect = scene.size[1] / scene.size[0]
    frustum = Frustum(half * aspect, half, camera.near, camera.far)
    for i, obj in enumerate(scene.objects):
        world, faces = np.asarray(obj.world(), np.float64), np.asarray(obj.faces)
        single = None if obj.single_sided is None else np.asarray(obj.single_sided)
        where = why_not_in_view(((world - position) @ axes.T)[faces], frustum, single)
        # The box first: the test of a mesh takes every face.
        around = (world.min(0) < position).all() and (position < world.max(0)).all()
        if around and mesh.contains(mesh.Mesh(world, faces), position):
            where = None
            notes.append(f"the camera is inside object[{i}]")
        if where is not None:
            notes.append(f"object[{i}] is not in view: it lies {where}")
    return tuple(notes)

"""Scene -> ordinary pass: the scene as it is drawn without light rays.

Objects have their albedo times Lambert's cosine law: an even, ambient term, and one of the point
light at the middle of the light's sphere, which neither falls off with distance nor casts a shadow.
Every face is flat and has the same brightness on both sides. The light's sphere itself is in the
mask alone. The pass has no derivative.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from godfit.scenes.projection import (
    NO_SPHERE,
    CameraMesh,
    Lens,
    ProjectedScene,
    lens_of,
    screen_triangles,
)
from godfit.scenes.scene import Scene, world_mesh
from godfit.scenes.visibility import label_pixels

TINY = 1e-30
"""Least length to divide by: a face may have no area, and the light may touch a surface."""
RAYS_A_SIDE = 4
"""Rays along the side of a pixel where the scene is anti-aliased: 16 rays, as many as the finest
multisampling of a GPU."""
FIRST_FACE = 1
"""Label of the first face: 0 is that of a pixel without one."""


class _Faces(NamedTuple):
    """The faces of the ordinary pass in camera space: ``mesh``, whose labels number the faces;
    ``normal`` (f, 3), of length 1, on the camera's side; ``albedo`` (f, 3); and the place of the
    ``light`` (3,)."""

    mesh: CameraMesh
    normal: np.ndarray
    albedo: np.ndarray
    light: np.ndarray


def ordinary_pass(scene: Scene) -> np.ndarray:
    """The ordinary pass at the scene's size: (h, w), or (h, w, 3) where a colour is not grey,
    float32, linear, row 0 at the top."""
    rays, camera, faces = (
        1 if scene.antialias is False else RAYS_A_SIDE,
        scene.camera,
        _faces(scene),
    )
    focal = float(1 / np.tan(np.deg2rad(float(camera.fov_y)) / 2))
    lens = lens_of(scene.size, focal, camera.near, camera.far)
    total = np.zeros((*scene.size, 3), np.float32)
    offsets = (np.arange(rays) + 0.5) / rays - 0.5
    for x, y in itertools.product(offsets, offsets):
        # All pixels have the same places inside them: the picture is drawn once for each.
        moved = lens._replace(centre_x=lens.centre_x - x, centre_y=lens.centre_y - y)
        total += _shaded(faces, moved, scene)
    mean = (total / rays**2).clip(0, 1)
    return mean[..., 0] if (mean == mean[..., :1]).all() else mean


def _faces(scene: Scene) -> _Faces:
    """The faces of the objects in the ordinary pass."""
    objects = [obj for obj in scene.objects if obj.in_ordinary]
    vertices, faces, owner = world_mesh(objects)
    axes, eye = (np.asarray(z, np.float64) for z in (scene.camera_axes(), scene.camera.position))
    vertices = (vertices - eye) @ axes.T
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal *= np.where((normal * a).sum(-1, keepdims=True) > 0, -1, 1)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), TINY)
    albedo = np.array([obj.albedo for obj in objects]).reshape(-1, 3)[owner]
    labels = np.arange(FIRST_FACE, FIRST_FACE + len(faces), dtype=np.int32)
    sides = [
        np.zeros(len(obj.faces), bool) if obj.single_sided is None else np.asarray(obj.single_sided)
        for obj in objects
    ]
    mesh = CameraMesh(vertices, faces, labels, np.concatenate([np.zeros(0, bool), *sides]))
    light = axes @ (np.asarray(scene.light.position, np.float64) - eye)
    return _Faces(mesh, normal, albedo, light)


def _shaded(faces: _Faces, lens: Lens, scene: Scene) -> np.ndarray:
    """(h, w, 3) the colours at the pixel centres through ``lens``."""
    triangles, _ = screen_triangles(faces.mesh, lens, scene.size)
    label, q = label_pixels(ProjectedScene(triangles, NO_SPHERE, lens), scene.size)
    rows, columns = np.nonzero(label >= FIRST_FACE)
    face = label[rows, columns] - FIRST_FACE
    x = (columns + 0.5 - lens.centre_x) / lens.focal_x
    y = (lens.centre_y - rows - 0.5) / lens.focal_y
    points = np.stack([x, y, -np.ones_like(x)], -1) / q[rows, columns, None]
    away = faces.light - points
    distance = np.maximum(np.linalg.norm(away, axis=-1), TINY)
    cosine = np.maximum((faces.normal[face] * away).sum(-1) / distance, 0)
    shading = scene.shading
    image = np.empty((*scene.size, 3), np.float32)
    image[:] = shading.colour
    lit = shading.ambient + shading.diffuse * cosine[:, None] * np.array(scene.light.colour)
    image[rows, columns] = faces.albedo[face] * lit
    return image

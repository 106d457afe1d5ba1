"""Shadow maps of a scene's light, and the lit share of every step along rays. Compiled.

The project's own z-buffer (``visibility.py``) draws the view from the source: one view for the sun,
from so far away that its rays are as good as parallel, and the six faces of a cube for a lamp
(Williams, SIGGRAPH 1978). Nothing here has a derivative.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from godfit.runtime.numba_jit import jit
from godfit.scenes.labels import FIRST_OBJECT_LABEL
from godfit.scenes.projection import NO_SPHERE, CameraMesh, Lens, ProjectedScene, screen_triangles
from godfit.scenes.scene import Scene, world_mesh
from godfit.scenes.visibility import label_pixels, map_row_bands

Source = Literal["sun", "lamp"]
SUN_DISTANCE = 1e5
"""Distance of the sun's view from the middle of the scene, in radii of the scene: its rays are
parallel to 1e-5."""
SUN_VIEW_MARGIN = 1.001
"""Half width of the sun's view, in radii of the scene: a thousandth more than the scene needs."""
MIN_SCENE_RADIUS = 1e-9
"""Least radius of a scene, in its own unit: a scene of one point has a view as well."""
LAMP_NEAR = 1e-6
"""Near plane of a lamp's views, in distances of the farthest vertex."""
SHADOW_BISECTIONS = 10
"""Bisections for the place on a ray where light and shade change: 1/1024 of a step."""


class ShadowMap(NamedTuple):
    """Depths from the source: its ``position`` (3,); ``axes`` (views, 3, 3), right, up and back of
    each view; ``q`` (views, n, n), 1/depth of the nearest surface, 0 where there is none; and
    ``focal``, the focal length in pixels."""

    position: np.ndarray
    axes: np.ndarray
    q: np.ndarray
    focal: float


class SteppedRays(NamedTuple):
    """Rays from ``origin`` (3,) along ``direction`` (n, 3), cut into even steps of u from ``begin``
    to ``end`` (n,).

    For the sun, u is the length along the ray. For a lamp, u is an angle at the lamp, and the point
    lies ``passed`` + ``apart`` tan(u) along the ray: the ray passes the lamp at ``passed`` (n,), at
    the distance ``apart`` (n,).
    """

    origin: np.ndarray
    direction: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    passed: np.ndarray
    apart: np.ndarray


def _view_axes(forward: np.ndarray) -> np.ndarray:
    """(3, 3) right, up and back of a view along ``forward``."""
    back = -forward / np.linalg.norm(forward)
    side = np.eye(3)[int(np.argmin(np.abs(back)))]
    right = np.cross(side, back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back])


def shadow_map(scene: Scene, source: Source, resolution: int) -> ShadowMap:
    """The shadow map of a scene's light, with ``resolution`` pixels a side: one view for the sun,
    the six faces of a cube for a lamp."""
    vertices, faces, _ = world_mesh(scene.occluders)
    lamp = np.asarray(scene.light.position, np.float64)
    half = resolution / 2
    if source == "sun":
        low, high = (vertices.min(0), vertices.max(0)) if len(vertices) else (lamp, lamp)
        middle = (low + high) / 2
        radius = max(float(np.linalg.norm(high - low)) / 2, MIN_SCENE_RADIUS)
        away = lamp - np.asarray(scene.camera.position, np.float64)
        position = middle + away / np.linalg.norm(away) * SUN_DISTANCE * radius
        axes = _view_axes(middle - position)[None]
        focal = half * SUN_DISTANCE / SUN_VIEW_MARGIN
        near, far = (SUN_DISTANCE - 2) * radius, np.inf
    else:
        position, far = lamp, np.inf
        axes = np.stack([_view_axes(sign * axis) for axis in np.eye(3) for sign in (1, -1)])
        focal = half
        farthest = np.linalg.norm(vertices - position, axis=1).max(initial=1.0)
        near = LAMP_NEAR * float(farthest)
    lens = Lens(focal, focal, half, half, near, far)
    labels = np.full(len(faces), FIRST_OBJECT_LABEL, np.int32)
    q = np.zeros((len(axes), resolution, resolution))
    size = (resolution, resolution)
    for i, view in enumerate(axes):
        mesh = CameraMesh((vertices - position) @ view.T, faces, labels)
        triangles, _ = screen_triangles(mesh, lens, size)
        q[i] = label_pixels(ProjectedScene(triangles, NO_SPHERE, lens), size)[1]
    return ShadowMap(position, axes, q, focal)


@jit
def _is_lit(x, y, z, shadow):
    """Whether the source lights a point of the world."""
    position, axes, q = shadow.position, shadow.axes, shadow.q
    x, y, z = x - position[0], y - position[1], z - position[2]
    n = q.shape[1]
    for f in range(q.shape[0]):
        depth = -(axes[f, 2, 0] * x + axes[f, 2, 1] * y + axes[f, 2, 2] * z)
        if depth <= 0:
            continue
        across = axes[f, 0, 0] * x + axes[f, 0, 1] * y + axes[f, 0, 2] * z
        up = axes[f, 1, 0] * x + axes[f, 1, 1] * y + axes[f, 1, 2] * z
        column = int(np.floor(0.5 * n + shadow.focal * across / depth))
        row = int(np.floor(0.5 * n - shadow.focal * up / depth))
        if 0 <= column < n and 0 <= row < n:
            return q[f, row, column] * depth <= 1.0
    return True


@jit
def _lit_shares(rays, shadow, lamp, first, last, lit):
    """Fill ``lit`` (steps, n) for rays first to before last; ``lamp`` is False for the sun."""
    steps = lit.shape[0]
    origin, direction = rays.origin, rays.direction
    passed, apart = rays.passed, rays.apart

    def lit_at(i, u):
        s = passed[i] + apart[i] * np.tan(u) if lamp else u
        x, y, z = (
            origin[0] + s * direction[i, 0],
            origin[1] + s * direction[i, 1],
            origin[2] + s * direction[i, 2],
        )
        return _is_lit(x, y, z, shadow)

    for i in range(first, last):
        width = (rays.end[i] - rays.begin[i]) / steps
        before = False
        for k in range(steps + 1):
            here = False
            if k < steps:
                middle = rays.begin[i] + (k + 0.5) * width
                here = lit_at(i, middle)
                lit[k, i] = 1.0 if here else 0.0
            if 0 < k < steps and here != before:
                # In steps, from the middle of the step before.
                low, high = 0.0, 1.0
                for _ in range(SHADOW_BISECTIONS):
                    part = 0.5 * (low + high)
                    if lit_at(i, middle + (part - 1.0) * width) == before:
                        low = part
                    else:
                        high = part
                change = 0.5 * (low + high) - 0.5
                sign = 1.0 if here else -1.0
                if change < 0:
                    lit[k - 1, i] += sign * -change
                else:
                    lit[k, i] -= sign * change
            before = here


def lit_shares(rays: SteppedRays, shadow: ShadowMap, source: Source, steps: int) -> np.ndarray:
    """(steps, n) float32, the share of every step of the n rays that the source lights.

    Where light and shade change between the middles of two steps, bisection finds the place.
    """
    lit = np.empty((steps, len(rays.direction)), np.float32)

    def fill(first: int, last: int) -> None:
        _lit_shares(rays, shadow, source == "lamp", first, last, lit)

    map_row_bands(len(rays.direction), fill)
    return lit

"""Where a scene's light is seen from: shadow maps, and rays cut into lit and shaded shares.

What the source sees is drawn by the project's own rasteriser (``visibility.py``), from so far away
that the view is as good as parallel for the sun, and into the six faces of a cube for a lamp
(Williams, SIGGRAPH 1978). Compiled; without derivative.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from godfit.runtime.numba_jit import jit
from godfit.scenes import projection, visibility
from godfit.scenes.scene import Scene

Source = Literal["sun", "lamp"]
# The sun, seen from the middle of the scene, in radii of the scene: parallel to 1e-5.
FAR_AWAY = 1e5
HALVINGS = 10


class Shadows(NamedTuple):
    """What the source sees: ``position`` (3,), ``axes`` (faces, 3, 3) right, up and back of each
    view, ``q`` (faces, n, n) one over the depth of the nearest surface (0 where there is none), and
    the focal length in pixels."""

    position: np.ndarray
    axes: np.ndarray
    q: np.ndarray
    focal: float


def _look(forward: np.ndarray) -> np.ndarray:
    """(3, 3) right, up and back of a view along ``forward``."""
    back = -forward / np.linalg.norm(forward)
    side = np.eye(3)[int(np.argmin(np.abs(back)))]
    right = np.cross(side, back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back])


def shadows(scene: Scene, source: Source, resolution: int) -> Shadows:
    """The shadow map: one square view of the sun's, a cube of six for a lamp."""
    parts = [np.asarray(thing.world(), np.float64) for thing in scene.objects]
    vertices = np.concatenate([*parts, np.zeros((0, 3))])
    offsets = np.cumsum([0, *(len(part) for part in parts)])
    faces = np.concatenate(
        [np.zeros((0, 3), np.int32)]
        + [np.asarray(t.faces) + o for t, o in zip(scene.objects, offsets[:-1], strict=True)]
    ).astype(np.int32)
    lamp = np.asarray(scene.light.position, np.float64)
    half = resolution / 2
    if source == "sun":
        low, high = (vertices.min(0), vertices.max(0)) if len(vertices) else (lamp, lamp)
        middle, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-9)
        away = lamp - np.asarray(scene.camera.position, np.float64)
        position = middle + away / np.linalg.norm(away) * FAR_AWAY * radius
        axes = _look(middle - position)[None]
        # The view's half width is the scene's radius and a little.
        focal, near, far = half * FAR_AWAY / 1.001, (FAR_AWAY - 2) * radius, np.inf
    else:
        position, far = lamp, np.inf
        axes = np.stack([_look(sign * axis) for axis in np.eye(3) for sign in (1, -1)])
        focal = half
        reach = np.linalg.norm(vertices - position, axis=1).max(initial=1.0)
        near = 1e-6 * float(reach)
    lens = projection.Lens(focal, focal, half, half, near, far)
    labels = np.full(len(faces), visibility.FIRST_OBJECT, np.int32)
    q = np.zeros((len(axes), resolution, resolution))
    size = (resolution, resolution)
    for i, view in enumerate(axes):
        camera = (vertices - position) @ view.T
        triangles, _ = projection.screen_triangles(camera, faces, labels, lens, size)
        # No light is drawn: it is where the view is from.
        q[i] = visibility.label(triangles, lens, np.array([0.0, 0.0, 1.0]), 0.0, size)[1]
    return Shadows(position, axes, q, focal)


@jit
def _is_lit(x, y, z, position, axes, q, focal):
    x, y, z = x - position[0], y - position[1], z - position[2]
    n = q.shape[1]
    for f in range(q.shape[0]):
        depth = -(axes[f, 2, 0] * x + axes[f, 2, 1] * y + axes[f, 2, 2] * z)
        if depth <= 0:
            continue
        across = axes[f, 0, 0] * x + axes[f, 0, 1] * y + axes[f, 0, 2] * z
        up = axes[f, 1, 0] * x + axes[f, 1, 1] * y + axes[f, 1, 2] * z
        column = int(np.floor(0.5 * n + focal * across / depth))
        row = int(np.floor(0.5 * n - focal * up / depth))
        if 0 <= column < n and 0 <= row < n:
            return q[f, row, column] * depth <= 1.0
    return True


@jit
def _lit_shares(
    origin, direction, begin, end, passed, apart, lamp, position, axes, q, focal, first, last, lit
):
    """Fill lit (steps, n) for rays first to last: u runs from begin to end in even steps, and the
    point is u along the ray, or for a lamp passed + apart tan(u)."""
    steps = lit.shape[0]

    def seen(i, u):
        s = passed[i] + apart[i] * np.tan(u) if lamp else u
        x, y, z = (
            origin[0] + s * direction[i, 0],
            origin[1] + s * direction[i, 1],
            origin[2] + s * direction[i, 2],
        )
        return _is_lit(x, y, z, position, axes, q, focal)

    for i in range(first, last):
        width = (end[i] - begin[i]) / steps
        before = False
        for k in range(steps + 1):
            here = False
            if k < steps:
                middle = begin[i] + (k + 0.5) * width
                here = seen(i, middle)
                lit[k, i] = 1.0 if here else 0.0
            if 0 < k < steps and here != before:
                # In steps from the middle of the one before.
                low, high = 0.0, 1.0
                for _ in range(HALVINGS):
                    part = 0.5 * (low + high)
                    if seen(i, middle + (part - 1.0) * width) == before:
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


def lit_shares(
    origin: np.ndarray,
    direction: np.ndarray,
    begin: np.ndarray,
    end: np.ndarray,
    passed: np.ndarray,
    apart: np.ndarray,
    shadow: Shadows,
    source: Source,
    steps: int,
) -> np.ndarray:
    """(steps, n) float32, the share of every step that the source lights, for rays from ``origin``
    (3,) along ``direction`` (n, 3).

    Steps are even in u, from ``begin`` to ``end`` (n,): u is the length along the ray for the sun;
    for a lamp it is the angle at which the point ``passed`` + ``apart`` tan(u) is seen from it.
    Where light and shade change between two steps' middles, the place is found by halving.
    """
    lit = np.empty((steps, len(direction)), np.float32)

    def work(first: int, last: int) -> None:
        _lit_shares(
            origin, direction, begin, end, passed, apart, source == "lamp", *shadow, first, last,
            lit,
        )  # fmt: skip

    visibility.share_rows(len(direction), work)
    return lit

"""Bodies of scene files, built from primitives.

A body is a list of parts, each an [[object]] of a scene file: ``at`` is its position and ``turn``
its rotation about x, y and z in degrees. ``placed`` moves a body as a whole.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

Part = dict[str, Any]
Vector3 = tuple[float, float, float]


def box(x: float, y: float, z: float, *, at: Vector3, turn: Vector3 = (0, 0, 0)) -> Part:
    """A box of these three sides."""
    return _part("box", at, turn, size=[x, y, z])


def ball(radius: float, *, at: Vector3, turn: Vector3 = (0, 0, 0), subdivisions: int = 3) -> Part:
    """An icosahedron, its faces divided so many times."""
    return _part("icosphere", at, turn, radius=radius, subdivisions=subdivisions)


def rod(
    radius: float, height: float, *, at: Vector3, turn: Vector3 = (0, 0, 0), segments: int = 32
) -> Part:
    """A cylinder along y."""
    return _part("cylinder", at, turn, radius=radius, height=height, segments=segments)


def ring(radius: float, tube: float, *, at: Vector3, turn: Vector3 = (0, 0, 0)) -> Part:
    """A torus about z."""
    return _part("torus", at, turn, radius=radius, tube=tube)


def floor(width: float, depth: float, *, at: Vector3) -> Part:
    """A horizontal rectangle."""
    return _part("plane", at, (-90, 0, 0), width=width, height=depth)


def _part(primitive: str, at: Vector3, turn: Vector3, **sizes: Any) -> Part:
    return {"primitive": primitive, **sizes, "position": at, "rotation": turn}


def strut(radius: float, start: Vector3, end: Vector3) -> Part:
    """A thin cylinder between two points."""
    along = np.subtract(end, start)
    x, y, z = along / np.linalg.norm(along)
    # Rx Ry Rz takes y to (-sin c, cos a cos c, sin a cos c), with b = 0.
    turn = np.rad2deg([np.arctan2(z, y), 0, np.arctan2(-x, np.hypot(y, z))])
    middle = np.add(start, end) / 2
    return rod(
        radius,
        float(np.linalg.norm(along)),
        at=tuple(middle.tolist()),
        turn=tuple(turn.tolist()),
        segments=12,
    )


def rotation_matrix(turn: Vector3) -> np.ndarray:
    """(3, 3) Rx Ry Rz of angles in degrees."""
    product = np.eye(3)
    for angle, i, j in zip(np.deg2rad(turn), (1, 2, 0), (2, 0, 1), strict=True):
        about_axis = np.eye(3)
        about_axis[[i, j, i, j], [i, j, j, i]] = (
            np.cos(angle),
            np.cos(angle),
            -np.sin(angle),
            np.sin(angle),
        )
        product = product @ about_axis
    return product


GIMBAL_LOCK = 0.9999999
"""The sine of the angle about y from which on the other two are not determined, as in three.js."""


def rotation_angles(matrix: np.ndarray) -> Vector3:
    """The angles of a rotation matrix in degrees, as three.js computes them."""
    y = np.arcsin(np.clip(matrix[0, 2], -1, 1))
    if abs(matrix[0, 2]) < GIMBAL_LOCK:
        x, z = np.arctan2(-matrix[1, 2], matrix[2, 2]), np.arctan2(-matrix[0, 1], matrix[0, 0])
    else:
        x, z = np.arctan2(matrix[2, 1], matrix[1, 1]), 0.0
    x, y, z = np.rad2deg([x, y, z]).tolist()
    return x, y, z


def placed(
    parts: Iterable[Part], at: Vector3, turn: Vector3 | np.ndarray = (0, 0, 0), scale: float = 1.0
) -> list[Part]:
    """The parts as one body, scaled, turned (degrees, or a matrix) and moved."""
    rotation = turn if isinstance(turn, np.ndarray) else rotation_matrix(turn)
    return [
        part
        | {
            "position": (np.array(at) + scale * rotation @ part["position"]).tolist(),
            "rotation": rotation_angles(rotation @ rotation_matrix(part["rotation"])),
            "scale": scale * part.get("scale", 1.0),
        }
        for part in parts
    ]

"""Whether an object can be drawn at all: why none of its faces lies in the camera's frustum."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Frustum(NamedTuple):
    """What a camera has in view: half the width and half the height of the picture at depth 1, and
    the depths near and far."""

    half_width: float
    half_height: float
    near: float
    far: float


def why_not_in_view(
    corners: np.ndarray, frustum: Frustum, single_sided: np.ndarray | None = None
) -> str | None:
    """Where an object lies of which nothing is in view; None where some of it may be.

    ``corners`` (f, 3, 3) are those of its faces in camera space, x right, y up and z back. A face
    is out of view where all its corners lie beyond one plane of the frustum. ``single_sided`` (f,)
    faces are drawn only where they are counter-clockwise.
    """
    x, y, depth = corners[..., 0], corners[..., 1], -corners[..., 2]
    if (depth < frustum.near).all():
        return "behind the camera, or nearer than camera.near"
    if (depth > frustum.far).all():
        return "beyond camera.far"
    wide, high = frustum.half_width * depth, frustum.half_height * depth
    beyond = (depth < frustum.near, depth > frustum.far, x > wide, x < -wide, y > high, y < -high)
    outside = np.any([plane.all(-1) for plane in beyond], axis=0)
    if outside.all():
        return "outside the frame"
    if single_sided is not None:
        a, b, c = (corners[:, k] for k in range(3))
        from_behind = (np.cross(b - a, c - a) * a).sum(-1) >= 0
        if (outside | (single_sided & from_behind)).all():
            return "with its back to the camera, and its faces are single-sided"
    return None

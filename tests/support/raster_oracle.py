"""The obviously right rasteriser: a ray for every sample, every triangle tried, float64 numpy."""

from __future__ import annotations

import numpy as np


def view(scene):
    """World to camera: (3, 3) rows right, up, back, and the camera's position."""
    position, target, up = (
        np.asarray(z, float) for z in (scene.camera.position, scene.camera.target, scene.camera.up)
    )
    back = (position - target) / np.linalg.norm(position - target)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back]), position


def labels(scene, factor: int = 1) -> np.ndarray:
    """(h factor, w factor) labels of the nearest surface at the centres of the finer pixels."""
    return nearest(scene, factor)[0]


def nearest(scene, factor: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """(h factor, w factor) labels and depths of the nearest surface at the centres of the finer
    pixels; the depth is infinite where nothing is."""
    height, width = (n * factor for n in scene.size)
    turn, position = view(scene)
    half = np.tan(np.deg2rad(float(scene.camera.fov_y)) / 2)
    x = ((np.arange(width) + 0.5) / width * 2 - 1) * half * width / height
    y = (1 - (np.arange(height) + 0.5) / height * 2) * half
    near, far = float(scene.camera.near), float(scene.camera.far)
    found = np.zeros((height, width), np.int32)
    depth = np.full((height, width), far)
    for i, thing in enumerate(scene.objects):
        corners = (np.asarray(thing.world(), float) - position) @ turn.T
        for a, b, c in corners[np.asarray(thing.faces)]:
            rows, columns = _box(a, b, c, x, y, near)
            if rows.size and columns.size:
                where = np.ix_(rows, columns)
                t = hit(a, b, c, x[columns][None], y[rows][:, None])
                closer = (t >= near) & (t < depth[where])
                depth[where] = np.where(closer, t, depth[where])
                found[where] = np.where(closer, i + 2, found[where])
    centre = turn @ (np.asarray(scene.light.position, float) - position)
    gx, gy = x[None], y[:, None]
    length = gx**2 + gy**2 + 1
    along = gx * centre[0] + gy * centre[1] - centre[2]
    inside = along**2 - length * (centre @ centre - float(scene.light.radius) ** 2)
    t = (along - np.sqrt(np.maximum(inside, 0))) / length
    lit = (inside > 0) & (t >= near) & (t < depth)
    found, depth = np.where(lit, 1, found), np.where(lit, t, depth)
    return found, np.where(found == 0, np.inf, depth)


def _box(a, b, c, x, y, near):
    """Rows and columns that a triangle can cover; all of them where it reaches the near plane."""
    corners = np.stack([a, b, c])
    if (-corners[:, 2] < near).all():
        return np.empty(0, int), np.empty(0, int)
    if (-corners[:, 2] < near).any():
        return np.arange(len(y)), np.arange(len(x))
    px, py = corners[:, 0] / -corners[:, 2], corners[:, 1] / -corners[:, 2]
    return (
        np.flatnonzero((y >= py.min()) & (y <= py.max())),
        np.flatnonzero((x >= px.min()) & (x <= px.max())),
    )


def hit(a, b, c, x, y):
    """Depth at which the rays (x, y, -1) meet a triangle, infinite where they do not."""
    n = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (n @ a) / (x * n[0] + y * n[1] - n[2])
        inside = np.ones(np.broadcast(x, y).shape, bool)
        for p, q in ((a, b), (b, c), (c, a)):
            edge = np.cross(n, q - p)
            inside &= t * (x * edge[0] + y * edge[1] - edge[2]) >= edge @ p
        return np.where(inside & np.isfinite(t), t, np.inf)


def shares(scene, factor: int = 32) -> np.ndarray:
    """(h, w, labels) share of every pixel that each label has, by factor x factor samples."""
    height, width = scene.size
    found = labels(scene, factor)
    out = np.empty((height, width, 2 + len(scene.objects)))
    for k in range(out.shape[-1]):
        cells = (found == k).reshape(height, factor, width, factor)
        out[..., k] = cells.mean((1, 3))
    return out


def mask(scene, factor: int = 32) -> np.ndarray:
    """(h, w) grey mask by supersampling."""
    colours = [scene.background, scene.light.colour, *(o.colour for o in scene.objects)]
    return shares(scene, factor) @ np.array([c[0] for c in colours], float)

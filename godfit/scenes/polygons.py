"""Faces with more than three corners, as triangles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

FAN_TOLERANCE = 1e-9
"""Share of a polygon's squared area by which a triangle may be turned over: rounding, at corners
that lie on one line."""
AREA_TOLERANCE = 1e-6
"""Share of a polygon's area by which the sum of its triangles may differ from it: rounding."""


def triangulated(vertices: np.ndarray, rings: Sequence[np.ndarray]) -> tuple[np.ndarray, int]:
    """Faces (f, 3) int64 that cover polygons, each a ring of indices (k,) into ``vertices``
    (v, 3); and how many of the polygons cross themselves, which no triangulation covers.

    A polygon is projected onto its Newell plane, whose normal is the sum of the cross products of
    its edges (Sutherland, Sproull & Schumacher 1974). It becomes a fan around its first corner
    where no triangle of the fan is turned over, as in every convex polygon. A quadrilateral else
    becomes the fan around its second corner. The ears of other polygons are clipped by
    ``mapbox_earcut``. Rings of fewer than three corners have no area and are dropped.
    """
    lengths = np.array([len(ring) for ring in rings], np.int64)
    faces, crossed = [np.zeros((0, 3), np.int64)], 0
    for k in np.unique(lengths[lengths > 2]).tolist():
        rows = np.stack([rings[i] for i in np.flatnonzero(lengths == k).tolist()]).astype(np.int64)
        if k > 3:
            concave = ~_may_be_fans(vertices[rows])
            if k == 4:
                # Each simple one is the fan around one end of a diagonal that lies inside.
                rows[concave] = np.roll(rows[concave], -1, axis=1)
                crossed += int((~_may_be_fans(vertices[rows[concave]])).sum())
            else:
                for row in rows[concave]:
                    ears, covers = _ears(vertices[row])
                    faces.append(row[ears])
                    crossed += not covers
                rows = rows[~concave]
        first = np.broadcast_to(rows[:, :1], (len(rows), k - 2))
        faces.append(np.stack([first, rows[:, 1:-1], rows[:, 2:]], -1).reshape(-1, 3))
    return np.concatenate(faces), crossed


def _may_be_fans(corners: np.ndarray) -> np.ndarray:
    """(n,) whether the fan around the first corner covers each of the polygons (n, k, 3). True for
    corners that are not finite: no triangulation covers these."""
    with np.errstate(over="ignore", invalid="ignore"):
        spokes = corners[:, 1:] - corners[:, :1]
        areas = np.cross(spokes[:, :-1], spokes[:, 1:])
        normal = areas.sum(1)
        along = (areas * normal[:, None]).sum(-1)
        least = -FAN_TOLERANCE * (normal**2).sum(-1)
        turned_over = (along < least[:, None]).any(-1)
        folded = (normal == 0).all(-1) & (areas != 0).any((1, 2))
        return ~(turned_over | folded) | ~np.isfinite(normal).all(-1)


def _ears(corners: np.ndarray) -> tuple[np.ndarray, bool]:
    """Triangles (t, 3) of one polygon (k, 3), as indices of its corners, turned as the polygon is;
    and whether their areas add up to the polygon's."""
    # Imported here: most meshes have no concave polygon.
    import mapbox_earcut

    spokes = corners - corners[0]
    normal = np.cross(spokes[1:-1], spokes[2:]).sum(0)
    area = np.linalg.norm(normal)
    if area == 0:
        return np.zeros((0, 3), np.int64), False
    side = np.eye(3)[np.argmin(np.abs(normal))]
    right = np.cross(side, normal)
    right /= np.linalg.norm(right)
    flat = spokes @ np.stack([right, np.cross(normal / area, right)], 1)
    ends = np.array([len(flat)], np.uint32)
    ears = mapbox_earcut.triangulate_float64(np.ascontiguousarray(flat), ends)
    ears = ears.reshape(-1, 3).astype(np.int64)
    (ax, ay), (bx, by) = (np.moveaxis(flat[ears[:, i]] - flat[ears[:, 0]], -1, 0) for i in (1, 2))
    areas = ax * by - ay * bx
    ears[areas < 0] = ears[areas < 0][:, ::-1]
    return ears, bool(abs(np.abs(areas).sum() - area) <= AREA_TOLERANCE * area)

"""Meshes: from files and from formulas, as vertices, faces and the edges between them."""

from __future__ import annotations

import json
import logging
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from godfit.errors import InputError

FORMATS = (".gltf", ".glb", ".obj", ".ply", ".stl")


class Mesh(NamedTuple):
    """Vertices (v, 3) float64, each position once; faces (f, 3) int32; notes for the user."""

    vertices: np.ndarray
    faces: np.ndarray
    notes: tuple[str, ...] = ()


def load(path: Path) -> Mesh:
    """A glTF, GLB, OBJ, PLY or STL file, its whole scene graph with transforms; materials and
    textures are not looked at. Raises InputError."""
    if not path.is_file():
        raise InputError(f"'{path}': expected a mesh, got no such file; check the path")
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"'{path}': expected one of {', '.join(FORMATS)}, got '{path.suffix}'")
    if path.stat().st_size == 0:
        raise InputError(f"'{path}': expected a mesh, got an empty file; export it again")
    import trimesh

    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            # What it says of textures and normals does not matter here.
            warnings.simplefilter("ignore")
            # `process` would drop vertices that are not finite before anyone is told.
            scene = trimesh.load_scene(path, process=False, skip_materials=True)
            parts = [
                (np.asarray(part.vertices, np.float64), np.asarray(part.faces, np.int64))
                for part in scene.dump()
                if isinstance(part, trimesh.Trimesh)
            ]
    except Exception as error:
        # Its loaders raise whatever their parsers do.
        raise InputError(
            f"'{path}': expected a mesh, got {type(error).__name__}: {error}; export it again"
        ) from error
    parts = [(v, f) for v, f in parts if len(f)]
    if not parts:
        raise InputError(f"'{path}': expected triangles, got none; export faces, not points")
    first, vertices, faces = 0, [], []
    for v, f in parts:
        if f.min() < 0 or f.max() >= len(v):
            raise InputError(
                f"'{path}': expected indices from 0 to {len(v) - 1}, got {f.min()} to {f.max()}; "
                "export it again"
            )
        vertices.append(v)
        faces.append(f + first)
        first += len(v)
    mesh = clean(np.concatenate(vertices), np.concatenate(faces), str(path))
    return mesh._replace(notes=mesh.notes + _missing_textures(path))


def clean(vertices: np.ndarray, faces: np.ndarray, name: str) -> Mesh:
    """Positions merged, and without the faces that have no area or are there twice."""
    used = np.unique(faces)
    if not np.isfinite(vertices[used]).all():
        bad = int((~np.isfinite(vertices[used])).any(-1).sum())
        raise InputError(
            f"'{name}': expected finite vertices, got {bad:,} with NaN or infinity; export it again"
        )
    # -0.0 and 0.0 are one place.
    vertices, which = np.unique(vertices + 0.0, axis=0, return_inverse=True)
    faces = which.reshape(-1)[faces]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    flat = (np.cross(b - a, c - a) == 0).all(-1)
    notes = ()
    if flat.any():
        notes = (f"'{name}': {int(flat.sum()):,} of {len(flat):,} triangles without area ignored",)
    faces = faces[~flat]
    if not len(faces):
        raise InputError(f"'{name}': expected triangles with an area, got none; export it again")
    _, once = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    faces = faces[np.sort(once)]
    used, which = np.unique(faces, return_inverse=True)
    return Mesh(vertices[used], which.reshape(-1, 3).astype(np.int32), notes)


def edges(faces: np.ndarray) -> np.ndarray:
    """(e, 4) int32, every edge once: its ends a, b and the corners of its two faces across from
    it, c, d; -1 for d where there is one face, for both where there are more than two."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    across = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]])
    low, high = ends.min(1), ends.max(1)
    key = low * (int(faces.max()) + 1) + high
    order = np.argsort(key, kind="stable")
    key, low, high, across = key[order], low[order], high[order], across[order]
    first = np.flatnonzero(np.diff(key, prepend=-1))
    count = np.diff(first, append=len(key))
    c = np.where(count <= 2, across[first], -1)
    d = np.where(count == 2, across[np.minimum(first + 1, len(key) - 1)], -1)
    return np.stack([low[first], high[first], c, d], 1).astype(np.int32)


def contains(mesh: Mesh, point: np.ndarray) -> bool:
    """Whether a point is inside a closed mesh: a ray from it crosses the surface an odd number of
    times. False for meshes with a border."""
    if (edges(mesh.faces)[:, 3] < 0).any():
        return False
    a, b, c = (mesh.vertices[mesh.faces[:, k]] - point for k in range(3))
    # A direction that no modelled edge lies in.
    ray = np.array([0.5377, 0.2718, 0.7983])
    n = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (n * a).sum(-1) / (n @ ray)
        inside = t > 0
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= (np.cross(n, q - p) * (t[:, None] * ray - p)).sum(-1) >= 0
    return bool(inside.sum() % 2)


def _missing_textures(path: Path) -> tuple[str, ...]:
    """Images that a glTF names and that are not beside it."""
    if path.suffix.lower() != ".gltf":
        return ()
    images = json.loads(path.read_text(encoding="utf-8")).get("images", [])
    uris = [i["uri"] for i in images if isinstance(i.get("uri"), str)]
    missing = [u for u in uris if not u.startswith("data:") and not (path.parent / u).is_file()]
    if not missing:
        return ()
    return (f"'{path}': {len(missing)} textures are missing; a mask needs none",)


def _box(size: list[float]) -> Any:
    import trimesh

    return trimesh.creation.box(extents=size)


def _icosphere(radius: float, subdivisions: int) -> Any:
    import trimesh

    return trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)


def _cylinder(radius: float, height: float, segments: int) -> Any:
    import trimesh

    # Its axis is z there, and y in three.js.
    turn = trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0])
    return trimesh.creation.cylinder(radius, height, sections=segments, transform=turn)


def _torus(radius: float, tube: float, radial_segments: int, tubular_segments: int) -> Any:
    import trimesh

    return trimesh.creation.torus(
        radius, tube, major_sections=tubular_segments, minor_sections=radial_segments
    )


def _plane(width: float, height: float) -> Any:
    import trimesh

    x, y = width / 2, height / 2
    corners = [[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


# kind: (maker, sizes with their defaults); sizes have three.js's names.
PRIMITIVES: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "box": (_box, {"size": [1.0, 1.0, 1.0]}),
    "icosphere": (_icosphere, {"radius": 1.0, "subdivisions": 3}),
    "cylinder": (_cylinder, {"radius": 1.0, "height": 1.0, "segments": 32}),
    "torus": (
        _torus,
        {"radius": 1.0, "tube": 0.4, "radial_segments": 12, "tubular_segments": 48},
    ),
    "plane": (_plane, {"width": 1.0, "height": 1.0}),
}
# Least and greatest of the sizes that are whole numbers.
COUNTS = {
    "subdivisions": (0, 8),
    "segments": (3, 4096),
    "radial_segments": (3, 4096),
    "tubular_segments": (3, 4096),
}


def primitive(kind: str, **sizes: Any) -> Mesh:
    """A shape about its own centre; ``sizes`` as in ``PRIMITIVES``."""
    maker, defaults = PRIMITIVES[kind]
    made = maker(**(defaults | sizes))
    return clean(np.asarray(made.vertices, np.float64), np.asarray(made.faces), kind)

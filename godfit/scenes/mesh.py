"""Meshes from files and from formulas, as vertices, faces and the edges between them."""

from __future__ import annotations

import io
import json
import logging
import os
import re
import urllib.parse
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from godfit.errors import InputError

MESH_SUFFIXES = (".gltf", ".glb", ".obj", ".ply", ".stl")
"""File formats that trimesh loads with their transforms."""
COMPRESSION_EXTENSIONS = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")
"""Extensions of glTF whose positions trimesh does not load."""
MAX_COORDINATE = 1e18
"""Largest coordinate of a vertex: the products of two edges stay finite in float32."""
PLY_HEADER = 65536
"""Bytes from the start of a PLY file in which its header ends."""
GLB_JSON_START = 20
"""Byte of a GLB file at which its JSON begins: a header of 12 bytes comes first, then the length
and the kind of the first chunk, 4 bytes each."""
GLTF_TRIANGLES = 4
"""Mode of a glTF primitive that is a list of triangles, the default."""
GLTF_TRIANGLE_FAN = 6
"""Mode of a glTF primitive that is a fan of triangles, which trimesh passes over."""
INSIDE_RAY = (0.5377, 0.2718, 0.7983)
"""Direction of the ray of ``contains``: no edge of a modelled mesh lies along it."""


class Mesh(NamedTuple):
    """Vertices (v, 3) float64, each position once; faces (f, 3) int32; and notes for the user."""

    vertices: np.ndarray
    faces: np.ndarray
    notes: tuple[str, ...] = ()


def load(path: Path) -> Mesh:
    """The mesh of a glTF, GLB, OBJ, PLY or STL file: its whole scene graph with transforms, without
    materials and textures. Raises InputError for a file that is missing, damaged or has no
    triangles."""
    if not os.path.isfile(path):
        raise InputError(f"'{path}': expected a mesh, got no such file; check the path")
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        expected = ", ".join(MESH_SUFFIXES)
        raise InputError(f"'{path}': expected one of {expected}, got '{path.suffix}'")
    if path.stat().st_size == 0:
        raise InputError(f"'{path}': expected a mesh, got an empty file; export it again")
    notes = _check_gltf(path)
    parts = [(v, f) for v, f in _loaded(path) if len(f)]
    if not parts:
        raise InputError(f"'{path}': expected triangles, got none; export faces, not points")
    first, vertices, faces = 0, [], []
    for v, f in parts:
        if v.shape[1:] != (3,) or f.shape[1:] != (3,):
            raise InputError(
                f"'{path}': expected three coordinates a vertex and three corners a face, got "
                f"arrays {v.shape} and {f.shape}; export it again"
            )
        if f.min() < 0 or f.max() >= len(v):
            raise InputError(
                f"'{path}': expected indices from 0 to {len(v) - 1}, got {f.min()} to {f.max()}; "
                "export it again"
            )
        vertices.append(v)
        faces.append(f + first)
        first += len(v)
    if suffix == ".ply":
        _check_ply(path, sum(map(len, faces)))
    mesh = clean(np.concatenate(vertices), np.concatenate(faces), str(path))
    return mesh._replace(notes=mesh.notes + notes)


def _loaded(path: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    """Vertices and faces of every part of a file, in the world, by trimesh."""
    # Imported here: trimesh takes long to import, and most runs need no mesh.
    import trimesh
    from trimesh.resolvers import FilePathResolver

    class Resolver(FilePathResolver):
        def get(self, name: str):
            return super().get(urllib.parse.unquote(name))

    suffix = path.suffix.lower()
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            # trimesh warns of textures and normals, which a mask does not need.
            warnings.simplefilter("ignore")
            # `process` would drop vertices that are not finite, which are an error here.
            scene = trimesh.load_scene(
                _obj_bytes(path) if suffix == ".obj" else str(path),
                file_type=suffix[1:],
                resolver=Resolver(str(path)),
                process=False,
                skip_materials=True,
            )
            return [
                (np.asarray(part.vertices, np.float64), np.asarray(part.faces, np.int64))
                for part in scene.dump()
                if isinstance(part, trimesh.Trimesh)
            ]
    except InputError:
        raise
    except MemoryError:
        raise InputError(f"'{path}': out of memory; expected a smaller mesh") from None
    except Exception as error:
        # trimesh's loaders raise whatever their parsers raise. An ImportError means that binary
        # data was taken for text, and that the package which guesses encodings is missing.
        got = f"{type(error).__name__}: {error}"
        if isinstance(error, (ImportError, AssertionError)):
            got = "a cut or damaged file"
        raise InputError(f"'{path}': expected a mesh, got {got}; export it again") from error


def clean(vertices: np.ndarray, faces: np.ndarray, name: str) -> Mesh:
    """A mesh with equal positions merged, and without faces that have no area or occur twice.
    ``name`` is that of the mesh in messages. Raises InputError for vertices that are not finite,
    and where no face is left."""
    bad = np.any(~(np.abs(vertices) < MAX_COORDINATE), axis=-1)
    if bad[faces].any():
        count = len(np.unique(faces[bad[faces]]))
        raise InputError(
            f"'{name}': expected finite vertices below 1e18, got {count:,} with NaN, infinity or "
            "more; export it again"
        )
    # -0.0 becomes 0.0: they are one position.
    vertices = vertices + 0.0
    faces = _first_equal(vertices)[faces]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    flat = (np.cross(b - a, c - a) == 0).all(-1)
    notes = ()
    if flat.any():
        notes = (f"'{name}': {int(flat.sum()):,} of {len(flat):,} triangles without area ignored",)
    faces = faces[~flat]
    if not len(faces):
        raise InputError(f"'{name}': expected triangles with an area, got none; export it again")
    faces = faces[_first_equal(np.sort(faces, axis=1)) == np.arange(len(faces))]
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    renumbered = np.cumsum(used, dtype=np.int32) - 1
    return Mesh(vertices[used], renumbered[faces], notes)


def _first_equal(rows: np.ndarray) -> np.ndarray:
    """(n,) for each of the rows (n, 3), the number of the first row that is equal to it."""
    # Several times as fast as numpy.unique with an axis, for 2 million triangles.
    order = np.lexsort(rows.T)
    new = np.ones(len(rows), bool)
    new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(-1)
    first = np.empty(len(rows), np.int64)
    # lexsort is stable: the first of equal rows in its order has the least number.
    first[order] = order[new][np.cumsum(new) - 1]
    return first


def edges(faces: np.ndarray) -> np.ndarray:
    """(e, 4) int32, every edge once: its ends a, b, and the opposite corners c, d of its two faces.
    d is -1 where the edge has one face; both are -1 where it has more than two."""
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
    """Whether a point is inside a closed mesh: a ray from the point crosses the surface an odd
    number of times. False for a mesh with a border."""
    if (edges(mesh.faces)[:, 3] < 0).any():
        return False
    a, b, c = (mesh.vertices[mesh.faces[:, k]] - point for k in range(3))
    ray = np.array(INSIDE_RAY)
    n = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (n * a).sum(-1) / (n @ ray)
        inside = t > 0
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= (np.cross(n, q - p) * (t[:, None] * ray - p)).sum(-1) >= 0
    return bool(inside.sum() % 2)


def _obj_bytes(path: Path) -> io.BytesIO:
    """An OBJ file in UTF-8, with absolute indices in place of relative ones."""
    data = path.read_bytes().replace(b"\r\n", b"\n").replace(b"\\\n", b" ")
    # Names and comments may be in any encoding, and are ignored.
    data = data.decode("utf-8", errors="replace").encode()
    # An index below 1 counts back from the last vertex before the face. trimesh counts from the
    # last vertex of the file, which it takes 0 for as well.
    if not re.search(rb"^\s*f[^\n]*\s[-0]", data, re.MULTILINE):
        return io.BytesIO(data)
    lines, count = data.split(b"\n"), 0
    for i, line in enumerate(lines):
        kind, *words = line.split(b"#")[0].split() or [b""]
        count += kind == b"v"
        if kind == b"f":
            corners = [int(word.split(b"/")[0]) for word in words]
            corners = [n + count + 1 if n < 0 else n for n in corners]
            if min(corners, default=1) < 1:
                raise InputError(
                    f"'{path}': expected indices from 1, got {line.decode()!r} after {count} "
                    "vertices; export it again"
                )
            lines[i] = b"f " + b" ".join(b"%d" % n for n in corners)
    return io.BytesIO(b"\n".join(lines))


def _check_ply(path: Path, faces: int) -> None:
    """Reject a text file that ends before its last face: trimesh loads the faces before the end."""
    with path.open("rb") as file:
        header = re.search(rb"^element\s+face\s+(\d+)", file.read(PLY_HEADER), re.MULTILINE)
    if header and faces < int(header[1]):
        raise InputError(
            f"'{path}': expected {int(header[1]):,} faces, got {faces:,}; the file is cut short, "
            "export it again"
        )


def _check_gltf(path: Path) -> tuple[str, ...]:
    """Reject a glTF or GLB file whose geometry trimesh would pass over or misread. Returns a note
    where the file names textures that are not beside it."""
    suffix = path.suffix.lower()
    if suffix not in (".gltf", ".glb"):
        return ()
    data = path.read_bytes()
    if suffix == ".glb":
        length = int.from_bytes(data[12:16], "little")
        data = data[GLB_JSON_START : GLB_JSON_START + length]
    try:
        tree = json.loads(data.decode())
        compressed = set(COMPRESSION_EXTENSIONS) & set(tree.get("extensionsRequired", []))
        accessors, misread = tree.get("accessors", []), {f"{name} geometry" for name in compressed}
        for part in (p for m in tree.get("meshes", []) for p in m["primitives"]):
            if part.get("mode", GLTF_TRIANGLES) == GLTF_TRIANGLE_FAN:
                misread.add("triangle fans")
            position = accessors[part["attributes"]["POSITION"]]
            misread |= {f"{key} positions" for key in ("sparse", "normalized") if position.get(key)}
        uris = [image.get("uri", "data:") for image in tree.get("images", [])]
        files = [urllib.parse.unquote(u) for u in uris if not u.startswith("data:")]
        missing = sum(not os.path.isfile(path.parent / file) for file in files)
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(
            f"'{path}': expected a glTF 2.0 header, got {type(error).__name__}: {error}; "
            "export it again"
        ) from error
    if misread:
        raise InputError(
            f"'{path}': expected plain triangles, got {', '.join(sorted(misread))}; "
            "export it without"
        )
    return (f"'{path}': {missing} textures are missing; a mask needs none",) if missing else ()


def _box(size: list[float]) -> Any:
    import trimesh

    return trimesh.creation.box(extents=size)


def _icosphere(radius: float, subdivisions: int) -> Any:
    import trimesh

    return trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)


def _cylinder(radius: float, height: float, segments: int) -> Any:
    import trimesh

    # trimesh's axis is z and its first corner lies at x; three.js's are y and z.
    rotation = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    return trimesh.creation.cylinder(radius, height, sections=segments, transform=rotation)


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
"""By kind, the function that makes a shape, and its sizes with their defaults. Sizes have
three.js's names."""
COUNT_LIMITS = {
    "subdivisions": (0, 8),
    "segments": (3, 4096),
    "radial_segments": (3, 4096),
    "tubular_segments": (3, 4096),
}
"""Least and greatest of the sizes that are whole numbers: at most 1.3 million triangles in a
sphere, and 34 million in a torus."""


def primitive(kind: str, **sizes: Any) -> Mesh:
    """A shape of ``PRIMITIVES`` around its own centre; ``sizes`` replace the defaults there."""
    create, defaults = PRIMITIVES[kind]
    shape = create(**(defaults | sizes))
    return clean(np.asarray(shape.vertices, np.float64), np.asarray(shape.faces), kind)

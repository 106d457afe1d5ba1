"""Meshes: from files and from formulas, as vertices, faces and the edges between them."""

from __future__ import annotations

import io
import json
import logging
import re
import urllib.parse
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from godfit.errors import InputError

FORMATS = (".gltf", ".glb", ".obj", ".ply", ".stl")
# Extensions of glTF that keep positions where trimesh does not look.
COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")


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
    notes = _check_gltf(path)
    import trimesh
    from trimesh.resolvers import FilePathResolver

    class Resolver(FilePathResolver):
        def get(self, name: str):
            return super().get(urllib.parse.unquote(name))

    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            # What it says of textures and normals does not matter here.
            warnings.simplefilter("ignore")
            # `process` would drop vertices that are not finite before anyone is told.
            scene = trimesh.load_scene(
                _obj(path) if path.suffix.lower() == ".obj" else str(path),
                file_type=path.suffix.lower()[1:],
                resolver=Resolver(str(path)),
                process=False,
                skip_materials=True,
            )
            parts = [
                (np.asarray(part.vertices, np.float64), np.asarray(part.faces, np.int64))
                for part in scene.dump()
                if isinstance(part, trimesh.Trimesh)
            ]
    except InputError:
        raise
    except Exception as error:
        # Its loaders raise whatever their parsers do. An ImportError: binary data was taken for
        # text, and the guesser of encodings is not there.
        got = f"{type(error).__name__}: {error}"
        if isinstance(error, (ImportError, AssertionError)):
            got = "a cut or damaged file"
        raise InputError(f"'{path}': expected a mesh, got {got}; export it again") from error
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
    if path.suffix.lower() == ".ply":
        _check_ply(path, sum(map(len, faces)))
    mesh = clean(np.concatenate(vertices), np.concatenate(faces), str(path))
    return mesh._replace(notes=mesh.notes + notes)


def clean(vertices: np.ndarray, faces: np.ndarray, name: str) -> Mesh:
    """Positions merged, and without the faces that have no area or are there twice."""
    # The products of two edges stay finite in float32 as well.
    bad = np.any(~(np.abs(vertices) < 1e18), axis=-1)
    if bad[faces].any():
        count = len(np.unique(faces[bad[faces]]))
        raise InputError(
            f"'{name}': expected finite vertices below 1e18, got {count:,} with NaN, infinity or "
            "more; export it again"
        )
    # -0.0 and 0.0 are one place.
    vertices = vertices + 0.0
    faces = _first(vertices)[faces]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    flat = (np.cross(b - a, c - a) == 0).all(-1)
    notes = ()
    if flat.any():
        notes = (f"'{name}': {int(flat.sum()):,} of {len(flat):,} triangles without area ignored",)
    faces = faces[~flat]
    if not len(faces):
        raise InputError(f"'{name}': expected triangles with an area, got none; export it again")
    faces = faces[_first(np.sort(faces, axis=1)) == np.arange(len(faces))]
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    renumbered = np.cumsum(used, dtype=np.int32) - 1
    return Mesh(vertices[used], renumbered[faces], notes)


def _first(rows: np.ndarray) -> np.ndarray:
    """(n,) where the first row equal to each of the rows (n, 3) is."""
    # On 2 million triangles, several times as fast as numpy.unique with an axis.
    order = np.lexsort(rows.T)
    new = np.ones(len(rows), bool)
    new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(-1)
    first = np.empty(len(rows), np.int64)
    # lexsort is stable: the first of equal rows is the one that came first.
    first[order] = order[new][np.cumsum(new) - 1]
    return first


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


def _obj(path: Path) -> io.BytesIO:
    """An OBJ file in UTF-8, its relative indices made absolute."""
    data = path.read_bytes().replace(b"\r\n", b"\n").replace(b"\\\n", b" ")
    # Names and comments may be in any encoding; nothing is read of them.
    data = data.decode("utf-8", errors="replace").encode()
    # An index below 1 counts back from the last vertex before the face; trimesh counts from the
    # last of the file, and takes 0 for it.
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
    """Refuse a text file that ends before its last face, where trimesh takes what there is."""
    with path.open("rb") as file:
        said = re.search(rb"^element\s+face\s+(\d+)", file.read(65536), re.MULTILINE)
    if said and faces < int(said[1]):
        raise InputError(
            f"'{path}': expected {int(said[1]):,} faces, got {faces:,}; the file is cut short, "
            "export it again"
        )


def _check_gltf(path: Path) -> tuple[str, ...]:
    """Refuse a glTF or GLB file in which trimesh would pass over geometry or misread it; a note
    where textures that it names are not beside it."""
    suffix = path.suffix.lower()
    if suffix not in (".gltf", ".glb"):
        return ()
    data = path.read_bytes()
    if suffix == ".glb":
        # 12 bytes of header, then the length and kind of the first chunk, which is the JSON.
        data = data[20 : 20 + int.from_bytes(data[12:16], "little")]
    try:
        tree = json.loads(data.decode())
        compressed = set(COMPRESSED) & set(tree.get("extensionsRequired", []))
        accessors, misread = tree.get("accessors", []), {f"{name} geometry" for name in compressed}
        for part in (p for m in tree.get("meshes", []) for p in m["primitives"]):
            if part.get("mode", 4) == 6:
                misread.add("triangle fans")
            position = accessors[part["attributes"]["POSITION"]]
            misread |= {f"{key} positions" for key in ("sparse", "normalized") if position.get(key)}
        uris = [image.get("uri", "data:") for image in tree.get("images", [])]
        files = [urllib.parse.unquote(u) for u in uris if not u.startswith("data:")]
        missing = sum(not (path.parent / file).is_file() for file in files)
    except (ValueError, LookupError, TypeError, AttributeError) as error:
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

    # Its axis is z there, and y in three.js; the first corner is at x there, and at z in three.js.
    turn = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
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

"""Meshes from files and from formulas, as vertices, faces and the edges between them."""

from __future__ import annotations

import io
import os
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from godfit.errors import InputError
from godfit.runtime.host_state import warnings_kept
from godfit.scenes.gltf import Gltf, Part
from godfit.scenes.ply import read_ply
from godfit.scenes.polygons import triangulated

MESH_SUFFIXES = (".gltf", ".glb", ".obj", ".ply", ".stl")
"""File formats of meshes."""
GLTF_SUFFIXES = (".gltf", ".glb")
"""File formats of whole scenes, with cameras and lights."""
MAX_COORDINATE = 1e18
"""Largest coordinate of a vertex: the products of two edges stay finite in float32."""
OBJ_SURFACE = re.compile(rb"^\s*(surf|curv2?)\s", re.MULTILINE)
"""Free-form surfaces of an OBJ file, which are no polygons."""
INSIDE_RAY = (0.5377, 0.2718, 0.7983)
"""Direction of the ray of ``contains``: no edge of a modelled mesh lies along it."""


class Mesh(NamedTuple):
    """Vertices (v, 3) float64, each position once; faces (f, 3) int32; notes for the user; and
    which faces (f,) are drawn only where they are counter-clockwise, None for none."""

    vertices: np.ndarray
    faces: np.ndarray
    notes: tuple[str, ...] = ()
    single_sided: np.ndarray | None = None


def load(path: Path) -> Mesh:
    """The mesh of a glTF, GLB, OBJ, PLY or STL file: its whole scene graph with transforms, without
    colours and textures. Faces of glTF's single-sided materials are drawn from in front alone, all
    others from both sides. Raises InputError for a file that is missing, damaged or has no
    triangles, and for geometry that is not implemented."""
    if not os.path.isfile(path):
        raise InputError(f"'{path}': expected a mesh, got no such file; check the path")
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        expected = ", ".join(MESH_SUFFIXES)
        raise InputError(f"'{path}': expected one of {expected}, got '{path.suffix}'")
    if path.stat().st_size == 0:
        raise InputError(f"'{path}': expected a mesh, got an empty file; export it again")
    parts, notes = _loaded(path)
    parts = [part for part in parts if len(part.faces)]
    if not parts:
        raise InputError(f"'{path}': expected triangles, got none; export faces, not points")
    first, vertices, faces, single = 0, [], [], []
    for part in parts:
        v, f = part.vertices, part.faces
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
        single.append(np.full(len(f), part.single_sided))
        first += len(v)
    mesh = clean(np.concatenate(vertices), np.concatenate(faces), str(path), np.concatenate(single))
    return mesh._replace(notes=mesh.notes + notes)


def _loaded(path: Path) -> tuple[list[Part], tuple[str, ...]]:
    """The parts of a file, and notes on them."""
    suffix = path.suffix.lower()
    if suffix in GLTF_SUFFIXES:
        return _gltf_parts(path)
    try:
        if suffix == ".ply":
            vertices, rings = read_ply(path)
            _check_indices(path, rings, len(vertices))
            faces, crossed = triangulated(vertices, rings)
            return [Part(vertices, faces, False)], _crossed_note(path, crossed)
        notes, source = (), path.read_bytes()
        if suffix == ".obj":
            source, notes = _obj_bytes(path, source)
            _check_materials(path, source)
        return _trimesh_parts(source, suffix), notes
    except InputError:
        raise
    except MemoryError:
        raise InputError(f"'{path}': out of memory; expected a smaller mesh") from None
    except Exception as error:
        # Loaders raise whatever their parsers raise. An ImportError means that binary data was
        # taken for text, and that the package which guesses encodings is missing.
        got = f"{type(error).__name__}: {error}"
        if isinstance(error, ImportError):
            got = "a cut or damaged file"
        raise InputError(f"'{path}': expected a mesh, got {got}; export it again") from error


def open_gltf(path: Path) -> Gltf:
    """A glTF or GLB file. Raises InputError for one that is damaged, and for extensions that are
    required and not implemented."""
    try:
        file = Gltf(path)
        file.missing_textures()
    except InputError:
        raise
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise InputError(
            f"'{path}': expected a glTF 2.0 header, got {type(error).__name__}: {error}; "
            "export it again"
        ) from error
    return file


def _gltf_parts(path: Path) -> tuple[list[Part], tuple[str, ...]]:
    file = open_gltf(path)
    try:
        parts = file.parts()
    except InputError:
        raise
    except Exception as error:
        got = f"{type(error).__name__}: {error}"
        raise InputError(f"'{path}': expected a mesh, got {got}; export it again") from error
    missing = file.missing_textures()
    notes = [f"{missing} textures are missing; a mask needs none"] if missing else []
    return parts, tuple(f"'{path}': {note}" for note in [*notes, *file.notes])


def _trimesh_parts(source: bytes, suffix: str) -> list[Part]:
    """The parts of an OBJ or STL file, by trimesh."""
    # Imported here: trimesh takes long to import, and most runs need no mesh.
    import trimesh

    with warnings_kept(), warnings.catch_warnings():
        # trimesh warns of textures and normals, which a mask does not need.
        warnings.simplefilter("ignore")
        # `process` would drop vertices that are not finite, which are an error here.
        scene = trimesh.load_scene(
            io.BytesIO(source), file_type=suffix[1:], process=False, skip_materials=True
        )
        return [
            Part(np.asarray(part.vertices, np.float64), np.asarray(part.faces, np.int64), False)
            for part in scene.dump()
            if isinstance(part, trimesh.Trimesh)
        ]


def _check_indices(path: Path, rings: list[np.ndarray], count: int) -> None:
    """Raise InputError for polygons with other corners than ``count`` vertices."""
    corners = np.concatenate([np.zeros(0, np.int64), *rings])
    least, most = corners.min(initial=0), corners.max(initial=0)
    if least < 0 or (corners.size and most >= count):
        raise InputError(
            f"'{path}': expected indices from 0 to {count - 1}, got {least} to {most}; "
            "export it again"
        )


def _crossed_note(path: Path, crossed: int) -> tuple[str, ...]:
    if not crossed:
        return ()
    return (f"'{path}': {crossed:,} polygons cross themselves; programs fill these differently",)


def clean(
    vertices: np.ndarray, faces: np.ndarray, name: str, single_sided: np.ndarray | None = None
) -> Mesh:
    """A mesh with equal positions merged, and without faces that have no area or occur twice.
    ``name`` is that of the mesh in messages. Raises InputError for vertices that are not finite,
    and where no face is left.

    A face that occurs twice is ``single_sided`` (f,) only where each of the two is, and both are
    turned the same way.
    """
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
    first = _first_equal(np.sort(faces, axis=1))
    kept = first == np.arange(len(faces))
    if single_sided is not None:
        single_sided = single_sided[~flat]
        # The permutation that sorts three corners is even where its first entries ascend so.
        order = np.argsort(faces, axis=1)
        even = (order[:, 1] - order[:, 0]) % 3 == 1
        from_both_sides = ~single_sided | (even != even[first])
        single_sided = ~np.isin(np.arange(len(faces)), first[from_both_sides])[kept]
        single_sided = single_sided if single_sided.any() else None
    faces = faces[kept]
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    renumbered = np.cumsum(used, dtype=np.int32) - 1
    return Mesh(vertices[used], renumbered[faces], notes, single_sided)


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


def edges(faces: np.ndarray, single_sided: np.ndarray | None = None) -> np.ndarray:
    """(e, 4) int32, every edge once: its ends a, b, and the opposite corners c, d of its two faces.
    d is -1 where the edge has one face; both are -1 where it has more than two, and where only one
    of the two may be drawn: with ``single_sided`` (f,), a face that turns its back."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    across = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]])
    low, high = ends.min(1), ends.max(1)
    key = low * (int(faces.max()) + 1) + high
    order = np.argsort(key, kind="stable")
    key, low, high, across = key[order], low[order], high[order], across[order]
    first = np.flatnonzero(np.diff(key, prepend=-1))
    count = np.diff(first, append=len(key))
    second = np.minimum(first + 1, len(key) - 1)
    joined = count <= 2
    if single_sided is not None:
        # Faces turned the same way run through their common edge in opposite directions.
        single = np.tile(single_sided, 3)[order]
        rising = (ends[:, 0] < ends[:, 1])[order]
        apart = single[first] != single[second]
        apart |= single[first] & (rising[first] == rising[second])
        joined &= ~((count == 2) & apart)
    c = np.where(joined, across[first], -1)
    d = np.where(joined & (count == 2), across[second], -1)
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


def _check_materials(path: Path, data: bytes) -> None:
    """Raise InputError where an OBJ file uses a material whose alpha texture cuts holes."""
    used = {name.strip() for name in re.findall(rb"^\s*usemtl\s+(.+)$", data, re.MULTILINE)}
    for name in re.findall(rb"^\s*mtllib\s+(.+)$", data, re.MULTILINE):
        library = path.parent / name.strip().decode(errors="replace")
        if not library.is_file():
            continue
        for text in re.split(rb"^\s*newmtl\s+", library.read_bytes(), flags=re.MULTILINE)[1:]:
            material, _, body = text.partition(b"\n")
            if material.strip() in used and re.search(rb"^\s*map_d\s", body, re.MULTILINE):
                shown = material.strip().decode(errors="replace")
                raise InputError(
                    f"'{path}': expected surfaces without holes cut by alpha, got map_d in the "
                    f"material '{shown}'; model the holes, or remove map_d"
                )


def _obj_bytes(path: Path, data: bytes) -> tuple[bytes, tuple[str, ...]]:
    """An OBJ file in UTF-8, with triangles in place of polygons and absolute indices in place of
    relative ones; and notes on polygons that cross themselves."""
    data = data.replace(b"\r\n", b"\n").replace(b"\\\n", b" ")
    # Names and comments may be in any encoding, and are ignored.
    data = data.decode("utf-8", errors="replace").encode()
    if OBJ_SURFACE.search(data):
        raise InputError(f"'{path}': expected polygons, got free-form surfaces; export triangles")
    # An index below 1 counts back from the last vertex before the face. trimesh counts from the
    # last vertex of the file, which it takes 0 for as well. It cuts every polygon into a fan.
    faces = rb"^\s*f(?:[^\n]*\s[-0]|(?:[ \t]+[^\s#]+){4})"
    if not re.search(faces, data, re.MULTILINE):
        return data, ()
    lines, rings, vertices = [], [], []
    for line in data.split(b"\n"):
        kind, *words = line.split(b"#")[0].split() or [b""]
        if kind == b"v":
            vertices.append([float(word) for word in words[:3]])
        if kind != b"f":
            lines.append(line)
            continue
        count = len(vertices)
        corners = [int(word.split(b"/")[0]) for word in words]
        corners = [n + count + 1 if n < 0 else n for n in corners]
        if min(corners, default=1) < 1:
            raise InputError(
                f"'{path}': expected indices from 1, got {line.decode()!r} after {count} "
                "vertices; export it again"
            )
        rings.append(np.array(corners, np.int64) - 1)
    _check_indices(path, rings, len(vertices))
    faces, crossed = triangulated(np.array(vertices, np.float64).reshape(-1, 3), rings)
    lines += [b"f %d %d %d" % tuple(face) for face in (faces + 1).tolist()]
    return b"\n".join(lines), _crossed_note(path, crossed)


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

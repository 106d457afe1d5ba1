"""glTF 2.0 files: the geometry of their default scene as it stands at rest, cameras and lights.

Sections are those of the specification (Khronos Group, glTF 2.0, 2021). Geometry is that of a
renderer that plays no animation: morph targets have their default weights (3.7.2.2), skins the
joints' own transforms (3.7.3), and every instance of EXT_mesh_gpu_instancing is drawn.
"""

from __future__ import annotations

import base64
import functools
import json
import urllib.parse
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from godfit.errors import InputError

IMPLEMENTED = {
    "EXT_mesh_gpu_instancing",
    "KHR_lights_punctual",
    "KHR_mesh_quantization",
    "KHR_node_visibility",
}
"""Extensions that change what is drawn and are implemented here."""
WITHOUT_GEOMETRY = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_xmp")
"""How the names of extensions begin that only change colours: a mask needs none."""
NUMBERS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""NumPy's types of an accessor's component types (3.6.2.2)."""
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
"""Numbers in an element of an accessor, by its type."""
TRIANGLES = 4
"""Mode of a primitive that is a list of triangles, the default (3.7.2.1)."""
TRIANGLE_STRIP = 5
"""Mode of a primitive that is a strip of triangles."""
TRIANGLE_FAN = 6
"""Mode of a primitive that is a fan of triangles."""
GLB_HEADER = 12
"""Bytes of a GLB file before its first chunk."""
CHUNK_HEADER = 8
"""Bytes of a GLB's chunk before its data: length and kind."""
JSON_CHUNK = b"JSON"
BINARY_CHUNK = b"BIN\0"
JPEG_START = b"\xff\xd8\xff"
"""First bytes of a JPEG, which has no alpha."""
ALPHA_CUTOFF = 0.5
"""Default of a material's alphaCutoff (5.19.9)."""


class Part(NamedTuple):
    """A part of a file, in the world: vertices (v, 3) float64, faces (f, 3) int64 that are
    counter-clockwise from in front, and whether they are drawn only from there."""

    vertices: np.ndarray
    faces: np.ndarray
    single_sided: bool


class Placed(NamedTuple):
    """A camera or a light of a file, as its table, and the matrix (4, 4) of its node."""

    table: dict[str, Any]
    world: np.ndarray


class Gltf:
    """A glTF or GLB file. Whatever is wrong with its structure raises LookupError, TypeError,
    ValueError or another exception of Python's; what is not implemented raises InputError."""

    def __init__(self, path: Path) -> None:
        self.path = path
        data, self.binary = path.read_bytes(), None
        if path.suffix.lower() == ".glb":
            data, self.binary = _chunks(data)
        self.tree = json.loads(data.decode())
        version = str(self.tree["asset"]["version"])
        if version.split(".")[0] != "2":
            raise self._refused("version 2", f"{version}; only GLTF 2 is read, export it again")
        for name in self.tree.get("extensionsRequired", []):
            if name not in IMPLEMENTED and not name.startswith(WITHOUT_GEOMETRY):
                raise self._refused(
                    "geometry without further extensions",
                    f"extensionsRequired '{name}'; export it without",
                )
        self.nodes: list[dict[str, Any]] = self.tree.get("nodes", [])
        self.notes: list[str] = []
        if self.tree.get("animations"):
            self._note("animations are not played; the pose at rest is drawn")

    def _refused(self, expected: str, got: str) -> InputError:
        return InputError(f"'{self.path}': expected {expected}, got {got}")

    def _cut(self) -> InputError:
        return self._refused("a mesh", "a cut or damaged file; export it again")

    @functools.cached_property
    def worlds(self) -> list[np.ndarray]:
        """The matrix (4, 4) of every node: that of its parents, times its own (3.5.2)."""
        parents = {child: i for i, n in enumerate(self.nodes) for child in n.get("children", [])}
        found: dict[int, np.ndarray] = {}

        def world(i: int, depth: int) -> np.ndarray:
            if depth > len(self.nodes):
                raise ValueError("a node that is its own parent")
            if i not in found:
                own = _matrix(self.nodes[i])
                found[i] = world(parents[i], depth + 1) @ own if i in parents else own
            return found[i]

        return [world(i, 0) for i in range(len(self.nodes))]

    @functools.cached_property
    def drawn(self) -> list[int]:
        """The numbers of the default scene's nodes, without those that are not visible."""
        scenes = self.tree.get("scenes")
        if scenes is None:
            children = {child for n in self.nodes for child in n.get("children", [])}
            queue = [i for i in range(len(self.nodes)) if i not in children]
        else:
            queue = list(scenes[self.tree.get("scene", 0)].get("nodes", []))
        found: list[int] = []
        while queue:
            i = queue.pop(0)
            if i in found:
                raise ValueError("a node with two parents")
            if _extension(self.nodes[i], "KHR_node_visibility").get("visible", True):
                found.append(i)
                queue = [*self.nodes[i].get("children", []), *queue]
        return found

    def parts(self) -> list[Part]:
        """Every primitive of triangles of the default scene, once for each of its instances."""
        found = []
        for i in self.drawn:
            node = self.nodes[i]
            if "mesh" not in node:
                continue
            table = self.tree["meshes"][node["mesh"]]
            weights = node.get("weights", table.get("weights", []))
            for primitive in table["primitives"]:
                faces = self._faces(primitive)
                if faces is None or not self._opaque(primitive):
                    continue
                vertices = self._positions(primitive, weights)
                if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
                    raise self._refused(
                        f"indices from 0 to {len(vertices) - 1}",
                        f"{faces.min()} to {faces.max()}; export it again",
                    )
                single = not self._material(primitive).get("doubleSided", False)
                for world in self._instances(i):
                    mirrored = np.linalg.det(self.worlds[i][:3, :3]) < 0
                    if "skin" in node and "JOINTS_0" in primitive["attributes"]:
                        placed = self._skinned(primitive, vertices, node["skin"])
                    else:
                        placed = vertices @ world[:3, :3].T + world[:3, 3]
                        mirrored = np.linalg.det(world[:3, :3]) < 0
                    found.append(Part(placed, faces[:, ::-1] if mirrored else faces, single))
        return found

    def cameras(self) -> list[Placed]:
        """The cameras of the default scene."""
        tables = self.tree.get("cameras", [])
        numbers = [(i, self.nodes[i]["camera"]) for i in self.drawn if "camera" in self.nodes[i]]
        return [Placed(tables[number], self.worlds[i]) for i, number in numbers]

    def lights(self) -> list[Placed]:
        """The punctual lights of the default scene (KHR_lights_punctual)."""
        name, found = "KHR_lights_punctual", []
        for i in self.drawn:
            if "light" in (own := _extension(self.nodes[i], name)):
                table = self.tree["extensions"][name]["lights"][own["light"]]
                found.append(Placed(table, self.worlds[i]))
        return found

    def missing_textures(self) -> int:
        """The number of image files that are not beside the file."""
        uris = [image.get("uri", "data:") for image in self.tree.get("images", [])]
        files = [urllib.parse.unquote(u) for u in uris if not u.startswith("data:")]
        return sum(not (self.path.parent / file).is_file() for file in files)

    def accessor(self, number: int) -> np.ndarray:
        """The elements of an accessor, (count, components) (3.6.2): float64 where they are floats
        or normalised integers, else int64."""
        table = self.tree["accessors"][number]
        kind, wide = np.dtype(NUMBERS[table["componentType"]]), COMPONENTS[table["type"]]
        if "bufferView" in table:
            values = self._view(table["bufferView"], kind, (table["count"], wide), table)
        elif "sparse" in table:
            values = np.zeros((table["count"], wide), kind)
        else:
            raise ValueError(f"accessor {number} without data")
        if "sparse" in table:
            sparse, values = table["sparse"], values.copy()
            at, new = sparse["indices"], sparse["values"]
            count = sparse["count"]
            rows = self._view(
                at["bufferView"], np.dtype(NUMBERS[at["componentType"]]), (count, 1), at
            )
            values[rows[:, 0]] = self._view(new["bufferView"], kind, (count, wide), new)
        if kind.kind == "f":
            return values.astype(np.float64)
        if table.get("normalized"):
            return np.maximum(values.astype(np.float64) / np.iinfo(kind).max, -1.0)
        return values.astype(np.int64)

    def _view(
        self, number: int, kind: np.dtype, shape: tuple[int, int], table: dict[str, Any]
    ) -> np.ndarray:
        """Elements (count, wide) of a buffer view, from the byte offset in ``table`` on."""
        view = self.tree["bufferViews"][number]
        count, wide = shape
        first = view.get("byteOffset", 0) + table.get("byteOffset", 0)
        stride = view.get("byteStride", wide * kind.itemsize)
        data = self._buffer(view["buffer"])
        last = view.get("byteOffset", 0) + view["byteLength"]
        end = first + (count - 1) * stride + wide * kind.itemsize if count else first
        if min(count, first, stride) < 0 or end > last or last > len(data):
            raise self._cut()
        strides = (stride, kind.itemsize)
        return np.ndarray(shape, kind, data, first, strides) if count else np.zeros(shape, kind)

    def _buffer(self, number: int) -> bytes:
        if number not in self._buffers:
            table = self.tree["buffers"][number]
            if "uri" not in table and (number or self.binary is None):
                raise self._cut()
            self._buffers[number] = self._bytes_of(table) if "uri" in table else self.binary or b""
        return self._buffers[number]

    @functools.cached_property
    def _buffers(self) -> dict[int, bytes]:
        return {}

    def _bytes_of(self, table: dict[str, Any]) -> bytes:
        """The bytes of a buffer or of an image: inside the file, beside it, or in a view."""
        if "bufferView" in table:
            view = self.tree["bufferViews"][table["bufferView"]]
            first = view.get("byteOffset", 0)
            return self._buffer(view["buffer"])[first : first + view["byteLength"]]
        uri = table["uri"]
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2])
        name = self.path.parent / urllib.parse.unquote(uri)
        if not name.is_file():
            raise self._refused(f"the file '{name}' beside it", "none; put it there")
        return name.read_bytes()

    def _positions(self, primitive: dict[str, Any], weights: list[Any]) -> np.ndarray:
        """Vertices (v, 3) in the mesh's space, morphed by the weights."""
        vertices = self.accessor(primitive["attributes"]["POSITION"]).astype(np.float64)
        for weight, target in zip(weights, primitive.get("targets", []), strict=False):
            if weight and "POSITION" in target:
                vertices = vertices + weight * self.accessor(target["POSITION"])
        return vertices

    def _faces(self, primitive: dict[str, Any]) -> np.ndarray | None:
        """The triangles (f, 3) of a primitive; None for points and lines."""
        mode = primitive.get("mode", TRIANGLES)
        if mode not in (TRIANGLES, TRIANGLE_STRIP, TRIANGLE_FAN):
            return None
        if "indices" in primitive:
            indices = self.accessor(primitive["indices"])[:, 0]
        else:
            positions = self.tree["accessors"][primitive["attributes"]["POSITION"]]
            indices = np.arange(positions["count"])
        if mode == TRIANGLES:
            return indices[: len(indices) // 3 * 3].reshape(-1, 3)
        a, b, c = indices[:-2], indices[1:-1], indices[2:]
        if mode == TRIANGLE_FAN:
            return np.stack([b, c, np.broadcast_to(indices[:1], b.shape)], -1)
        odd = np.arange(len(a)) % 2 == 1
        return np.stack([a, np.where(odd, c, b), np.where(odd, b, c)], -1)

    def _instances(self, node: int) -> list[np.ndarray]:
        """The matrices of a node's mesh: one, or those of EXT_mesh_gpu_instancing."""
        world, name = self.worlds[node], "EXT_mesh_gpu_instancing"
        columns = _extension(self.nodes[node], name).get("attributes", {})
        columns = {key: self.accessor(n) for key, n in columns.items() if not key.startswith("_")}
        if not columns:
            return [world]
        rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        return [world @ _matrix({key.lower(): row[key] for key in row}) for row in rows]

    def _skinned(self, primitive: dict[str, Any], vertices: np.ndarray, skin: int) -> np.ndarray:
        """Vertices (v, 3) in the world, moved by their joints alone (3.7.3.3)."""
        table = self.tree["skins"][skin]
        joints = np.stack([self.worlds[i] for i in table["joints"]])
        if "inverseBindMatrices" in table:
            # Matrices are stored by columns.
            inverse = self.accessor(table["inverseBindMatrices"]).reshape(-1, 4, 4)
            joints = joints @ inverse[: len(joints)].transpose(0, 2, 1)
        moved, total = np.zeros_like(vertices), np.zeros((len(vertices), 1))
        attributes, k = primitive["attributes"], 0
        while f"JOINTS_{k}" in attributes:
            which = self.accessor(attributes[f"JOINTS_{k}"])
            weights = self.accessor(attributes[f"WEIGHTS_{k}"])
            for joint, weight in zip(which.T, weights.T, strict=True):
                matrix = joints[joint]
                placed = np.einsum("vij,vj->vi", matrix[:, :3, :3], vertices) + matrix[:, :3, 3]
                moved += weight[:, None] * placed
                total += weight[:, None]
            k += 1
        if (total <= 0).any():
            raise self._refused(
                "weights of joints above 0", "vertices without; export the skin again"
            )
        return moved / total

    def _material(self, primitive: dict[str, Any]) -> dict[str, Any]:
        if "material" not in primitive:
            return {}
        return self.tree["materials"][primitive["material"]]

    def _opaque(self, primitive: dict[str, Any]) -> bool:
        """Whether a primitive is drawn; False where its alpha is below the cutoff everywhere.
        Raises InputError where alpha cuts out a part of it."""
        material = self._material(primitive)
        name = material.get("name", primitive.get("material"))
        mode, cutoff = (
            material.get("alphaMode", "OPAQUE"),
            material.get("alphaCutoff", ALPHA_CUTOFF),
        )
        if mode == "OPAQUE":
            return True
        texture, known = (1.0, 1.0), True
        surface = _surface(material)
        if "baseColorTexture" in surface:
            found = self._texture_alpha(surface["baseColorTexture"]["index"])
            texture, known = found or (0.0, 1.0), found is not None
        least, most = self._vertex_alpha(primitive)
        factor = surface.get("baseColorFactor", [1, 1, 1, 1])[3]
        least, most = factor * least * texture[0], factor * most * texture[1]
        if mode == "BLEND":
            if least < 1 and known:
                self._note(f"the material '{name}' is blended; it is drawn as if it were opaque")
            return True
        if most < cutoff:
            self._note(f"the material '{name}' is cut out everywhere; nothing of it is drawn")
            return False
        if least >= cutoff:
            return True
        raise self._refused(
            "surfaces without holes cut by alpha",
            f"alphaMode MASK in the material '{name}'; model the holes, or make it opaque",
        )

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    def _vertex_alpha(self, primitive: dict[str, Any]) -> tuple[float, float]:
        """The least and the greatest alpha of the vertices' colours."""
        colours = primitive["attributes"].get("COLOR_0")
        if colours is None or self.tree["accessors"][colours]["type"] != "VEC4":
            return 1.0, 1.0
        alpha = self.accessor(colours)[:, 3]
        return float(alpha.min(initial=1.0)), float(alpha.max(initial=0.0))

    def _texture_alpha(self, number: int) -> tuple[float, float] | None:
        """The least and the greatest alpha of a texture; None where it cannot be decoded."""
        import imagecodecs

        table = self.tree["textures"][number]
        if "source" not in table:
            return None
        try:
            data = self._bytes_of(self.tree["images"][table["source"]])
            if data.startswith(JPEG_START):
                return 1.0, 1.0
            texels = imagecodecs.png_decode(data)
        except (InputError, OSError, ValueError, LookupError, RuntimeError):
            return None
        if texels.ndim < 3 or texels.shape[2] not in (2, 4):
            return 1.0, 1.0
        top = float(np.iinfo(texels.dtype).max)
        return float(texels[..., -1].min()) / top, float(texels[..., -1].max()) / top


def _chunks(data: bytes) -> tuple[bytes, bytes | None]:
    """The JSON and the binary chunk of a GLB file (4.4)."""
    if data[:4] != b"glTF":
        raise ValueError(f"first bytes {data[:4]!r}")
    version = int.from_bytes(data[4:8], "little")
    if version != 2:
        raise ValueError(f"version {version}; only GLTF 2 is read")
    found, at = {}, GLB_HEADER
    while at + CHUNK_HEADER <= len(data):
        length, kind = int.from_bytes(data[at : at + 4], "little"), data[at + 4 : at + 8]
        at += CHUNK_HEADER + length
        if at > len(data):
            raise ValueError("a file that is cut short")
        found.setdefault(kind, data[at - length : at])
    return found[JSON_CHUNK], found.get(BINARY_CHUNK)


def _extension(table: dict[str, Any], name: str) -> dict[str, Any]:
    return table.get("extensions", {}).get(name, {})


def _surface(material: dict[str, Any]) -> dict[str, Any]:
    """The base colour of a material, under the names of metallic roughness."""
    other = _extension(material, "KHR_materials_pbrSpecularGlossiness")
    if not other:
        return material.get("pbrMetallicRoughness", {})
    names = {"diffuseFactor": "baseColorFactor", "diffuseTexture": "baseColorTexture"}
    return {names[name]: value for name, value in other.items() if name in names}


def _matrix(node: dict[str, Any]) -> np.ndarray:
    """(4, 4) float64: the matrix of a node, or that of its translation, rotation (a quaternion x,
    y, z, w) and scale (3.5.3)."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = _unit(node.get("rotation", (0.0, 0.0, 0.0, 1.0)))
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    found = np.eye(4)
    found[:3, :3] = rotation * np.asarray(node.get("scale", (1.0, 1.0, 1.0)), np.float64)
    found[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return found


def _unit(quaternion: Any) -> np.ndarray:
    values = np.asarray(quaternion, np.float64)
    length = np.linalg.norm(values)
    return values / length if length > 0 else np.array([0.0, 0.0, 0.0, 1.0])

"""glTF files written from the specification."""

import base64
import json
import struct

import numpy as np

CORNERS = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
KINDS = {"f4": 5126, "u4": 5125, "u2": 5123, "i2": 5122, "u1": 5121, "i1": 5120}
SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


def uri(data: bytes) -> str:
    return "data:application/octet-stream;base64," + base64.b64encode(data).decode()


def gltf(vertices=CORNERS, faces=(0, 1, 2), primitive=None, accessor=None, **tree) -> bytes:
    """A glTF file with its buffer inside and one triangle mesh, whose accessors 0 and 1 are
    positions and indices. ``more=[(values, kind)]`` adds accessors from number 2 on."""
    arrays = [(np.array(vertices), "f4"), (np.array(faces), "u4"), *tree.pop("more", [])]
    data, views, accessors = b"", [], []
    for values, kind in arrays:
        values = np.asarray(values, f"<{kind}")
        data += b"\0" * (-len(data) % 4)
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": values.nbytes})
        accessors.append(
            {
                "bufferView": len(views) - 1,
                "componentType": KINDS[kind],
                "count": len(values),
                "type": SHAPES[values[0].size] if len(values) else "VEC3",
            }
        )
        data += values.tobytes()
    accessors[0] |= accessor or {}
    part = {"attributes": {"POSITION": 0}, "indices": 1} | (primitive or {})
    header = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [part]}],
        "buffers": [{"byteLength": len(data), "uri": uri(data)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    return json.dumps(header | tree).encode()


def glb(header: bytes) -> bytes:
    """A glTF file as the JSON chunk of a GLB."""
    header += b" " * (-len(header) % 4)
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(header), len(header), b"JSON") + header

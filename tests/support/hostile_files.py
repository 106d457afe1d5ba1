"""Damaged and hostile files of every format that is read: valid ones, mutated by a seed."""

from __future__ import annotations

import functools
import io
import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from godfit.errors import InputError

SIDE = 12
"""Pixels of a side of the pictures: small files make a mutation likely to matter."""
SCENE = """[image]
width = 32
height = 24
antialias = true
[camera]
position = [0, 0, 7]
fov_y = 60.0
[light]
position = [0.5, 0, 0]
radius = 0.8
colour = "#ffeedd"
[scattering]
shader = "dawntime"
samples = 100
[[object]]
primitive = "box"
position = [0, 1, 3]
[[object]]
mesh = "part.obj"
scale = 0.5
"""
SIDECAR = 'mask = "mask.png"\n[scattering]\nshader = "dawntime"\nsamples = 100\nlights = 1\n'
DRAWING = """[image]
width = 32
height = 24
softness = 1.0
[sky]
sun = [1.0, 0.9, 0.8]
[[shape]]
kind = "disc"
centre = [0.1, 0.2]
radius = 0.2
radiance = [1.0, 0.5, 0.0]
"""
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf -1 -2 -3\nf 1/1 2/2 4/4\n"
RECORD = {
    "schema": 1,
    "model": "mitchell",
    "shader": "dawntime",
    "samples": 100,
    "params": {
        name: {"value": value, "stderr": 0.1}
        for name, value in (
            ("exposure", 0.08), ("decay", 0.97), ("density", 0.9), ("weight", 0.6),
            ("light_x", 0.5), ("light_y", 0.6),
        )
    },
    "size": [SIDE, SIDE],
    "pass_size": [SIDE, SIDE],
    "transfer": "none",
    "inputs": {"mask": {"path": "mask.png", "sha256": "0"}},
}  # fmt: skip
SPLICES = (
    b"[" * 600, b"{" * 600, b"9" * 5000, b"-" * 30, b"1e999", b"nan", b"inf", b"\0" * 9,
    b"\xff" * 9, b"\x1b[31m\x07", b'""', b"-1", b"99999999999999999999", b"null", b"true", b"[[]]",
    b"\n\n", b"0x" + b"f" * 6000, b"/dev/zero", b"../", b"\x80\x00\x00\x00", b"1e30", b"\xed\xa0",
)  # fmt: skip
"""What is put into files: nested brackets, numbers without end, terminal escapes, other types."""


def valid_files() -> dict[str, bytes]:
    """A small valid file of every format, by name."""
    import imagecodecs
    import OpenEXR
    import tifffile
    import trimesh
    import trimesh.exchange.gltf
    from PIL import Image

    rng = np.random.default_rng(0)
    grey = rng.integers(0, 256, (SIDE, SIDE), dtype=np.uint8)
    colour = rng.integers(0, 2**16, (SIDE, SIDE, 3), dtype=np.uint16)
    floats = rng.random((SIDE, SIDE, 3)).astype(np.float32)
    jpeg, tiff, npy, exr = (io.BytesIO() for _ in range(4))
    Image.fromarray(grey).save(jpeg, "JPEG")
    tifffile.imwrite(tiff, colour, compression="zlib", photometric="rgb")
    np.save(npy, floats)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": floats}).write(exr)
    mesh: Any = trimesh.creation.box()
    meshes = {f"box.{kind}": mesh.export(file_type=kind) for kind in ("ply", "stl", "glb")}
    ascii_ply = mesh.export(file_type="ply", encoding="ascii")
    gltf: Any = trimesh.exchange.gltf.export_gltf(trimesh.Scene(mesh), embed_buffers=True)
    ((_, tree),) = [(k, v) for k, v in gltf.items() if k.endswith(".gltf")]
    return {
        "grey.png": bytes(imagecodecs.png_encode(grey)),
        "colour.png": bytes(imagecodecs.png_encode(colour)),
        "a.jpg": jpeg.getvalue(),
        "a.tiff": tiff.getvalue(),
        "a.exr": exr.getvalue(),
        "a.npy": npy.getvalue(),
        "a.scene.toml": SCENE.encode(),
        "a.toml": SIDECAR.encode(),
        "a.drawing.toml": DRAWING.encode(),
        "fit.json": json.dumps(RECORD).encode(),
        "part.obj": OBJ.encode(),
        "text.ply": ascii_ply,
        "a.gltf": tree,
        "a.mp4": _video(),
        **{name: bytes(data) for name, data in meshes.items()},
        **_more_images(colour),
    }


def _more_images(words: np.ndarray) -> dict[str, bytes]:
    """The picture ``words`` (h, w, 3), 16 bits, in the formats that take one call of a library."""
    import imagecodecs
    import netpbmfile
    from PIL import Image

    levels = (words >> 8).astype(np.uint8)
    found: dict[str, bytes] = {
        "a.qoi": bytes(imagecodecs.qoi_encode(levels)),
        "a.jp2": bytes(imagecodecs.jpeg2k_encode(levels, level=0)),
        "a.hdr": b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (SIDE, SIDE)
        + np.dstack([levels, np.full((SIDE, SIDE), 129, np.uint8)]).tobytes(),
    }
    netpbm = io.BytesIO()
    netpbmfile.imwrite(netpbm, words)
    found["a.ppm"] = netpbm.getvalue()
    for name, kind in (("bmp", "BMP"), ("tga", "TGA"), ("gif", "GIF"), ("webp", "WEBP"),
                       ("avif", "AVIF")):  # fmt: skip
        stream = io.BytesIO()
        Image.fromarray(levels).save(stream, kind)
        found[f"a.{name}"] = stream.getvalue()
    return found


def _video() -> bytes:
    import av

    stream = io.BytesIO()
    with av.open(stream, "w", format="mp4") as container:
        video = container.add_stream("mpeg4", rate=5)
        video.width, video.height = 32, 32
        for level in (10, 200):
            frame = av.VideoFrame.from_ndarray(np.full((32, 32, 3), level, np.uint8))
            container.mux(video.encode(frame))
        container.mux(video.encode())
    return stream.getvalue()


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """A copy that is cut, flipped, doubled, overwritten or spliced at one place or a few."""
    out = bytearray(data)
    for _ in range(rng.geometric(0.7)):
        at, length = int(rng.integers(len(out) + 1)), int(rng.integers(1, 40))
        kind = rng.integers(6)
        if kind == 0 and out:
            out[min(at, len(out) - 1)] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            del out[at:]
        elif kind == 2:
            out[at:at] = out[at : at + length]
        elif kind == 3:
            out[at : at + length] = rng.bytes(length)
        else:
            splice = SPLICES[rng.integers(len(SPLICES))]
            # Over a whole word, in a text: the value of a key gets another type.
            end = at
            while kind == 5 and end < len(out) and out[end : end + 1] not in b' ,]}\n"':
                end += 1
            out[at:end] = splice
    return bytes(out)


def read(path: Path) -> None:
    """Read a file as the program does. Raises InputError where that is right."""
    from godfit.flatland.drawing import read_drawing
    from godfit.io.frames import frames
    from godfit.io.image import read_image
    from godfit.io.sidecar import read_sidecar
    from godfit.report.record import recorded
    from godfit.scenes import mesh
    from godfit.scenes.scene import read_scene

    readers: dict[str, Callable[[str], object]] = {
        ".scene.toml": read_scene,
        ".drawing.toml": read_drawing,
        ".toml": lambda name: read_sidecar(name.removesuffix(".toml") + ".png"),
        ".json": functools.partial(recorded, mask=str(path.parent / "mask.png")),
        ".mp4": lambda name: list(frames([name], 1)),
        **{kind: lambda name: mesh.load(Path(name)) for kind in mesh.MESH_SUFFIXES},
        "": read_image,
    }
    reader = next(reader for end, reader in readers.items() if path.name.endswith(end))
    reader(str(path))


def attempt(path: Path) -> str:
    """How reading a file ended: "read", "refused" in one plain line, or what was wrong."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read(path)
    except InputError as error:
        line = str(error)
        return "refused" if line.isprintable() and len(line) < 3000 else f"said {line!r:.200}"
    except Exception as error:
        return f"raised {type(error).__name__}: {str(error)[:200]}"
    return "read"


def write_hostile(folder: Path, files: dict[str, bytes], seed: int) -> Path:
    """Mutate one of the valid ``files``, chosen by ``seed``, write it, and return its path."""
    rng = np.random.default_rng(seed)
    name = sorted(files)[seed % len(files)]
    path = folder / name
    path.write_bytes(mutated(files[name], rng))
    return path

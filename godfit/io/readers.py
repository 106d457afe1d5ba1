"""Readers of the image formats that need one library call each.

A reader takes a file's bytes, a list of notes to add to and the check of (height, width), which it
calls before it decodes. It returns the stored samples (h, w[, 1 to 4]) and the largest value that
they can have, None for floats. Each uses the library that keeps all of a format's bits.
"""

from __future__ import annotations

import importlib
import io
import re
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from godfit.errors import InputError

ISO_BRANDS = {
    b"avif": "AVIF", b"avis": "AVIF", b"heic": "HEIC", b"heix": "HEIC", b"mif1": "HEIC",
    b"msf1": "HEIC", b"hevc": "HEIC",
}  # fmt: skip
"""Image formats in the ISO base media container, by the brand in bytes 8 to 12."""
TGA_FOOTER = b"TRUEVISION-XFILE.\0"
"""The last bytes of a TGA file of version 2. Version 1 has no signature at all."""
TGA_KINDS = (1, 2, 3, 9, 10, 11)
"""Image types of TGA: colour-mapped, colour and grey, plain and run-length encoded."""
QOI_END = bytes(7) + b"\1"
"""The last bytes of a QOI file, which the decoder does not read."""
LOSSY = "{} is lossy: rounding intervals are not exact."
HEADER_BYTES = 4096
"""Bytes in which a text header is searched for: they hold a few comments as well."""

RGBE_BITS = 8
"""Bits of each mantissa of a Radiance file."""

CheckSize = Callable[[tuple[int, ...]], None]


class Samples(NamedTuple):
    """Stored samples (h, w[, 1 to 4]), the integer that stands for 1, None for floats, and the
    ``step`` (h, w) between neighbouring values of floats that share an exponent."""

    codes: np.ndarray
    top: int | None
    step: np.ndarray | None = None

    @staticmethod
    def of(codes: np.ndarray) -> Samples:
        """Integers that use all their bits, or floats."""
        return Samples(codes, int(np.iinfo(codes.dtype).max) if codes.dtype.kind == "u" else None)


Reader = Callable[[bytes, list[str], CheckSize], Samples]


def recognised(data: bytes, suffix: str) -> tuple[str, Reader] | None:
    """Name and reader of the format of a file's bytes; None where it is none of these.

    Only TGA is recognised by its ``suffix`` too, because its first version has no signature.
    """
    for magic, named in _BY_MAGIC.items():
        if data.startswith(magic):
            return named
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return "WebP", _read_webp
    if data[4:8] == b"ftyp" and data[8:12] in ISO_BRANDS:
        name = ISO_BRANDS[data[8:12]]
        # Files of both kinds may have the general brand first and their own after it.
        if b"avif" in data[8:64]:
            name = "AVIF"
        return name, _read_avif if name == "AVIF" else _read_heic
    if re.match(rb"P[1-7Ff][\s#]", data[:3]):
        return "netpbm", _read_netpbm
    kind = data[2] if len(data) > 18 else -1
    if data.endswith(TGA_FOOTER) or (suffix == ".tga" and kind in TGA_KINDS):
        return "TGA", _read_tga
    return None


def _pillow(plugin: Any, data: bytes, check: CheckSize, modes: dict[str, str]) -> np.ndarray:
    """Bytes as a plugin of Pillow decodes them. ``modes`` maps its modes to those that are read."""
    with plugin(io.BytesIO(data)) as image:
        check((image.height, image.width))
        if image.mode not in modes:
            raise InputError(f"expected one of {', '.join(modes)}, got {image.mode}; convert it")
        image.load()
        return np.asarray(image.convert(modes[image.mode]))


COLOURS = {"1": "L", "L": "L", "LA": "LA", "P": "RGBA", "RGB": "RGB", "RGBA": "RGBA"}


def _read_bmp(data: bytes, notes: list[str], check: CheckSize) -> Samples:
    from PIL.BmpImagePlugin import BmpImageFile

    codes = _pillow(BmpImageFile, data, check, COLOURS)
    if int.from_bytes(data[28:30], "little") == 16:
        notes.append("Only 5 or 6 bits a channel: rounding intervals are not exact.")
    return Samples(codes, 255)


def _read_tga(data: bytes, notes: list[str], check: CheckSize) -> Samples:
    from PIL.TgaImagePlugin import TgaImageFile

    return Samples(_pillow(TgaImageFile, data, check, COLOURS), 255)


def _read_gif(data: bytes, notes: list[str], check: CheckSize) -> Samples:
    from PIL.GifImagePlugin import GifImageFile

    notes.append("A palette image: if its colours were reduced, rounding intervals are wrong.")
    return Samples(_pillow(GifImageFile, data, check, COLOURS), 255)


def _read_webp(data: bytes, notes: list[str], check: CheckSize) -> Samples:
    import imagecodecs
    from PIL.WebPImagePlugin import WebPImageFile

    with WebPImageFile(io.BytesIO(data)) as image:
        check((image.height, image.width))
    # Chunks follow the twelve bytes of the container; the extended header comes first if at all.
    if b"VP8L" not in data[12:64] and b"VP8 " in data[: data.find(b"VP8 ", 12) + 4]:
        notes.append(LOSSY.format("WebP"))
    return Samples(imagecodecs.webp_decode(data), 255)


def _read_avif(data: bytes, notes: list[str], check: CheckSize) -> Samples:
    import imagecodecs
    from PIL.AvifImagePlugin import AvifImageFile

    with AvifImageFile(io.BytesIO(data)) as image:
        check((image.height, image.width))
    notes.append(LOSSY.format("AVIF"))
    codes = imagecodecs.avif_decode(data)
    if codes.ndim == 4:
        codes = codes[0]
    # The box av1C holds, after its name and two bytes, whether there are more than 8 bits, and 12.
    place = data.find(b"av1C")
    flags = data[place + 6] if place >= 0 else 0
    bits = (12 if flags & 0x20 else 10) if flags & 0x40 else 8
    return Samples(codes, 2**bits - 1)


def _read_heic(data: bytes, notes: list[str], check: CheckSize) -> Samples:
    try:
        # By name: few users have it, and types are checked without it.
        pillow_heif: Any = importlib.import_module("pillow_heif")
    except ImportError:
        raise InputError(
            "expected a format that is read without pillow-heif, got HEIC; pip install "
            "'godfit[heic]', or convert it to 16-bit PNG"
        ) from None
    notes.append(LOSSY.format("HEIC"))
    file = pillow_heif.open_heif(io.BytesIO(data), convert_hdr_to_8bit=False)
    check((file.size[1], file.size[0]))
    codes = np.asarray(file)
    # pillow-heif scales 10 and 12 bits to 16.
    return Samples(codes, 65535 if codes.dtype == np.uint16 else 255)


def _read_jpeg2000(data: bytes, notes: list[str], check: CheckSize) -> Samples:
    import imagecodecs

    # The marker SIZ opens the code stream: sizes and offsets, then each component's bits.
    start = data.find(b"\xff\x4f\xff\x51")
    if start < 0 or len(data) < start + 43:
        raise InputError("the file is cut short; copy or save it again")
    x1, y1, x0, y0 = (
        int.from_bytes(data[start + i : start + i + 4], "big") for i in (8, 12, 16, 20)
    )
    check((y1 - y0, x1 - x0))
    depth = data[start + 42]
    if depth & 0x80 or (depth & 0x7F) > 15:
        raise InputError(f"expected 1 to 16 unsigned bits, got the depth code {depth}; convert it")
    return Samples(imagecodecs.jpeg2k_decode(data), 2 ** (depth + 1) - 1)


def _read_qoi(data: bytes, notes: list[str], check: CheckSize) -> Samples:
    import imagecodecs

    width, height = (int.from_bytes(data[i : i + 4], "big") for i in (4, 8))
    check((height, width))
    if not data.endswith(QOI_END):
        raise InputError("the file is cut short; copy or save it again")
    return Samples(imagecodecs.qoi_decode(data), 255)


def _read_hdr(data: bytes, notes: list[str], check: CheckSize) -> Samples:
    import imagecodecs

    size = re.search(rb"\n([-+])Y (\d+) ([-+])X (\d+)\n", data[:HEADER_BYTES])
    if size is None or size[1] != b"-" or size[3] != b"+":
        raise InputError("expected rows from the top (-Y h +X w), got another order; convert it")
    check((int(size[2]), int(size[4])))
    codes = imagecodecs.rgbe_decode(data)
    # The largest channel has a mantissa of eight bits from 128 on.
    exponent = np.frexp(codes.max(-1))[1]
    return Samples(codes, None, np.ldexp(np.float32(1), exponent - RGBE_BITS))


def _read_netpbm(data: bytes, notes: list[str], check: CheckSize) -> Samples:
    from netpbmfile import NetpbmFile

    with NetpbmFile(io.BytesIO(data)) as file:
        check((file.height, file.width))
        codes = file.asarray()
    if file.magicnumber in ("P1", "P4"):
        # A bitmap's 1 is black.
        return Samples((1 - np.asarray(codes, np.uint8)) * np.uint8(255), 255)
    if codes.dtype.kind == "f":
        # Rows are stored from the bottom.
        return Samples(codes[::-1], None)
    return Samples(codes, int(file.maxval))


_BY_MAGIC: dict[bytes, tuple[str, Reader]] = {
    b"GIF8": ("GIF", _read_gif),
    b"BM": ("BMP", _read_bmp),
    b"qoif": ("QOI", _read_qoi),
    b"#?RADIANCE": ("Radiance HDR", _read_hdr),
    b"#?RGBE": ("Radiance HDR", _read_hdr),
    b"\0\0\0\x0cjP  \r\n\x87\n": ("JPEG 2000", _read_jpeg2000),
    b"\xff\x4f\xff\x51": ("JPEG 2000", _read_jpeg2000),
}
"""Name and reader of each format, by the file's first bytes."""

OTHER_FORMATS = {
    b"8BPS": "Photoshop", b"DDS ": "DDS", b"gimp xcf": "GIMP", b"\0\0\x01\0": "ICO",
    b"\xff\x0a": "JPEG XL", b"\0\0\0\x0cJXL ": "JPEG XL", b"%PDF": "PDF", b"%!PS": "PostScript",
    b"<svg": "SVG", b"<?xml": "SVG or XML", b"\x1aE\xdf\xa3": "a Matroska video",
    b"PK\x03\x04": "a ZIP archive", b"\x89HDF": "HDF5", b"glTF": "a glTF scene",
    b"CFGP": "Gimp", b"FUJIFILM": "camera raw", b"II\x1a\0": "camera raw", b"#EXTM3U": "a playlist",
}  # fmt: skip
"""Names of formats that are not read, by the file's first bytes."""


def name_of_other(data: bytes) -> str:
    """What a file seems to be whose format is not read."""
    for magic, name in OTHER_FORMATS.items():
        if data.startswith(magic):
            return name
    if data[4:8] == b"ftyp":
        return "a video"
    return "no image"

"""Readers of the image formats whose decoders would pass over a cut or damaged file.

Each checks that the file is whole, and decodes it with the library that keeps all of its bits:
imagecodecs for PNG (Pillow and imageio cut 16-bit colour to 8), Pillow for JPEG (no other raises
for a file that is cut short), tifffile, OpenEXR and numpy. Arguments and results are those of
``godfit.io.readers``.
"""

from __future__ import annotations

import io
import zlib

import numpy as np

from godfit.errors import InputError
from godfit.io.exr_chunks import may_be_whole
from godfit.io.readers import CheckSize, Reader, Samples

PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}
"""Channels of the colour types of PNG; a palette is three."""
PNG_SAMPLES = {b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND"}
"""Chunks of a PNG that hold its samples. libpng warns of faults in others, which change none."""


def _note_orientation(orientation: int, notes: list[str]) -> None:
    if orientation != 1:
        notes.append(f"The orientation tag ({orientation}) was ignored: rows are as stored.")


def _read_png(data: bytes, notes: list[str], check: CheckSize) -> Samples:
    import imagecodecs

    # libpng does not read the last chunks, so a cut or damaged tail would pass.
    kinds: set[bytes] = set()
    used: set[int] = set()
    view, start = memoryview(data), 8
    kept = [view[:start]]
    while b"IEND" not in kinds:
        end = start + 12 + int.from_bytes(view[start : start + 4], "big")
        if end > len(data):
            raise InputError("the file is cut short; copy or save it again")
        if zlib.crc32(view[start + 4 : end - 4]) != int.from_bytes(view[end - 4 : end], "big"):
            raise InputError(f"the chunk at byte {start} is damaged; copy or save it again")
        kinds.add(data[start + 4 : start + 8])
        if data[start + 4 : start + 8] == b"sBIT":
            # Bits of each channel that hold something; the others only fill up.
            used = {bits for bits in data[start + 8 : end - 4] if bits > 0}
        if data[start + 4 : start + 8] in PNG_SAMPLES:
            kept.append(view[start:end])
        start = end
    if b"CgBI" in kinds:
        raise InputError(
            "expected a PNG, got one optimised for iOS (chunk CgBI); save it again without that"
        )
    if data[12:16] != b"IHDR" or int.from_bytes(data[8:12], "big") != 13:
        raise InputError(f"expected the chunk IHDR first, got {data[12:16]!r}; save it again")
    if b"acTL" in kinds:
        raise InputError("expected a still image, got an animation; save one frame")
    width, height = (int.from_bytes(data[i : i + 4], "big") for i in (16, 20))
    depth, colour = data[24], data[25]
    check((height, width, PNG_CHANNELS.get(colour, 1)))
    if colour == 3:
        notes.append("A palette image: if its colours were reduced, rounding intervals are wrong.")
    elif depth < 8:
        levels = 2**depth
        notes.append(f"Only {levels} grey levels: the true step is 1/{levels - 1}, not 1/255.")
    codes = imagecodecs.png_decode(data if kinds <= PNG_SAMPLES else b"".join(kept))
    bits = max(used, default=16)
    if colour != 3 and depth >= 8 and bits < depth:
        return Samples(codes >> (depth - bits), 2**bits - 1)
    return Samples.of(codes)


def _read_jpeg(data: bytes, notes: list[str], check: CheckSize) -> Samples:
    # PIL.Image.open has its own, lower size limit.
    from PIL.JpegImagePlugin import JpegImageFile

    notes.append("JPEG is lossy: rounding intervals are not exact.")
    with JpegImageFile(io.BytesIO(data)) as image:
        if image.mode not in ("L", "RGB"):
            raise InputError(f"expected grey or RGB, got {image.mode}; convert it to RGB")
        check((image.height, image.width))
        _note_orientation(image.getexif().get(274, 1), notes)
        image.load()
        return Samples.of(np.asarray(image))


def _read_tiff(data: bytes, notes: list[str], check: CheckSize) -> Samples:
    import tifffile

    with tifffile.TiffFile(io.BytesIO(data)) as tiff:
        page = tiff.pages.first
        # Reads up to the last page, whose pointer to the next must be 0.
        several = len(tiff.pages) > 1
        several |= any(data[tiff.pages.next_page_offset :][: tiff.tiff.offsetsize])
        if several or not isinstance(page, tifffile.TiffPage):
            raise InputError("expected one page, got several; save the wanted page by itself")
        check((page.imagelength, page.imagewidth))
        colours = {0: 0, 1: 1, 2: 3}.get(page.photometric, 0)  # black is 0; RGB
        if not colours or page.samplesperpixel - colours not in (0, 1):
            got = f"photometric {page.photometric!r} with {page.samplesperpixel} samples"
            raise InputError(f"expected grey or RGB with or without alpha, got {got}; convert it")
        # none, LZW, deflate, packbits, deflate, LZMA, Zstandard: the lossless ones
        if page.compression not in (1, 5, 8, 32773, 32946, 34925, 50000):
            got = f"{page.compression!r}"  # a number where the code is unknown
            raise InputError(f"expected no or lossless compression, got {got}; save it with LZW")
        # tifffile fills missing strips with zeros, and some decoders accept a cut one.
        strips = list(zip(page.dataoffsets, page.databytecounts, strict=False))
        whole = all(count and start + count <= len(data) for start, count in strips)
        if not whole or len(strips) != np.prod(page.chunked):
            raise InputError("the file is cut short or has missing strips; save it again")
        _note_orientation(page.tags.valueof(274, 1), notes)
        codes = page.asarray()
        if page.bitspersample != 8 * codes.dtype.itemsize:  # 12 bits: the step is not 1/65535
            raise InputError(f"expected 8 or 16 bits or floats, got {page.bitspersample} bits")
        return Samples.of(np.moveaxis(codes, 0, -1) if page.axes == "SYX" else codes)


def _read_exr(data: bytes, notes: list[str], check: CheckSize) -> Samples:
    import OpenEXR

    head = OpenEXR.File(io.BytesIO(data), header_only=True)
    if len(head.parts) != 1:
        raise InputError(f"expected one part, got {len(head.parts)}; save the wanted part")
    header = head.header()
    window = np.array(header["dataWindow"], dtype=np.int64)
    width, height = (int(n) for n in window[1] - window[0] + 1)
    check((height, width))
    if not np.array_equal(window, header["displayWindow"]):
        notes.append("Only the data window was read; it is not the whole display window.")
    if not may_be_whole(data):
        raise InputError("the file is cut short or damaged; copy or save it again")
    file = OpenEXR.File(io.BytesIO(data))
    if not file.parts:  # OpenEXR's only sign that the pixels could not be decoded
        raise InputError("the file is cut short or damaged; copy or save it again")
    channels = file.channels()
    colour = next((key for key in ("RGBA", "RGB", "Y") if key in channels), None)
    # OpenEXR has the channels NAME.R, NAME.G, NAME.B of a layer together under its name.
    layers = [name for name, found in channels.items() if found.pixels.ndim == 3]
    if colour is None and len(layers) == 1:
        (colour,) = layers
        notes.append(f"The values are those of the layer {colour}.")
    if colour is None or "RY" in channels:
        got = ", ".join(layers if len(layers) > 1 else channels)
        raise InputError(f"expected channels R, G, B or Y, or one layer, got {got}; save one alone")
    others = sorted(set(channels) - {colour, "A"})
    if others:
        notes.append(f"Other channels were dropped: {', '.join(others)}.")
    codes = channels[colour].pixels
    if "A" in channels and codes.shape[2:] != (4,):
        codes = np.dstack([codes, channels["A"].pixels])
    return Samples.of(codes)


def _read_npy(data: bytes, notes: list[str], check: CheckSize) -> Samples:
    # Unlike np.load this copies nothing, never unpickles, and checks the shape before any sample.
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
    else:
        shape, fortran, dtype = np.lib.format.read_array_header_2_0(stream)
    check(shape)
    if dtype.kind not in "fu":
        raise InputError(f"expected uint8, uint16 or float samples, got {dtype}; convert them")
    expected, got = int(np.prod(shape)) * dtype.itemsize, len(data) - stream.tell()
    if got != expected:
        raise InputError(f"expected {expected} bytes of samples, got {got}; save it again")
    flat = np.frombuffer(data, dtype, offset=stream.tell())
    return Samples.of(flat.reshape(shape, order="F" if fortran else "C"))


READERS: dict[bytes, tuple[str, Reader]] = {
    b"\x89PNG\r\n\x1a\n": ("PNG", _read_png),
    b"\xff\xd8\xff": ("JPEG", _read_jpeg),
    b"II*\0": ("TIFF", _read_tiff),
    b"MM\0*": ("TIFF", _read_tiff),
    b"II+\0": ("BigTIFF", _read_tiff),
    b"MM\0+": ("BigTIFF", _read_tiff),
    b"v/1\x01": ("EXR", _read_exr),
    b"\x93NUMPY": (".npy", _read_npy),
}
"""Name and reader of each format that needs more than one call, by the file's first bytes."""

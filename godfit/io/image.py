"""Image files <-> linear float32 arrays; a file that would lose bits is refused.

Arrays are (height, width) or (height, width, 3), row 0 at the top, 1.0 = the brightest level.
A format is recognised by the file's first bytes, never by its name. Each format has the reader that
keeps all of its bits: imagecodecs for PNG (Pillow and imageio cut 16-bit colour to 8), Pillow for
JPEG (no other raises for a file that is cut short), tifffile, OpenEXR and numpy. The formats that
need one call of a library are in ``godfit.io.readers``.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import os
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from godfit.errors import InputError
from godfit.io import readers
from godfit.io.exr_chunks import may_be_whole
from godfit.io.readers import CheckSize, Reader, Samples
from godfit.io.regular_files import read_regular
from godfit.runtime.files import atomic_write
from godfit.runtime.memory import check_memory

LEVELS = 255.0
"""8-bit levels from black to white; residuals and noise are given in them."""
PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}
"""Channels of the colour types of PNG; a palette is three."""
TRANSFERS = ("none", "srgb")
"""Transfer functions by which files may be encoded."""
IMAGE_FORMATS = "PNG, JPEG, TIFF, EXR, WebP, AVIF, HDR, TGA, BMP, PPM or .npy"
"""Formats that are read, as errors name them; fewer than there are."""
FEWEST_CODES = 16
"""Different codes that an image needs to tell how many of its bits are in use."""
MAX_PIXELS = 2**27
"""Pixels above which a header counts as damaged or a decompression bomb, unless ``limit_pixels``
raises it: 11,585 squared, of which a colour image takes 1.6 GB."""
READING_BYTES = 5
"""Memory that reading takes a sample, in bytes: its code, and its value in float32."""
SRGB_LINEAR_END = 0.04045
"""Encoded value at which sRGB's linear segment ends and its power begins (IEC 61966-2-1)."""
SRGB_LINEAR_END_DECODED = 0.0031308
"""The same in linear light."""
PNG_SAMPLES = {b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND"}
"""Chunks of a PNG that hold its samples. libpng warns of faults in others, which change none."""
VALUES_PER_STRIDE = 2**18
"""Values that are converted at a time: the float64 copies of a whole image would take too much."""


@dataclass(frozen=True, eq=False)  # == on arrays has no single truth value
class Image:
    """An image in linear light, and how it was stored."""

    values: np.ndarray  # float32, (h, w) or (h, w, 3), linear
    quantum: float | None  # step of the encoded values: 1/255, 1/65535, or None for floats
    transfer: str  # "none" or "srgb"
    path: str  # as given; "" if made in memory
    sha256: str  # hash of the file's bytes
    notes: tuple[str, ...] = ()  # plain sentences on anything dropped or doubtful
    # How far below and above the stored value of short floats the true one may lie, float32 of the
    # shape of ``values``, encoded; None where ``quantum`` says it, and for float32.
    rounding: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def encoded(self) -> np.ndarray:
        """float32 values in the file's own encoding: k * quantum, up to float32 rounding."""
        if self.transfer == "none":
            return self.values
        return _by_rows(lambda rows: encode(rows, self.transfer), self.values, np.float32)


def decode(x: Any, transfer: str) -> Any:
    """Encoded -> linear (IEC 61966-2-1 for "srgb"), elementwise on a numpy or jax float array.

    The linear segment continues below 0, the power above 1. Raises InputError for an unknown
    transfer.
    """
    if _checked_transfer(transfer) == "none":
        return x
    xp = x.__array_namespace__()
    # The maximum keeps the unused branch of the where, and its gradient, finite.
    power = ((xp.maximum(x, SRGB_LINEAR_END) + 0.055) / 1.055) ** 2.4
    return xp.where(x <= SRGB_LINEAR_END, x / 12.92, power)


def encode(x: Any, transfer: str) -> Any:
    """Linear -> encoded: the inverse of ``decode``, on the same arrays, with the same errors."""
    if _checked_transfer(transfer) == "none":
        return x
    xp = x.__array_namespace__()
    power = 1.055 * xp.maximum(x, SRGB_LINEAR_END_DECODED) ** (1 / 2.4) - 0.055
    return xp.where(x <= SRGB_LINEAR_END_DECODED, x * 12.92, power)


def read_image(
    path: str | os.PathLike[str], *, transfer: str = "none", finite: bool = True
) -> Image:
    """Read an image file; values are decoded to linear.

    Alpha is dropped, unless the colours are all alike and the picture is in the alpha channel:
    then it is colour over black. With ``finite`` False, NaN and infinity are returned as they are.

    Raises InputError, naming the path, for a file that cannot be read whole and exactly.
    """
    image, alpha = read_layer(path, transfer=transfer, finite=finite)
    return image if alpha is None else with_alpha(image, alpha)


def with_alpha(image: Image, alpha: np.ndarray) -> Image:
    """``image`` where its ``alpha`` (h, w) is full everywhere or no part of the picture, with a
    note; where all of the picture is in alpha, the one colour over black, or black over white."""
    if (alpha >= 1).all():
        return image
    colours = np.atleast_3d(image.values)[alpha > 0]
    alike = not colours.size or np.ptp(colours, axis=0).max() * LEVELS <= 1
    if not alike or np.ptp(alpha) * LEVELS <= 1:
        note = "The alpha channel is not full everywhere; it was dropped."
        return dataclasses.replace(image, notes=(*image.notes, note))
    colour = colours[0] if colours.size else np.zeros(1, np.float32)
    if not colour.any():
        # Black on nothing, as objects are drawn for a sky to shine past them.
        note = "The picture is in the alpha channel of a black image: taken as black over white."
        values = 1 - alpha
    else:
        note = "The picture is in the alpha channel, its colour is the same everywhere: taken as "
        note += "that colour over black."
        # Alpha is blended in the file's own encoding, as viewers do.
        encoded = encode(colour.astype(np.float64), image.transfer)
        shape = alpha.shape if len(colour) == 1 else (*alpha.shape, len(colour))
        values = (alpha if len(colour) == 1 else alpha[..., None]) * encoded.astype(np.float32)
        values = values.reshape(shape)
    linear = np.asarray(decode(values, image.transfer), np.float32)
    return dataclasses.replace(image, values=linear, notes=(*image.notes, note))


def read_layer(
    path: str | os.PathLike[str], *, transfer: str = "none", finite: bool = True
) -> tuple[Image, np.ndarray | None]:
    """As ``read_image``, with the alpha channel, (h, w) float32 from 0 to 1; None without one."""
    _checked_transfer(transfer)
    name = os.fsdecode(path)
    data = read_regular(name, IMAGE_FORMATS)
    kind, reader = _recognise(data, name)
    digest, notes = hashlib.sha256(data).hexdigest(), []
    try:
        codes, top, step = reader(data, notes, check_pixels)
        del data  # up to a third of the memory in use
        values, quantum, alpha = _linear(codes, top, transfer, notes, finite)
        rounding = _rounding(codes, step, values)
    except MemoryError:
        raise InputError(f"{name!r} ({kind}): out of memory; expected a smaller image") from None
    except Exception as error:
        raise InputError(f"{name!r} ({kind}): {str(error) or type(error).__name__}") from error
    return Image(values, quantum, transfer, name, digest, tuple(notes), rounding), alpha


def write_image(
    path: str | os.PathLike[str], values: Any, *, transfer: str = "none", bits: int = 8
) -> None:
    """Write linear (h, w) or (h, w, 3) values to .png (8 or 16 bits), .exr or .npy, whole or not at
    all.

    PNG: encoded with the transfer, clipped to [0, 1], rounded half up to the nearest level.
    .exr and .npy: float32, linear, whatever the transfer. Raises InputError.
    """
    _checked_transfer(transfer)
    name = os.fsdecode(path)
    suffix = os.path.splitext(name)[1].lower()
    if suffix not in (".png", ".exr", ".npy"):
        raise InputError(
            f"{name!r}: expected a name in .png, .exr or .npy, got {suffix!r}; rename it"
        )
    if bits not in (8, 16):
        raise InputError(f"{name!r}: expected 8 or 16 bits, got {bits!r}")
    values = np.asarray(values)
    if values.dtype.kind not in "fiu" or values.shape[2:] not in ((), (3,)):
        got = f"{values.dtype} {values.shape}"
        raise InputError(f"{name!r}: expected numbers (h, w) or (h, w, 3), got {got}")
    try:
        check_pixels(values.shape, values.size)
        with np.errstate(over="ignore"):
            values = _checked_finite(values.astype(np.float32, copy=False))
        if suffix == ".npy":
            stream = io.BytesIO()
            np.save(stream, values, allow_pickle=False)
            data = stream.getvalue()
        elif suffix == ".exr":
            import OpenEXR

            stream, colour = io.BytesIO(), "RGB" if values.ndim == 3 else "Y"
            header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
            OpenEXR.File(header, {colour: np.ascontiguousarray(values)}).write(stream)
            data = stream.getvalue()
        else:
            import imagecodecs

            top = 2**bits - 1
            data = imagecodecs.png_encode(
                _by_rows(
                    lambda rows: np.floor(encode(rows.clip(0, 1), transfer) * top + 0.5),
                    values,
                    np.uint8 if bits == 8 else np.uint16,
                )
            )
        atomic_write(name, bytes(data))
    except (OSError, ValueError, RuntimeError) as error:  # RuntimeError: libpng's
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{name!r}: cannot be written: {reason}") from error


def _checked_transfer(transfer: str) -> str:
    if transfer not in TRANSFERS:
        raise InputError(f"expected transfer 'none' or 'srgb', got {transfer!r}")
    return transfer


def _by_rows(function: Callable[[Any], Any], source: np.ndarray, dtype: Any) -> np.ndarray:
    """The elementwise ``function`` of ``source``, computed in float64 where that is float, on
    a few rows at a time."""
    out = np.empty(source.shape, dtype)
    step = max(1, VALUES_PER_STRIDE // source[0].size)
    for start in range(0, len(source), step):
        rows = source[start : start + step]
        out[start : start + step] = function(
            rows.astype(np.float64) if rows.dtype.kind == "f" else rows
        )
    return out


def _checked_finite(values: np.ndarray) -> np.ndarray:
    bad = np.asarray(~np.isfinite(values))
    if bad.any():
        raise InputError(not_finite(bad))
    return values


def not_finite(bad: np.ndarray) -> str:
    """What is wrong with an image whose values are not finite where ``bad`` (h, w[, c])."""
    bad = np.asarray(bad.reshape(*bad.shape[:2], -1).any(-1))
    rows, columns = np.nonzero(bad)
    x, y = int(columns.min()), int(rows.min())
    box = f"{x},{y},{int(columns.max()) - x + 1},{int(rows.max()) - y + 1}"
    return (
        f"expected finite float32 values, got NaN or infinity in {len(rows)} of {bad.size} pixels "
        f"inside X,Y,W,H {box}; replace them, or leave them out of a target by --ignore"
    )


def limit_pixels(count: int = MAX_PIXELS) -> None:
    """Let images have up to ``count`` pixels from now on."""
    global _most_pixels
    _most_pixels = count


_most_pixels = MAX_PIXELS


def check_pixels(shape: tuple[int, ...], most: int | None = None) -> None:
    """Raise for an empty, huge or wrongly shaped image, if possible before it is decoded: one of
    more than ``most`` pixels, by default the number set by ``limit_pixels``."""
    most = most or _most_pixels
    if len(shape) not in (2, 3) or (len(shape) == 3 and not 1 <= shape[2] <= 4):
        raise InputError(f"expected a shape (h, w) or (h, w, 1 to 4), got {shape}")
    if not 0 < shape[0] * shape[1] <= most or min(shape) < 0:
        raise InputError(
            f"expected from 1 to {most} pixels, got {shape[0]} x {shape[1]}; "
            "--max-pixels raises the limit"
        )
    check_memory(READING_BYTES * shape[0] * shape[1] * (shape[2] if len(shape) == 3 else 1))


def _linear(
    codes: np.ndarray, top: int | None, transfer: str, notes: list[str], finite: bool
) -> tuple[np.ndarray, float | None, np.ndarray | None]:
    """The stored samples (h, w[, 1 to 4]), integers up to ``top``, -> linear float32 values,
    quantum and alpha, to which no transfer applies; adds to ``notes``."""
    check_pixels(codes.shape)
    kind = codes.dtype.newbyteorder("=").name
    if kind not in ("uint8", "uint16", "float16", "float32", "float64"):
        raise InputError(f"expected uint8, uint16 or 16 to 64-bit float samples, got {kind}")
    alpha, scale = None, 1.0 if top is None else float(top)
    if codes.ndim == 3:
        if codes.shape[2] in (2, 4):
            alpha = _by_rows(lambda rows: rows / scale, codes[..., -1], np.float32)
            codes = codes[..., :-1]
        if codes.shape[2] == 1:
            codes = codes[..., 0]
    if kind == "float64":
        notes.append("64-bit floats were rounded to 32 bits.")
    if top is not None:
        unit, whole = _unit(codes, top)
        if unit != 1:
            notes.append(f"Every value is a multiple of {unit}: the levels go from 0 to {whole}.")
        codes = np.minimum(codes // codes.dtype.type(unit), whole) if unit != 1 else codes
        table = decode(np.arange(whole + 1) / whole, transfer).astype(np.float32)
        return _by_rows(lambda rows: table[rows], codes, np.float32), 1 / whole, alpha
    with np.errstate(over="ignore", invalid="ignore"):
        values = _by_rows(lambda rows: decode(rows, transfer), codes, np.float32)
    quantum = None
    if finite:
        _checked_finite(values)
    if transfer == "none":
        quantum = quantum_of(values)
        if quantum is not None:
            notes.append(
                f"All values are multiples of 1/{round(1 / quantum)}, which is taken as the step."
            )
    return values, quantum, alpha


def _rounding(
    codes: np.ndarray, step: np.ndarray | None, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """``Image.rounding`` of samples whose neighbours are a ``step`` (h, w) apart."""
    if step is not None:
        # Some writers cut the mantissa off and some round it.
        step = np.broadcast_to(step.reshape(step.shape + (1,) * (values.ndim - 2)), values.shape)
        return step / 2, step
    if codes.dtype != np.float16:
        return None
    colours = codes.reshape(*codes.shape[:2], -1)[..., : 1 if values.ndim == 2 else 3]
    with np.errstate(invalid="ignore"):
        half = np.nan_to_num(np.spacing(colours).astype(np.float32) / 2, posinf=0.0)
    half = np.abs(half).reshape(values.shape)
    return half, half


def _unit(codes: np.ndarray, top: int) -> tuple[int, int]:
    """The integer that all 16-bit ``codes`` are multiples of, and the largest level in its units.

    Ten bits in the high bits of sixteen are multiples of 64, and eight bits stretched to sixteen
    are multiples of 257. Their step is not 1/65535. 1 where few codes differ.
    """
    if top != 65535:
        return 1, top
    found = np.flatnonzero(np.bincount(codes.reshape(-1), minlength=1))
    unit = int(np.gcd.reduce(found)) if len(found) >= FEWEST_CODES else 1
    if unit == 257:
        return unit, 255
    # A power of two: the low bits are not in use.
    bits = (unit & -unit).bit_length() - 1
    return (2**bits, 2 ** (16 - bits) - 1) if 0 < bits <= 8 else (1, top)


def quantum_of(values: np.ndarray) -> float | None:
    """The step of floats that are all bytes or 16-bit words divided by their largest, or None."""
    first = values.reshape(-1)[:VALUES_PER_STRIDE]
    for top in (255, 65535):
        # A sample decides at once for nearly all that are no such levels.
        if all(_are_multiples(part, top) for part in (first, values)):
            return 1 / top
    return None


def _are_multiples(values: np.ndarray, top: int) -> bool:
    if not (values.size and values.min() >= 0 and values.max() <= 1):
        return False
    scaled = values.astype(np.float64) * top
    rounding = top * float(np.finfo(np.float32).eps)
    if np.abs(scaled - np.rint(scaled)).max() > rounding:
        return False
    return len(np.unique(np.rint(scaled))) >= FEWEST_CODES


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


_READERS: dict[bytes, tuple[str, Reader]] = {
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


def _recognise(data: bytes, name: str) -> tuple[str, Reader]:
    for magic, reader in _READERS.items():
        if data.startswith(magic):
            return reader
    found = readers.recognised(data, os.path.splitext(name)[1].lower())
    if found is not None:
        return found
    kind = readers.name_of_other(data)
    got = f"{kind} (first bytes {data[:8]!r})" if data else "an empty file"
    raise InputError(
        f"{name!r}: expected {IMAGE_FORMATS}, got {got}; convert it to 16-bit PNG or EXR"
    )

"""Image files <-> linear float32 arrays; a file that would lose bits is refused.

Arrays are (height, width) or (height, width, 3), row 0 at the top, 1.0 = the brightest level.
A format is recognised by the file's first bytes, never by its name. Each format has the reader that
keeps all of its bits: ``checked_readers.py`` has those whose files are checked here to be whole,
``readers.py`` those that need one call of a library.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from godfit.errors import InputError
from godfit.io import checked_readers, png_text, readers
from godfit.io.readers import Reader
from godfit.io.regular_files import read_regular
from godfit.io.transfer import checked_transfer, decode, encode
from godfit.runtime.files import atomic_write
from godfit.runtime.memory import check_memory

LEVELS = 255.0
"""8-bit levels from black to white; residuals and noise are given in them."""
IMAGE_FORMATS = "PNG, JPEG, TIFF, EXR, WebP, AVIF, HDR, TGA, BMP, PPM or .npy"
"""Formats that are read, as errors name them; fewer than there are."""
FEWEST_CODES = 16
"""Different codes that an image needs to tell how many of its bits are in use."""
MAX_PIXELS = 2**27
"""Pixels above which a header counts as damaged or a decompression bomb, unless ``limit_pixels``
raises it: 11,585 squared, of which a colour image takes 1.6 GB."""
READING_BYTES = 5
"""Memory that reading takes a sample, in bytes: its code, and its value in float32."""
VALUES_PER_STRIDE = 2**18
"""Values that are converted at a time: the float64 copies of a whole image would take too much."""


@dataclass(frozen=True, eq=False)  # == on arrays has no single truth value
class Image:
    """An image in linear light, and how it was stored.

    >>> import godfit
    >>> image = godfit.read_image("frame.png")
    >>> image.values.shape, round(1 / image.quantum), image.transfer
    ((96, 96), 255, 'none')
    """

    values: np.ndarray  # float32, (h, w) or (h, w, 3), linear
    quantum: float | None  # step of the encoded values: 1/255, 1/65535, or None for floats
    transfer: str  # see ``godfit/io/transfer.py``
    path: str  # as given; "" if made in memory
    sha256: str  # hash of the file's bytes
    notes: tuple[str, ...] = ()  # plain sentences on anything dropped or doubtful
    # How far below and above the stored value of short floats the true one may lie, float32 of the
    # shape of ``values``, encoded; None where ``quantum`` says it, and for float32.
    rounding: tuple[np.ndarray, np.ndarray] | None = None
    # Whether the file says that its values are exact up to their rounding, see ``png_text.py``.
    exact: bool = False

    @property
    def encoded(self) -> np.ndarray:
        """float32 values in the file's own encoding: k * quantum, up to float32 rounding."""
        if self.transfer == "none":
            return self.values
        return _by_rows(lambda rows: encode(rows, self.transfer), self.values, np.float32)


def read_image(
    path: str | os.PathLike[str], *, transfer: str = "none", finite: bool = True
) -> Image:
    """Read an image file; values are decoded to linear.

    Alpha is dropped, unless the colours are all alike and the picture is in the alpha channel:
    then it is colour over black. With ``finite`` False, NaN and infinity are returned as they are.

    Raises InputError, naming the path, for a file that cannot be read whole and exactly.

    >>> import godfit
    >>> godfit.read_image("mask.png").values.shape
    (96, 96)
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
    transfer = checked_transfer(transfer)
    name = os.fsdecode(path)
    data = read_regular(name, IMAGE_FORMATS)
    kind, reader = _recognise(data, name)
    digest, notes = hashlib.sha256(data).hexdigest(), []
    try:
        codes, top, step = reader(data, notes, check_pixels)
        exact = png_text.is_exact(data)
        del data  # up to a third of the memory in use
        values, quantum, alpha = _linear(codes, top, transfer, notes, finite)
        rounding = _rounding(codes, step, values)
    except MemoryError:
        raise InputError(f"{name!r} ({kind}): out of memory; expected a smaller image") from None
    except Exception as error:
        raise InputError(f"{name!r} ({kind}): {str(error) or type(error).__name__}") from error
    return Image(values, quantum, transfer, name, digest, tuple(notes), rounding, exact), alpha


def write_image(
    path: str | os.PathLike[str],
    values: Any,
    *,
    transfer: str = "none",
    bits: int = 8,
    exact: bool = False,
) -> None:
    """Write linear (h, w) or (h, w, 3) values to .png (8 or 16 bits), .exr or .npy, whole or not at
    all.

    PNG: encoded with the transfer, clipped to [0, 1], rounded half up to the nearest level. With
    ``exact`` it says that nothing but this rounding is between its values and the model's.
    .exr and .npy: float32, linear, whatever the transfer. Raises InputError.

    >>> import numpy as np, godfit
    >>> godfit.write_image("inverted.png", 1 - godfit.read_image("mask.png").values)
    """
    transfer = checked_transfer(transfer)
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
                    lambda rows: np.floor(encode(rows.clip(0), transfer).clip(0, 1) * top + 0.5),
                    values,
                    np.uint8 if bits == 8 else np.uint16,
                )
            )
        atomic_write(name, png_text.as_exact(bytes(data)) if exact else bytes(data))
    except (OSError, ValueError, RuntimeError) as error:  # RuntimeError: libpng's
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{name!r}: cannot be written: {reason}") from error


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


def _recognise(data: bytes, name: str) -> tuple[str, Reader]:
    for magic, reader in checked_readers.READERS.items():
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

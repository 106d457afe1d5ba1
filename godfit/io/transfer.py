"""Transfer functions: how the linear values of a picture were encoded.

A transfer is a name of ``CURVES``, a file with a curve, or several with ``+`` between them, applied
from left to right: ``reinhard+srgb`` is Reinhard's operator, and sRGB after it. Tone curves act on
each channel by itself and on values relative to the exposure that is fitted, so that a constant
before the curve does not matter.
"""

from __future__ import annotations

import hashlib
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from godfit.errors import InputError, shown
from godfit.io.regular_files import read_regular

SRGB_LINEAR_END = 0.04045
"""Encoded value at which sRGB's linear segment ends and its power begins (IEC 61966-2-1)."""
SRGB_LINEAR_END_DECODED = 0.0031308
"""The same in linear light."""
WHITE = 1 - 2.0**-20
"""Largest encoded value that is decoded where a curve reaches 1 at infinity: a hundredth of a level
of 16 bits below it."""
CURVE_FILES = (".cube", ".csv", ".txt", ".npy")
"""Endings of files that hold a curve."""
HASH_DIGITS = 10
"""Digits of the hash of a curve's file in its name: compiled programs are stored by that name."""


class Srgb(NamedTuple):
    """sRGB (IEC 61966-2-1). The linear segment continues below 0, the power above 1."""

    def encode(self, x: Any, xp: Any) -> Any:
        power = 1.055 * xp.maximum(x, SRGB_LINEAR_END_DECODED) ** (1 / 2.4) - 0.055
        return xp.where(x <= SRGB_LINEAR_END_DECODED, x * 12.92, power)

    def decode(self, y: Any, xp: Any) -> Any:
        # The maximum keeps the unused branch of the where, and its gradient, finite.
        power = ((xp.maximum(y, SRGB_LINEAR_END) + 0.055) / 1.055) ** 2.4
        return xp.where(y <= SRGB_LINEAR_END, y / 12.92, power)


class Rational(NamedTuple):
    """y = (a x^2 + b x + c) / (d x^2 + e x + f), rising from x = 0."""

    a: float
    b: float
    c: float
    d: float
    e: float
    f: float

    def encode(self, x: Any, xp: Any) -> Any:
        x = xp.maximum(x, 0)
        return ((self.a * x + self.b) * x + self.c) / ((self.d * x + self.e) * x + self.f)

    def decode(self, y: Any, xp: Any) -> Any:
        y = xp.clip(y, self.c / self.f, WHITE)
        a, b, c = self.a - self.d * y, self.b - self.e * y, self.c - self.f * y
        root = xp.sqrt(xp.maximum(b * b - 4 * a * c, 0))
        # Of two ways to write the root, the one without a difference of nearly equal numbers.
        near = -2 * c / xp.where(b > 0, b + root, 1)
        far = (root - b) / xp.where(b > 0, 1, 2 * a)
        return xp.where(b > 0, near, far)


def _scaled(curve: Rational, before: float, after: float) -> Rational:
    """``after`` times the curve of ``before`` times x."""
    top = (curve.a * before**2 * after, curve.b * before * after, curve.c * after)
    return Rational(*top, curve.d * before**2, curve.e * before, curve.f)


@dataclass(frozen=True, eq=False)
class Sampled:
    """A rising curve through the points (``x``, ``y``), straight between them."""

    x: np.ndarray
    y: np.ndarray

    def encode(self, x: Any, xp: Any) -> Any:
        return xp.interp(x, xp.asarray(self.x, x.dtype), xp.asarray(self.y, x.dtype))

    def decode(self, y: Any, xp: Any) -> Any:
        return xp.interp(y, xp.asarray(self.y, y.dtype), xp.asarray(self.x, y.dtype))


HABLE = Rational(0.14, 0.05 / 3, 0.0, 0.15, 0.5, 0.06)
"""Hable's curve of Uncharted 2 with A .15, B .5, C .1, D .2, E .02, F .3, as one fraction."""
HABLE_WHITE = 11.2
"""Linear value that Hable's curve shows as white."""
CURVES: dict[str, Any] = {
    "srgb": Srgb(),
    # Reinhard et al., Photographic Tone Reproduction for Digital Images (2002), equation 3.
    "reinhard": Rational(0.0, 1.0, 0.0, 0.0, 1.0, 1.0),
    # Narkowicz, ACES Filmic Tone Mapping Curve (2015).
    "aces": Rational(2.51, 0.03, 0.0, 2.43, 0.59, 0.14),
    # Hill's fit of ACES with the exposure of three.js, which divides by .6, for greys.
    "aces-hill": _scaled(
        Rational(1.0, 0.0245786, -0.000090537, 0.983729, 0.432951, 0.238081), 1 / 0.6, 1.0
    ),
    # Hable, Uncharted 2: HDR Lighting (GDC 2010), with its exposure bias of 2.
    "filmic": _scaled(HABLE, 2.0, 1 / float(HABLE.encode(np.float64(HABLE_WHITE), np))),
}
"""Curves from linear to encoded values, by name."""
TRANSFERS = ("none", *CURVES)
"""Names of transfers; a file with a curve, and several with + between them, are transfers too."""
# Curves of files, by the name of the file with the hash of its content.
_files: dict[str, Sampled] = {}


def checked_transfer(transfer: str) -> str:
    """The name of a transfer, a file's with the hash of its content. Raises InputError for an
    unknown name, and for a file that holds no rising curve."""
    if transfer in TRANSFERS or transfer in _files:
        return transfer
    plain = re.sub(rf"#[0-9a-f]{{{HASH_DIGITS}}}$", "", transfer)
    if plain.lower().endswith(CURVE_FILES):
        if "+" in plain and not os.path.exists(plain):
            return "+".join(map(checked_transfer, transfer.split("+")))
        return _curve_of(plain)
    if "+" in transfer:
        return "+".join(map(checked_transfer, transfer.split("+")))
    raise InputError(
        f"transfer: expected one of {', '.join(TRANSFERS)}, several with + between them, or a file "
        f"in {', '.join(CURVE_FILES)}, got {shown(transfer)}"
    )


def decode(x: Any, transfer: str) -> Any:
    """Encoded -> linear, elementwise on a numpy or jax float array. Raises InputError for an
    unknown transfer."""
    for curve in reversed(_parts(transfer)):
        x = curve.decode(x, x.__array_namespace__())
    return x


def encode(x: Any, transfer: str) -> Any:
    """Linear -> encoded: the inverse of ``decode``, on the same arrays, with the same errors."""
    for curve in _parts(transfer):
        x = curve.encode(x, x.__array_namespace__())
    return x


def _parts(transfer: str) -> list[Any]:
    if transfer == "none":
        return []
    if transfer in CURVES:
        return [CURVES[transfer]]
    name = checked_transfer(transfer)
    if name in _files:
        return [_files[name]]
    return [curve for part in name.split("+") for curve in _parts(part)]


def _curve_of(name: str) -> str:
    """The name of the curve in a file, with the hash of the file's content."""
    data = read_regular(name, "a file with a curve")
    key = f"{name}#{hashlib.sha256(data).hexdigest()[:HASH_DIGITS]}"
    if key not in _files:
        points = _points_of(name, data)
        if (
            len(points) < 2
            or not np.isfinite(points).all()
            or not (np.diff(points, axis=0) > 0).all()
        ):
            raise InputError(
                f"{name}: expected a curve that rises from each point to the next, got "
                f"{len(points)} points that do not; give pairs of linear and encoded values"
            )
        _files[key] = Sampled(points[:, 0], points[:, 1])
    return key


def _points_of(name: str, data: bytes) -> np.ndarray:
    """(n, 2) linear and encoded values in a file."""
    if name.lower().endswith(".npy"):
        array = np.asarray(np.load(name, allow_pickle=False), float)
    else:
        text = data.decode("utf-8", "replace")
        if name.lower().endswith(".cube"):
            return _points_of_cube(name, text)
        rows = [re.split(r"[,;\s]+", line.strip()) for line in text.splitlines() if line.strip()]
        try:
            array = np.array(
                [[float(number) for number in row] for row in rows if row[0][0] != "#"]
            )
        except ValueError:
            raise InputError(
                f"{name}: expected lines with a linear and an encoded value, got others"
            ) from None
    if array.ndim == 1 or array.shape[1:] == (1,):
        flat = array.reshape(-1)
        return np.stack([np.linspace(0, 1, len(flat)), flat], -1)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InputError(
            f"{name}: expected one column of encoded values over 0 to 1, or two of linear and "
            f"encoded ones, got an array {array.shape}"
        )
    return array


def _points_of_cube(name: str, text: str) -> np.ndarray:
    """The curve of a .cube file (Adobe, Cube LUT Specification 1.0): of one dimension, the same for
    every channel, or the grey diagonal of one of three that treats channels alike."""
    size, low, high, rows = None, 0.0, 1.0, []
    for line in text.splitlines():
        words = line.split()
        if not words or words[0][0] == "#" or words[0] == "TITLE":
            continue
        try:
            if words[0] in ("LUT_1D_SIZE", "LUT_3D_SIZE"):
                size = words[0], int(words[1])
            elif words[0] == "DOMAIN_MIN":
                low = float(words[1])
            elif words[0] == "DOMAIN_MAX":
                high = float(words[1])
            else:
                rows.append([float(word) for word in words])
        except (ValueError, IndexError):
            raise InputError(f"{name}: expected a .cube file, got the line {shown(line)}") from None
    table = np.array(rows) if len({len(row) for row in rows}) == 1 else np.zeros((0, 3))
    if size is None or table.shape != (size[1] ** (3 if "3D" in size[0] else 1), 3):
        raise InputError(
            f"{name}: expected a .cube file with as many rows as its size says, got "
            f"{len(rows)} rows"
        )
    n = size[1]
    if "3D" in size[0]:
        # Red runs fastest.
        cube = table.reshape(n, n, n, 3)
        diagonal = cube[range(n), range(n), range(n)]
        alone = [cube[0, 0, :, 0], cube[0, :, 0, 1], cube[:, 0, 0, 2]]
        if any(np.abs(one - diagonal[:, c]).max() > 1 / 255 for c, one in enumerate(alone)):
            raise InputError(
                f"{name}: expected a curve for each channel, got a table that mixes channels; give "
                "a LUT_1D_SIZE file"
            )
        table = diagonal
    if np.ptp(table, axis=1).max() > 1 / 255:
        raise InputError(f"{name}: expected one curve for all channels, got different ones")
    return np.stack([np.linspace(low, high, n), table.mean(1)], -1)


def file_of(transfer: str) -> Path | None:
    """The file of a transfer, None where it is a name."""
    return Path(transfer.rpartition("#")[0]) if transfer in _files else None

"""A canvas: the radiance that its pixels emit and their opacity."""

from __future__ import annotations

import os

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from godfit.errors import InputError
from godfit.io.image import Image, read_layer

MODEL_NAME = "flatland"
"""The model whose picture is the light about a canvas."""

MAX_CANVAS_SIDE = 16384
"""Pixels: the kernels number cells in 32 bits, the jump flood rows and columns in 15 bits each."""

EXR_MAGIC = b"\x76\x2f\x31\x01"
"""The first bytes of an OpenEXR file, by its specification."""


class Canvas(eqx.Module):
    """``radiance`` (h, w, 3), linear, is what a pixel emits in every direction, and ``opacity``
    (h, w) the share of the light behind it that it hides: a ray through a pixel carries
    radiance + (1 - opacity) * behind (alpha is associated, as in OpenEXR). Pixels are square.

    Opacity is that of the pixel, however long a ray's way through it is. It is meant for the edges
    of shapes; a wide haze of it hides up to 1.41 times as much along the diagonal.
    """

    radiance: Float[Array, "h w 3"]
    opacity: Float[Array, "h w"]

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) in pixels."""
        return self.opacity.shape[0], self.opacity.shape[1]


def canvas(radiance, opacity) -> Canvas:
    """A canvas of arrays. Raises InputError unless radiance (h, w, 3) is finite and not negative
    and opacity (h, w) lies between 0 and 1."""
    radiance, opacity = np.asarray(radiance), np.asarray(opacity)
    if opacity.ndim != 2 or radiance.shape != (*opacity.shape, 3) or opacity.size == 0:
        raise InputError(
            "canvas: expected radiance (h, w, 3) and opacity (h, w) with pixels, got "
            f"{radiance.shape} and {opacity.shape}"
        )
    if max(opacity.shape) > MAX_CANVAS_SIDE:
        raise InputError(
            f"canvas: expected at most {MAX_CANVAS_SIDE} rows and columns, got "
            f"{opacity.shape[0]} x {opacity.shape[1]}; scale it down"
        )
    if not np.isfinite(radiance).all() or not (radiance >= 0).all():
        worst = radiance[~np.isfinite(radiance)][0] if not np.isfinite(radiance).all() else None
        got = radiance.min() if worst is None else worst
        raise InputError(
            f"canvas: expected radiance of 0 or more (above 1 is allowed), got {got:g}; "
            "clip or mend it"
        )
    if not ((opacity >= 0) & (opacity <= 1)).all():
        worst = opacity[~((opacity >= 0) & (opacity <= 1))][0]
        raise InputError(f"canvas: expected opacity from 0 to 1, got {worst:g}; scale it")
    return Canvas(jnp.asarray(radiance, float), jnp.asarray(opacity, float))


def from_rgba(values: UInt8[np.ndarray, "h w 4"]) -> Canvas:
    """The canvas of bytes: colour is emission, not multiplied by alpha, and alpha is opacity."""
    shares = values / 255
    return canvas(shares[..., :3] * shares[..., 3:], shares[..., 3])


def from_image(image: Image, alpha: np.ndarray | None, *, associated: bool = False) -> Canvas:
    """The canvas of an image whose colour is emission and whose alpha is opacity: a transparent
    pixel is empty, a black and opaque one is an occluder. ``associated``: the colours have been
    multiplied by alpha already. Raises InputError."""
    if alpha is None:
        raise InputError(
            f"{image.path!r}: expected a canvas with alpha (colour = emission, alpha = opacity), "
            "got an image without; save it as RGBA, with nothing drawn left transparent"
        )
    colour = np.asarray(image.values, np.float64)
    if colour.ndim == 2:
        colour = np.repeat(colour[..., None], 3, -1)
    if not associated:
        colour = colour * alpha[..., None].astype(np.float64)
    try:
        return canvas(colour, alpha)
    except InputError as error:
        raise InputError(f"{image.path!r}: {error}") from None


def read_canvas(path: str | os.PathLike[str], *, transfer: str = "none") -> Canvas:
    """The canvas in an image with alpha, or in a scene of shapes (.toml, see
    ``godfit.flatland.drawing``). Alpha is associated in OpenEXR files, whose rule that is, and in
    no others. Raises InputError."""
    name = os.fsdecode(path)
    if name.endswith(".toml"):
        from godfit.flatland.drawing import read_drawing

        return read_drawing(name).drawn()
    image, alpha = read_layer(name, transfer=transfer)
    with open(name, "rb") as file:
        return from_image(image, alpha, associated=file.read(len(EXR_MAGIC)) == EXR_MAGIC)

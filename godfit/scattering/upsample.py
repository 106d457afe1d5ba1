"""A light pass at the pixels of its image, which may be larger.

A pass of the image's size is what it shows; a smaller one is clamped, as its texture of bytes is,
and read bilinearly.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from godfit.runtime.device import on_device
from godfit.scattering.radial.reference import bilinear

# A point by itself costs as much as so many pixels of a whole picture, and more.
POINT = 4
# Texels are padded to a multiple of this many, or of a quarter of the pixels.
LEAST = 1024


class Texels(NamedTuple):
    """What is read of a light pass smaller than its image, each texel once: columns and rows ``at``
    (m, 2), of which each pixel mixes ``corners`` (4, n) by ``share`` (4, n)."""

    at: Float[Array, "m 2"]
    corners: Int[Array, "4 n"]
    share: Float[Array, "4 n"]

    @staticmethod
    def of(pixels: np.ndarray, size: tuple[int, int], low: tuple[int, int]) -> Texels | None:
        """For row-major ``pixels`` (n,) of an image of ``size`` and a pass of size ``low``; None
        where the whole pass costs no more."""
        (height, width), (h, w) = size, low
        if POINT * len(pixels) >= height * width:
            return None
        x = (pixels % width + 0.5) * w / width - 0.5
        y = (pixels // width + 0.5) * h / height - 0.5
        i, j = np.floor(x), np.floor(y)
        columns = np.clip(i + np.array([[0], [1], [0], [1]]), 0, w - 1)
        rows = np.clip(j + np.array([[0], [0], [1], [1]]), 0, h - 1)
        each, corners = np.unique((rows * w + columns).astype(np.int64), return_inverse=True)
        # A number that few pictures share would have the program compiled for each of them.
        step = max(LEAST, len(pixels) // 4)
        most = -(-len(each) // step) * step
        if POINT * most >= h * w:
            return None
        each = np.append(each, np.full(most - len(each), each[-1]))
        fx, fy = x - i, y - j
        share = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy])
        return Texels(
            on_device(np.stack([each % w, each // w], -1), np.float32),
            on_device(corners.reshape(columns.shape), np.int32),
            on_device(share, np.float32),
        )


def at_pixels(
    light_pass: Callable[..., Float[Array, "..."]],
    mask: Float[Array, "h w"] | Float[Array, "h w c"],
    size: tuple[int, int] | None,
    pixels: Int[Array, " n"] | None,
    texels: Texels | None = None,
) -> Float[Array, "..."]:
    """``light_pass(mask, at)`` at ``pixels`` of an image of ``size``; see ``Mitchell.__call__``."""
    low = (mask.shape[0], mask.shape[1])
    if size is not None and size != low:
        if texels is not None:
            read = jnp.clip(light_pass(mask, texels.at.astype(mask.dtype)), 0, 1)[texels.corners]
            return jnp.einsum("kn,kn...->n...", texels.share.astype(mask.dtype), read)
        return _upsampled(light_pass, mask, size, pixels)
    if pixels is None or POINT * pixels.shape[0] >= low[0] * low[1]:
        light = light_pass(mask, None)
        return light if pixels is None else light.reshape(-1, *light.shape[2:])[pixels]
    return light_pass(mask, columns_rows(pixels, low[1], mask.dtype))


def _upsampled(light_pass, mask, size, pixels):
    """Bilinear read of the light pass rendered at the mask's own size."""
    (h, w), (height, width) = mask.shape[:2], size
    shape = size if pixels is None else pixels.shape
    every = jnp.arange(height * width) if pixels is None else pixels
    at = columns_rows(every, width, mask.dtype)
    x, y = (at[:, 0] + 0.5) * w / width - 0.5, (at[:, 1] + 0.5) * h / height - 0.5
    low = jnp.clip(light_pass(mask, None), 0, 1)
    read = functools.partial(bilinear, x=x, y=y)
    out = read(low) if low.ndim == 2 else jax.vmap(read, -1, -1)(low)
    return out.reshape(*shape, *mask.shape[2:])


def columns_rows(pixels, width, dtype):
    """Row-major indices (n,) -> (n, 2) columns and rows."""
    return jnp.stack([pixels % width, pixels // width], -1).astype(dtype)

"""A light pass at the pixels of its image, which may be larger than the pass.

A pass of the image's size is used as it is. A smaller one is clamped to [0, 1], as the texture of
bytes that holds it is, and interpolated bilinearly; so is one that is larger by so little that its
picture must have been resized.

A pass of the image's size may read a mask of another size: its taps then lie between the mask's
texels, and the mask is interpolated.
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

POINT_COST = 4
"""Pixels of a whole picture whose sums cost as much as one at a point by itself, or less."""
MIN_PADDED_TEXELS = 1024
"""Texels are padded to a multiple of this number, or of a quarter of the pixels if that is more:
few different lengths mean that few programs are compiled."""


NEARLY = 1.02
"""Ratio of sides up to which a larger mask is a light pass whose picture was resized. No shader is
known whose own pass is smaller than its mask by so little."""


class Texels(NamedTuple):
    """The texels, each once, between which some pixels interpolate a light pass smaller than their
    image: columns and rows ``at`` (m, 2). Each pixel mixes those of the indices ``corners`` (4, n)
    with the bilinear weights ``share`` (4, n)."""

    at: Float[Array, "m 2"]
    corners: Int[Array, "4 n"]
    share: Float[Array, "4 n"]

    @staticmethod
    def of(pixels: np.ndarray, size: tuple[int, int], low: tuple[int, int]) -> Texels | None:
        """For row-major ``pixels`` (n,) of an image of ``size`` (h, w) and a pass of size ``low``;
        None where the whole pass costs no more."""
        (height, width), (h, w) = size, low
        if POINT_COST * len(pixels) >= height * width:
            return None
        x = (pixels % width + 0.5) * w / width - 0.5
        y = (pixels // width + 0.5) * h / height - 0.5
        i, j = np.floor(x), np.floor(y)
        columns = np.clip(i + np.array([[0], [1], [0], [1]]), 0, w - 1)
        rows = np.clip(j + np.array([[0], [0], [1], [1]]), 0, h - 1)
        texels, corners = np.unique((rows * w + columns).astype(np.int64), return_inverse=True)
        step = max(MIN_PADDED_TEXELS, len(pixels) // 4)
        padded = -(-len(texels) // step) * step
        if POINT_COST * padded >= h * w:
            return None
        texels = np.append(texels, np.full(padded - len(texels), texels[-1]))
        fx, fy = x - i, y - j
        share = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy])
        return Texels(
            on_device(np.stack([texels % w, texels // w], -1), np.float32),
            on_device(corners.reshape(columns.shape), np.int32),
            on_device(share, np.float32),
        )


def at_pixels(
    light_pass: Callable[..., Float[Array, "..."]],
    mask: Float[Array, "h w"] | Float[Array, "h w c"],
    size: tuple[int, int] | None,
    pixels: Int[Array, " n"] | None,
    texels: Texels | None = None,
    full_size: bool = False,
) -> Float[Array, "..."]:
    """The light pass at ``pixels`` of an image.

    **Arguments:**

    - `light_pass`: (mask, at) -> values at columns and rows `at` (n, 2) of the mask, or at every
      pixel where it is None.
    - `mask`: (h, w) or (h, w, channels), of the size of the light pass, or larger than the image
      (`is_larger`), whose size the light pass then has.
    - `size`: (height, width) of the image; None if it is that of the mask.
    - `pixels`: row-major indices (n,) into the image; None for all of them.
    - `texels`: ``Texels.of`` these pixels, if only their texels are to be computed.
    - `full_size`: whether the light pass has the size of the image where the mask is smaller.

    **Returns:** (height, width) or (n,), then channels.
    """
    low = (mask.shape[0], mask.shape[1])
    if size is not None and size != low and (full_size or is_larger(low, size)):
        shape = size if pixels is None else pixels.shape
        chosen = jnp.arange(size[0] * size[1]) if pixels is None else pixels
        light = light_pass(mask, _between(chosen, size, low, mask.dtype))
        return light.reshape(*shape, *mask.shape[2:])
    if size is not None and size != low:
        if texels is not None:
            values = jnp.clip(light_pass(mask, texels.at.astype(mask.dtype)), 0, 1)
            corners = values[texels.corners]
            return jnp.einsum("kn,kn...->n...", texels.share.astype(mask.dtype), corners)
        return _upsampled(light_pass, mask, size, pixels)
    if pixels is None or POINT_COST * pixels.shape[0] >= low[0] * low[1]:
        light = light_pass(mask, None)
        return light if pixels is None else light.reshape(-1, *light.shape[2:])[pixels]
    return light_pass(mask, columns_rows(pixels, low[1], mask.dtype))


def _upsampled(light_pass, mask, size, pixels):
    """The light pass of the mask's size, interpolated bilinearly at ``pixels`` of an image."""
    (h, w), (height, width) = mask.shape[:2], size
    shape = size if pixels is None else pixels.shape
    chosen = jnp.arange(height * width) if pixels is None else pixels
    x, y = _between(chosen, size, (h, w), mask.dtype).T
    clamped = jnp.clip(light_pass(mask, None), 0, 1)
    at_points = functools.partial(bilinear, x=x, y=y)
    out = at_points(clamped) if clamped.ndim == 2 else jax.vmap(at_points, -1, -1)(clamped)
    return out.reshape(*shape, *mask.shape[2:])


def is_larger(mask: tuple[int, ...], size: tuple[int, int]) -> bool:
    """Whether a ``mask`` (h, w) has more texels than an image of ``size`` has pixels, by so many
    that the image was not made smaller with its light pass."""
    return mask[0] > NEARLY * size[0] or mask[1] > NEARLY * size[1]


def _between(pixels, size, low, dtype):
    """(n, 2) columns and rows, in an image of size ``low``, of the centres of ``pixels`` of one of
    ``size``, (height, width) each."""
    at = columns_rows(pixels, size[1], dtype)
    ratio = jnp.asarray([low[1] / size[1], low[0] / size[0]], dtype)
    return (at + 0.5) * ratio[None] - 0.5


def columns_rows(pixels, width, dtype):
    """Row-major indices (n,) -> (n, 2) columns and rows."""
    return jnp.stack([pixels % width, pixels // width], -1).astype(dtype)

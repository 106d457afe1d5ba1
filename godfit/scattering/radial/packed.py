"""Packed: exact for 8-bit masks, on every device, plain XLA.

The four neighbours that a bilinear read mixes are stored as the four bytes of one 32-bit word, so
that a tap needs one read and not four. Texture units fetch such quads at once ("gather4").

Cost: taps x points x 1 read. Error: rounding where the mask's values are k/255. Any other mask is
rounded to these (up to half a level for each unit of the taps' total), without a warning, because
values are unknown inside ``jit``. Derivatives by the mask are those of the unrounded mask.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from godfit.io.image import LEVELS
from godfit.scattering.radial.derivatives import RayParameters, geometric_sum
from godfit.scattering.radial.pairs import gathered_sums, pair_sums
from godfit.scattering.taps import Taps


def packed_sums(
    mask: Float[Array, "h w"],
    ray: RayParameters,
    count: int,
    at: Float[Array, "2 points"] | None,
    slopes: bool,
) -> Float[Array, "sums points"]:
    """See ``godfit.scattering.radial.derivatives.Sums``."""
    levels = jnp.round(LEVELS * jnp.clip(mask, 0, 1)).astype(jnp.uint32)
    a = jnp.pad(levels, ((1, 1), (1, 2)), mode="edge")
    row = a[:, :-1] | a[:, 1:] << 8
    words = (row[:-1] | row[1:] << 16).ravel()

    def read(index):
        word = words.at[index].get(mode="promise_in_bounds")
        # Processors convert signed integers to floats fast, and unsigned ones slowly.
        quad = [(word >> n & 255).astype(jnp.int32).astype(mask.dtype) for n in (0, 8, 16, 24)]
        return lax.complex(quad[0], quad[1]), lax.complex(quad[2], quad[3])

    return gathered_sums(read, mask, ray, count, at, slopes) / LEVELS


def packed(
    mask: Float[Array, "h w"],
    light: Float[Array, "2"],
    taps: Taps,
    at: Float[Array, "*points 2"] | None,
) -> Float[Array, "*points"]:
    """See ``godfit.scattering.radial.radial_sum``; serves taps whose unit is the ray."""
    return geometric_sum(packed_sums, mask, light, taps, at, linear=pair_sums)

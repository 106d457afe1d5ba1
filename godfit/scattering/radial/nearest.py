"""The mask along rays, from the nearest texels: coarse, and fast enough for every light of a grid."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from godfit.runtime.program_cache import cached_jit
from godfit.scattering.radial.coordinates import to_pixels

STEPS = 48
DENSITIES = (0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 1.0)


@cached_jit
def read_rays(
    mask: Float[Array, "h w"], light: Float[Array, "lights 2"], at: Float[Array, "points 2"]
) -> Float[Array, "lights steps points"]:
    """Mask along the ray from every point to every light, at the middles of STEPS equal steps, from
    the nearest texels: good enough for ``mask`` of twice the resolution that ``at`` is in."""
    h, w = mask.shape
    x, y = 2 * at[:, 0] + 0.5, 2 * at[:, 1] + 0.5
    t = (jnp.arange(STEPS, dtype=mask.dtype)[:, None] + 0.5) / STEPS
    flat = mask.ravel()

    def one(light):
        light_x, light_y = to_pixels(light, h, w)
        column = jnp.clip(jnp.round(x[None] + t * (light_x - x)[None]), 0, w - 1)
        row = jnp.clip(jnp.round(y[None] + t * (light_y - y)[None]), 0, h - 1)
        return flat.at[(row * w + column).astype(jnp.int32)].get(mode="promise_in_bounds")

    return jax.vmap(one)(light)

"""The mask along rays, from the nearest texels: fast enough for every light of a screening grid."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from godfit.runtime.program_cache import cached_jit
from godfit.scattering.radial.coordinates import to_pixels

RAY_STEPS = 48
"""Steps of a ray from the pixel to the light: each is a few texels of a mask of 128 pixels."""
GRID_DENSITIES = (0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 1.0)
"""Densities of a screening grid, closest together where the defaults of most shaders lie."""


@cached_jit
def read_rays(
    mask: Float[Array, "h w"],
    light: Float[Array, "lights 2"],
    at: Float[Array, "points 2"],
    steps: int = RAY_STEPS,
) -> Float[Array, "lights steps points"]:
    """The mask along the ray from every point to every light, at the middles of its ``steps``. The
    first RAY_STEPS end at the light, further ones lie beyond.

    ``light`` is in texture coordinates (u, v). ``at`` is in pixels of a picture of half the mask's
    resolution, because the nearest texel of a mask of twice the resolution is accurate enough.
    """
    h, w = mask.shape
    x, y = 2 * at[:, 0] + 0.5, 2 * at[:, 1] + 0.5
    t = (jnp.arange(steps, dtype=mask.dtype)[:, None] + 0.5) / RAY_STEPS
    texels = mask.ravel()

    def to_light(light):
        light_x, light_y = to_pixels(light, h, w)
        column = jnp.clip(jnp.round(x[None] + t * (light_x - x)[None]), 0, w - 1)
        row = jnp.clip(jnp.round(y[None] + t * (light_y - y)[None]), 0, h - 1)
        return texels.at[(row * w + column).astype(jnp.int32)].get(mode="promise_in_bounds")

    return jax.vmap(to_light)(light)

"""The published shaders' output, defects and all, for comparison (jason.today/gi, 2024).

It differs from ``godfit.flatland.rays`` in these ways, each of which has a test that names it:

- the distance march's rays leave at 2 pi / R + i + noise: a radian apart, not a R-th of the circle;
- the sun's smoothstep has its edges reversed, which GLSL leaves undefined and drivers compute as
  they stand: the light jumps from none to all at the sun's own angle and falls off to one side
  only;
- the texel (0, 0) means "no seed" in the flood, so that an empty canvas has a distance to a corner;
- distances are in texture coordinates, longer along the shorter side of the picture;
- a ray has arrived where the distance is below .001, which is under a pixel: beside a wall it
  creeps through its steps, and where they do not suffice it takes the sky's light from behind the
  wall;
- noise is one number for every pixel, the same for all its rays and every frame;
- a pixel hides light where its opacity is above one half, all or nothing.

Every choice is a threshold: nothing here has a true derivative, and ``godfit.flatland.render``
refuses it.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from godfit.flatland.canvas import Canvas
from godfit.flatland.sky import Sky

PUBLISHED_EPSILON = 1e-3
"""Texture coordinates: a ray has arrived where the distance is below this, as in the article."""

HIDING_OPACITY = 0.5
"""A pixel hides light where its opacity is above this, as in the article."""

PUBLISHED_STEPS = 32
"""Steps of a ray of the distance march, as in the article."""


def noise(size: tuple[int, int], dtype) -> Float[Array, "h w"]:
    """The sine hash of texture coordinates that shaders use for a random number from 0 to 1."""
    u, v = _texture_coordinates(size, dtype)
    return (jnp.sin(u * 12.9898 + v * 78.233) * 43758.5453) % 1.0


def sun_and_sky(sky: Sky, angle: Float[Array, "*n"]) -> Float[Array, "*n 3"]:
    """Radiance towards ``angle`` (radians): smoothstep(width, 0, (angle - sun) modulo 2 pi)."""
    past_sun = (angle - jnp.deg2rad(sky.angle)) % (2 * math.pi)
    width = jnp.deg2rad(sky.width)
    t = jnp.clip((past_sun - width) / (0 - width), 0, 1)
    plain, sun = (jnp.expand_dims(c, tuple(range(angle.ndim))) for c in (sky.sky, sky.sun))
    return plain + (t * t * (3 - 2 * t))[..., None] * sun


def distances(filled: Bool[Array, "h w"]) -> Float[Array, "h w"]:
    """The published distance field, in texture coordinates, by one round of jump flooding."""
    h, w = filled.shape
    u, v = _texture_coordinates((h, w), jnp.zeros(()).dtype)
    seeds = jnp.where(filled[..., None], jnp.stack([u, v], -1), 0.0)
    passes = max(1, math.ceil(math.log2(max(h, w, 2))))
    for i in range(passes):
        offset = 2 ** (passes - i - 1)
        padded = jnp.pad(seeds, ((offset, offset), (offset, offset), (0, 0)))
        best, nearest = jnp.full((h, w), jnp.inf), jnp.zeros_like(seeds)
        for y in (0, offset, 2 * offset):
            for x in (0, offset, 2 * offset):
                other = padded[y : y + h, x : x + w]
                far = (other[..., 0] - u) ** 2 + (other[..., 1] - v) ** 2
                better = (other != 0).any(-1) & (far < best)
                nearest = jnp.where(better[..., None], other, nearest)
                best = jnp.where(better, far, best)
        seeds = nearest
    return jnp.hypot(seeds[..., 0] - u, seeds[..., 1] - v)


def published(
    canvas: Canvas, sky: Sky, rays: int = 32, steps: int | None = None, method: str = "distance"
) -> Float[Array, "h w 3"]:
    """The published picture, (h, w, 3).

    ``distance`` takes ``steps`` (32) along the distance field; ``march`` takes them pixel by pixel,
    by default as many as lead to the border. A ray that meets nothing gathers sun and sky.
    """
    h, w = canvas.size
    dtype = canvas.opacity.dtype
    filled = canvas.opacity > HIDING_OPACITY
    colour = jnp.where(filled[..., None], canvas.radiance, 0)
    u, v = _texture_coordinates((h, w), dtype)
    random = noise((h, w), dtype)
    march = method == "march"
    field = None if march else distances(filled).astype(dtype)
    steps = steps or (math.ceil(math.hypot(h, w)) if march else PUBLISHED_STEPS)

    def texel(s, t):
        """Row and column at texture coordinates, and whether they lie in the picture."""
        column, row = jnp.floor(s * w).astype(int), h - 1 - jnp.floor(t * h).astype(int)
        inside = (s >= 0) & (s < 1) & (t >= 0) & (t < 1)
        return jnp.clip(row, 0, h - 1), jnp.clip(column, 0, w - 1), inside

    def ray(total, i):
        if march:
            angle = 2 * math.pi / rays * (i + random)
            along, up = jnp.cos(angle) / w, jnp.sin(angle) / h
        else:
            angle = 2 * math.pi / rays + (i + random)
            along, up = jnp.cos(angle), jnp.sin(angle)

        def advance(state, _):
            s, t, going, hit, light = state
            row, column, inside = texel(s, t)
            if march:
                met, far = filled[row, column], jnp.ones((), dtype)
            else:
                assert field is not None
                far = field[row, column]
                met = far < PUBLISHED_EPSILON
            met = met & going & inside
            light = light + jnp.where(met[..., None], colour[row, column], 0)
            going, hit = going & ~met & inside, hit | met
            return (s + far * along, t + far * up, going, hit, light), None

        # A ray of the march starts beside its pixel, one of the distance march in it.
        start = (u + along, v + up) if march else (u, v)
        state = *start, jnp.ones((h, w), bool), jnp.zeros((h, w), bool), jnp.zeros((h, w, 3), dtype)
        (*_, hit, light), _ = jax.lax.scan(advance, state, None, steps)
        return total + light + jnp.where(hit[..., None], 0, sun_and_sky(sky, angle)), None

    total, _ = jax.lax.scan(ray, jnp.zeros((h, w, 3), dtype), jnp.arange(rays))
    return jnp.where(filled[..., None], colour, total / rays)


def _texture_coordinates(size, dtype):
    """(u, v) of the pixels' middles, v up."""
    h, w = size
    u = jnp.broadcast_to((jnp.arange(w, dtype=dtype)[None] + 0.5) / w, (h, w))
    v = jnp.broadcast_to(1 - (jnp.arange(h, dtype=dtype)[:, None] + 0.5) / h, (h, w))
    return u, v

"""The published shaders' output, defects and all, for comparison (jason.today/gi, 2024).

What differs from ``godfit.flatland.rays``, each of it shown by a test that names it:

- the distance march's rays leave at 2 pi / R + i + noise: a radian apart, not a R-th of the circle;
- the sun's smoothstep has its edges reversed, which GLSL leaves undefined and drivers compute as
  they stand: the light jumps from none to all at the sun's own angle and falls off to one side
  only;
- the place (0, 0) means "no seed" in the flood, so that an empty canvas has a distance to a corner;
- distances are in texture coordinates, longer along the shorter side of the picture;
- a ray has arrived where the distance is below .001, which is under a pixel: beside a wall it
  creeps through its steps, and where they do not suffice it sees the sky through the wall;
- noise is one number for every pixel, the same for all its rays and every frame;
- what hides is what has an opacity above one half, all or nothing.

Every choice is a threshold: nothing here has a true derivative, and one that is asked for is
refused.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from godfit.flatland.canvas import Canvas
from godfit.flatland.sky import Sky

EPSILON = 1e-3
HIDES = 0.5
STEPS = 32


def noise(size: tuple[int, int], dtype) -> Float[Array, "h w"]:
    """The sine hash of texture coordinates that shaders use for a random number from 0 to 1."""
    u, v = _places(size, dtype)
    return (jnp.sin(u * 12.9898 + v * 78.233) * 43758.5453) % 1.0


def sun_and_sky(sky: Sky, angle: Float[Array, "*n"]) -> Float[Array, "*n 3"]:
    """Radiance towards ``angle`` (radians): smoothstep(width, 0, (angle - sun) modulo 2 pi)."""
    away = (angle - jnp.deg2rad(sky.angle)) % (2 * math.pi)
    width = jnp.deg2rad(sky.width)
    t = jnp.clip((away - width) / (0 - width), 0, 1)
    plain, sun = (jnp.expand_dims(c, tuple(range(angle.ndim))) for c in (sky.sky, sky.sun))
    return plain + (t * t * (3 - 2 * t))[..., None] * sun


def distances(filled: Bool[Array, "h w"]) -> Float[Array, "h w"]:
    """The published distance field, in texture coordinates."""
    h, w = filled.shape
    u, v = _places((h, w), jnp.zeros(()).dtype)
    seeds = jnp.where(filled[..., None], jnp.stack([u, v], -1), 0.0)
    passes = max(1, math.ceil(math.log2(max(h, w, 2))))
    for i in range(passes):
        offset = 2 ** (passes - i - 1)
        known = jnp.pad(seeds, ((offset, offset), (offset, offset), (0, 0)))
        best, nearest = jnp.full((h, w), jnp.inf), jnp.zeros_like(seeds)
        for y in (0, offset, 2 * offset):
            for x in (0, offset, 2 * offset):
                other = known[y : y + h, x : x + w]
                far = (other[..., 0] - u) ** 2 + (other[..., 1] - v) ** 2
                better = (other != 0).any(-1) & (far < best)
                nearest = jnp.where(better[..., None], other, nearest)
                best = jnp.where(better, far, best)
        seeds = nearest
    return jnp.hypot(seeds[..., 0] - u, seeds[..., 1] - v)


def published(
    canvas: Canvas, sky: Sky, rays: int = 32, steps: int | None = None, method: str = "distance"
) -> Float[Array, "h w 3"]:
    """The published picture. ``distance`` takes ``steps`` (32) along the distance field, ``march``
    so many pixel by pixel, by default to the border; a ray that sees nothing sees sun and sky."""
    h, w = canvas.size
    dtype = canvas.opacity.dtype
    filled = canvas.opacity > HIDES
    colour = jnp.where(filled[..., None], canvas.radiance, 0)
    u, v = _places((h, w), dtype)
    random = noise((h, w), dtype)
    march = method == "march"
    field = None if march else distances(filled).astype(dtype)
    steps = steps or (math.ceil(math.hypot(h, w)) if march else STEPS)

    def read(s, t):
        """Row and column of a place, and whether it is one."""
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
            s, t, open_, hit, seen = state
            row, column, inside = read(s, t)
            if march:
                met, far = filled[row, column], jnp.ones((), dtype)
            else:
                assert field is not None
                far = field[row, column]
                met = far < EPSILON
            met = met & open_ & inside
            seen = seen + jnp.where(met[..., None], colour[row, column], 0)
            open_, hit = open_ & ~met & inside, hit | met
            return (s + far * along, t + far * up, open_, hit, seen), None

        # A ray of the march starts beside its pixel, one of the distance march in it.
        start = (u + along, v + up) if march else (u, v)
        state = *start, jnp.ones((h, w), bool), jnp.zeros((h, w), bool), jnp.zeros((h, w, 3), dtype)
        (*_, hit, seen), _ = jax.lax.scan(advance, state, None, steps)
        return total + seen + jnp.where(hit[..., None], 0, sun_and_sky(sky, angle)), None

    total, _ = jax.lax.scan(ray, jnp.zeros((h, w, 3), dtype), jnp.arange(rays))
    return jnp.where(filled[..., None], colour, total / rays)


def _places(size, dtype):
    """Texture coordinates (u, v) of the pixels' middles, v up."""
    h, w = size
    u = jnp.broadcast_to((jnp.arange(w, dtype=dtype)[None] + 0.5) / w, (h, w))
    v = jnp.broadcast_to(1 - (jnp.arange(h, dtype=dtype)[:, None] + 0.5) / h, (h, w))
    return u, v

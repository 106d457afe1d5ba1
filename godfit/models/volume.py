"""Single scattering marched through a scene with shadows: what the other models are judged by.

Of the light that travels along a view ray, L = int_0^D beta(theta) E(s) V(s) F(s) ds, where V says
whether the source is seen from there (the single-scattering integral: Pharr, Jakob & Humphreys,
Physically Based Rendering, 2016, section 15.3). The source is the sun (parallel light, reddened by
the atmosphere) or a lamp, a point of intensity ``e_sun`` whose light falls off with the square of
its distance r and is attenuated on its way by exp(-beta_ex r).

The ray is cut into steps, even for the sun, even in the angle seen from the lamp for a lamp, which
takes up its 1/r^2 (Kulla & Fajardo, Computer Graphics Forum 31 (2012), 1519). Where nothing is in
the way the sum over the sun's steps is exact. V comes from a shadow map, what the source sees drawn
by the project's own rasteriser; where it changes between two steps, the place is found by halving.
V has no derivative here: ``march`` is differentiable in the air alone.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.errors import InputError
from godfit.models.atmosphere import Air, by_channel, shortened, sunlight, zenith_angle
from godfit.scenes.scene import Scene
from godfit.scenes.shadow_maps import Shadows, Source, lit_shares, shadows

STEPS, RESOLUTION = 128, 2048
# Rays that are worked on together.
BLOCK = 1 << 16
# A lamp's rays pass it no nearer than this share of their length.
NEAREST = 1e-6


class Rays(eqx.Module):
    """View rays through a scene: direction (n, 3), length (n,), the share of every step that the
    source lights (steps, n), the direction to the sun and up (3,), or, for a lamp, where along the
    ray it is passed (n,) and how far off (n,). Lengths are the scene's."""

    direction: Float[Array, "n 3"]
    length: Float[Array, " n"]
    lit: Float[Array, "steps n"]
    sun: Float[Array, "3"]
    up: Float[Array, "3"]
    passed: Float[Array, " n"]
    apart: Float[Array, " n"]
    source: Source = eqx.field(static=True)


def view_rays(scene: Scene, pixels: np.ndarray) -> np.ndarray:
    """(n, 3) unit vectors in the world through the middles of row-major ``pixels``."""
    h, w = scene.size
    tall = np.tan(np.deg2rad(float(scene.camera.fov_y)) / 2)
    x = (2 * (pixels % w + 0.5) / w - 1) * tall * w / h
    y = (1 - 2 * (pixels // w + 0.5) / h) * tall
    local = np.stack([x, y, -np.ones_like(x)], -1)
    local /= np.linalg.norm(local, axis=-1, keepdims=True)
    return local @ np.asarray(scene.camera_axes(), np.float64)


def trace(
    scene: Scene,
    direction: np.ndarray,
    length: np.ndarray,
    shadow: Shadows,
    source: Source = "sun",
    steps: int = STEPS,
) -> Rays:
    """Rays (n, 3) from the camera, ``length`` (n,) long, and where the source lights them."""
    origin = np.asarray(scene.camera.position, np.float64)
    towards = np.asarray(scene.light.position, np.float64) - origin
    passed = direction @ towards
    apart = np.linalg.norm(towards - passed[:, None] * direction, axis=1)
    apart = np.maximum(apart, NEAREST * np.maximum(length, 1e-12))
    begin, end = np.zeros_like(length), length
    if source == "lamp":
        begin, end = np.arctan2(-passed, apart), np.arctan2(length - passed, apart)
    lit = lit_shares(origin, direction, begin, end, passed, apart, shadow, source, steps)
    dtype = scene.light.position.dtype
    sun = towards / np.linalg.norm(towards)
    return Rays(
        jnp.asarray(direction, dtype),
        jnp.asarray(length, dtype),
        jnp.asarray(lit, dtype),
        jnp.asarray(sun, dtype),
        jnp.asarray((0.0, 1.0, 0.0), dtype),
        jnp.asarray(passed, dtype),
        jnp.asarray(apart, dtype),
        source,
    )


def march(air: Air, rays: Rays) -> Float[Array, "n 3"]:
    """Light scattered into every ray; differentiable in ``air``."""
    return _march_lamp(air, rays) if rays.source == "lamp" else _march_sun(air, rays)


def _march_sun(air: Air, rays: Rays):
    step = rays.length / rays.lit.shape[0]
    depth = by_channel(air.beta_ex, step)
    left = jnp.exp(-depth)

    def farther(total, lit):
        # From the far end: what lies beyond is seen through one step more.
        return lit[:, None] + left * total, None

    total, _ = jax.lax.scan(farther, jnp.zeros_like(left), rays.lit, reverse=True)
    cos = rays.direction @ rays.sun
    sun = air.e_sun * sunlight(air.turbidity, zenith_angle(rays.sun, rays.up))
    path = step[:, None] * shortened(depth) * total
    return by_channel(sun, jnp.ones_like(cos)) * air.scattered(cos) * path


def _march_lamp(air: Air, rays: Rays):
    steps = rays.lit.shape[0]
    begin = jnp.arctan2(-rays.passed, rays.apart)
    width = (jnp.arctan2(rays.length - rays.passed, rays.apart) - begin) / steps

    def farther(total, step):
        k, lit = step
        angle = begin + (k + 0.5) * width
        s, r = rays.passed + rays.apart * jnp.tan(angle), rays.apart / jnp.cos(angle)
        # The lamp is ahead while the angle is negative.
        scattered = air.scattered(-jnp.sin(angle))
        return total + lit[:, None] * scattered * air.transmitted(s + r), None

    numbers = jnp.arange(steps, dtype=rays.length.dtype)
    zero = jnp.zeros((*rays.length.shape, 3), rays.length.dtype)
    total, _ = jax.lax.scan(farther, zero, (numbers, rays.lit))
    return air.e_sun * (width / rays.apart)[:, None] * total


def render(
    scene: Scene,
    air: Air,
    distance: np.ndarray,
    *,
    source: str = "sun",
    steps: int = STEPS,
    resolution: int = RESOLUTION,
    background: np.ndarray | None = None,
) -> np.ndarray:
    """(h, w, 3) radiance of a scene in air, linear, not clamped.

    **Arguments:**

    - `scene`: its objects cast the shadows; its light is the lamp, or shows where the sun stands.
    - `distance`: (h, w) to what is seen, along the rays; see `godfit.request.view_of`.
    - `steps`, `resolution`: of a ray, and of the shadow map's side.
    - `background`: (h, w) or (h, w, 3) what would be seen without air.

    Raises InputError for numbers that make no sense. Time grows with pixels x steps.
    """
    kind: Source
    if source == "sun":
        kind = "sun"
    elif source == "lamp":
        kind = "lamp"
    else:
        raise InputError(f"source: expected sun or lamp, got '{source}'")
    for name, value, most in (("steps", steps, 1 << 16), ("resolution", resolution, 1 << 14)):
        if not 1 <= value <= most:
            raise InputError(f"{name}: expected a whole number from 1 to {most}, got {value}")
    h, w = scene.size
    shadow = shadows(scene, kind, resolution)
    flat = np.asarray(distance, np.float64).reshape(-1)
    image = np.empty((h * w, 3), np.float32)
    for begin in range(0, h * w, BLOCK):
        pixels = np.arange(begin, min(begin + BLOCK, h * w))
        rays = trace(scene, view_rays(scene, pixels), flat[pixels], shadow, kind, steps)
        image[pixels] = _light(air, rays)
        if background is not None:
            left = np.asarray(air.transmitted(jnp.asarray(flat[pixels], jnp.float32)))
            image[pixels] += background.reshape(h * w, -1)[pixels] * left
    return image.reshape(h, w, 3)


@eqx.filter_jit
def _light(air: Air, rays: Rays):
    return march(air, rays)

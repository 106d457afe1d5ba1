"""Ray marching of single scattering through a scene with shadows: the reference for other models.

The radiance of a view ray is L = int_0^D beta(theta) E(s) V(s) F(s) ds, where V(s) is 1 where the
source is visible and 0 in shadow (the single-scattering integral: Pharr, Jakob & Humphreys,
Physically Based Rendering, 2016, section 15.3). The source is the sun (parallel light, reddened by
the atmosphere) or a lamp, a point of intensity ``e_sun``. A lamp's light falls off with the square
of its distance r and is attenuated on its way by exp(-beta_ex r).

The ray is cut into steps: of even length for the sun, of even angle at the lamp for a lamp, which
cancels its 1/r^2 (Kulla & Fajardo, Computer Graphics Forum 31 (2012), 1519). Without shadows the
sum over the sun's steps is exact. V comes from a shadow map (``shadow_maps.py``), and bisection
finds the places between two steps where it changes. V has no derivative here: ``march`` is
differentiable in the air alone.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.errors import InputError
from godfit.models.atmosphere import Air, by_channel, path_transmission, sunlight, zenith_angle
from godfit.scenes.scene import Scene
from godfit.scenes.shadow_maps import ShadowMap, Source, SteppedRays, lit_shares, shadow_map

MARCH_STEPS = 128
"""Steps of a ray, by default."""
MAX_MARCH_STEPS = 1 << 16
"""Largest number of steps: the time grows with it."""
SHADOW_RESOLUTION = 2048
"""Pixels along a side of the shadow map, by default."""
MAX_SHADOW_RESOLUTION = 1 << 14
"""Largest side of a shadow map: the six faces of a lamp's then take 13 GB."""
RAY_BLOCK = 1 << 16
"""Rays that are marched together: their lit shares take 34 MB at the default number of steps."""
MIN_LAMP_DISTANCE = 1e-6
"""Least distance at which a ray passes a lamp, as a share of the ray's length: at the lamp itself
the integral has no value."""
MIN_RAY_LENGTH = 1e-12
"""Least length of a ray in that share."""


class Rays(eqx.Module):
    """View rays through a scene: direction (n, 3), length (n,), and the share of every step that
    the source lights (steps, n). For the sun, ``sun`` and ``up`` (3,) are directions; for a lamp,
    the ray passes it ``passed`` (n,) along the ray at the distance ``apart`` (n,). Lengths are in
    the scene's unit."""

    direction: Float[Array, "n 3"]
    length: Float[Array, " n"]
    lit: Float[Array, "steps n"]
    sun: Float[Array, "3"]
    up: Float[Array, "3"]
    passed: Float[Array, " n"]
    apart: Float[Array, " n"]
    source: Source = eqx.field(static=True)


def view_rays(scene: Scene, pixels: np.ndarray) -> np.ndarray:
    """(n, 3) unit vectors in the world, from the camera through the middles of row-major
    ``pixels``."""
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
    shadow: ShadowMap,
    source: Source = "sun",
    steps: int = MARCH_STEPS,
) -> Rays:
    """Rays from the camera along ``direction`` (n, 3), ``length`` (n,) long, and the share of each
    of their ``steps`` that the source lights."""
    origin = np.asarray(scene.camera.position, np.float64)
    towards = np.asarray(scene.light.position, np.float64) - origin
    passed = direction @ towards
    apart = np.linalg.norm(towards - passed[:, None] * direction, axis=1)
    apart = np.maximum(apart, MIN_LAMP_DISTANCE * np.maximum(length, MIN_RAY_LENGTH))
    begin, end = np.zeros_like(length), length
    if source == "lamp":
        begin, end = np.arctan2(-passed, apart), np.arctan2(length - passed, apart)
    rays = SteppedRays(origin, direction, begin, end, passed, apart)
    lit = lit_shares(rays, shadow, source, steps)
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
    """Radiance scattered into every ray; differentiable in ``air``."""
    return _march_lamp(air, rays) if rays.source == "lamp" else _march_sun(air, rays)


def _march_sun(air: Air, rays: Rays):
    step = rays.length / rays.lit.shape[0]
    depth = by_channel(air.beta_ex, step)
    transmission = jnp.exp(-depth)

    def add_step(total, lit):
        # From the far end: light from beyond passes one step more.
        return lit[:, None] + transmission * total, None

    total, _ = jax.lax.scan(add_step, jnp.zeros_like(transmission), rays.lit, reverse=True)
    cos = rays.direction @ rays.sun
    sun = air.e_sun * sunlight(air.turbidity, zenith_angle(rays.sun, rays.up))
    path = step[:, None] * path_transmission(depth) * total
    return by_channel(sun, jnp.ones_like(cos)) * air.scattered(cos) * path


def _march_lamp(air: Air, rays: Rays):
    steps = rays.lit.shape[0]
    begin = jnp.arctan2(-rays.passed, rays.apart)
    width = (jnp.arctan2(rays.length - rays.passed, rays.apart) - begin) / steps

    def add_step(total, step):
        k, lit = step
        angle = begin + (k + 0.5) * width
        s, r = rays.passed + rays.apart * jnp.tan(angle), rays.apart / jnp.cos(angle)
        # The lamp is ahead while the angle is negative.
        scattered = air.scattered(-jnp.sin(angle))
        return total + lit[:, None] * scattered * air.transmitted(s + r), None

    numbers = jnp.arange(steps, dtype=rays.length.dtype)
    zero = jnp.zeros((*rays.length.shape, 3), rays.length.dtype)
    total, _ = jax.lax.scan(add_step, zero, (numbers, rays.lit))
    return air.e_sun * (width / rays.apart)[:, None] * total


def render(
    scene: Scene,
    air: Air,
    distance: np.ndarray,
    *,
    source: str = "sun",
    steps: int = MARCH_STEPS,
    resolution: int = SHADOW_RESOLUTION,
    background: np.ndarray | None = None,
) -> np.ndarray:
    """(h, w, 3) radiance of a scene in air, linear, not clamped.

    **Arguments:**

    - `scene`: its objects cast the shadows; its light is the lamp, or marks the sun's direction.
    - `distance`: (h, w) to the surfaces, along the rays; see `godfit.models.build.view_of_scene`.
    - `source`: `"sun"` or `"lamp"`.
    - `steps`: number of steps of a ray. The time grows with pixels x steps.
    - `resolution`: pixels along a side of the shadow map.
    - `background`: (h, w) or (h, w, 3), the picture without air; by default black.

    Raises InputError for another source, and for numbers out of range.
    """
    kind: Source
    if source == "sun":
        kind = "sun"
    elif source == "lamp":
        kind = "lamp"
    else:
        raise InputError(f"source: expected sun or lamp, got '{source}'")
    for name, value, most in (
        ("steps", steps, MAX_MARCH_STEPS),
        ("resolution", resolution, MAX_SHADOW_RESOLUTION),
    ):
        if not 1 <= value <= most:
            raise InputError(f"{name}: expected a whole number from 1 to {most}, got {value}")
    h, w = scene.size
    shadow = shadow_map(scene, kind, resolution)
    flat = np.asarray(distance, np.float64).reshape(-1)
    image = np.empty((h * w, 3), np.float32)
    for begin in range(0, h * w, RAY_BLOCK):
        pixels = np.arange(begin, min(begin + RAY_BLOCK, h * w))
        rays = trace(scene, view_rays(scene, pixels), flat[pixels], shadow, kind, steps)
        image[pixels] = _marched(air, rays)
        if background is not None:
            transmission = np.asarray(air.transmitted(jnp.asarray(flat[pixels], jnp.float32)))
            image[pixels] += background.reshape(h * w, -1)[pixels] * transmission
    return image.reshape(h, w, 3)


@eqx.filter_jit
def _marched(air: Air, rays: Rays):
    return march(air, rays)

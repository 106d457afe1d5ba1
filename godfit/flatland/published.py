"""The two shaders of "Building Real-Time Global Illumination" (jason.today/gi, 2024), as published.

``NaiveMarch`` is the article's first shader and ``GlobalIllumination`` its last, by the names
``naive`` and ``gi``. Both have defects that ``godfit.flatland.render`` has not. Those of the naive
march:

- its rays leave at 2 pi / R + i + noise, a radian apart and uneven;
- it has no sky: light spreads ``steps`` pixels and no farther.

Those of the gi pass, whose rays are even:

- the sun's smoothstep has its edges reversed, which GLSL leaves undefined and drivers compute as
  they stand: the light jumps from none to all at the sun's own angle, and fades clockwise alone;
- the texel (0, 0) means "no seed" in the flood, so that an empty canvas has a distance to a corner;
- distances are in texture coordinates, longer along the shorter side of the picture, and at most 1;
- a semi-transparent pixel is a seed at its texture coordinates times its alpha, which is elsewhere;
- a ray arrives where the distance is below .001. On canvases of less than 1,000 pixels that is
  under a pixel: beside a wall a ray creeps through its steps, and where they end the sky shines
  through the wall;
- grain widens the angle between the rays by a share of the circle, so that some of them coincide.

Defects of both: a pixel has one noise for all its rays; a pixel hides all light or none; a texel
counts with its colour as the file stores it, not multiplied by its alpha.

The noise is a hash of sines, here in float64. In float32 it is another noise, half of whose values
are .03 or more away, and no two GPUs agree on it. Nothing here has a derivative: every choice is a
threshold.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jax.core import Tracer
from jaxtyping import Float

from godfit.errors import InputError
from godfit.flatland.canvas import Canvas
from godfit.flatland.published_kernel import GiRays, flood_pass, gi_rows, naive_rows
from godfit.flatland.rendering import MAX_RAYS_OR_STEPS
from godfit.flatland.sky import SKY_RADIANCE, SUN_RADIANCE, check_sky
from godfit.runtime.parallel import parallel_map

HASH_DIRECTION = (12.9898, 78.233)
"""The hash of sines multiplies (u, v) by these."""

HASH_SCALE = 43758.5453
"""The hash of sines is the fraction of this many sines."""

NO_NOISE_OFFSET = 0.1
"""Radians: the naive march's offset of the rays where there is no noise."""

PUBLISHED_SUN_ANGLE = math.degrees(-4.2) % 360
"""Degrees, counterclockwise from the right: the source's sunAngle of 4.2 radians, which it counts
clockwise because its v runs down there."""

PUBLISHED_SUN_WIDTH = math.degrees(1.0)
"""Degrees: the source's sun fades over one radian, clockwise."""

BAND_ROWS = 8
"""Rows of a picture that one thread computes at a time."""


@dataclass(frozen=True)
class NaiveMarch:
    """The article's first shader: ``rays`` a pixel, each tested at ``steps`` texels a pixel apart,
    from the pixel itself on.

    Without ``noise`` all pixels have the same rays. Without ``accumulate_radiance`` only the last
    of the steps is tested. Raises InputError.
    """

    rays: int = 8
    steps: int = 128
    noise: bool = True
    accumulate_radiance: bool = True

    def __post_init__(self) -> None:
        _check_counts(self)


@dataclass(frozen=True)
class GlobalIllumination:
    """The article's last shader: ``rays`` a pixel through a distance field, under a sun and a sky.

    ``steps`` is the source's maxSteps, one more than a ray's advances. ``grain`` is the source's
    angular noise, which needs ``noise``. ``time`` is added to the coordinates that are hashed.
    ``passes`` ends the flood early, at 0 before it begins; None is all of them.
    ``sun_angle`` is in degrees, counterclockwise from the right, and ``sun_width`` in degrees
    clockwise from there; ``sun`` and ``sky`` (3,) are radiances. Raises InputError.
    """

    rays: int = 32
    steps: int = 32
    noise: bool = True
    grain: bool = True
    enable_sun: bool = True
    sun_angle: float = PUBLISHED_SUN_ANGLE
    sun_width: float = PUBLISHED_SUN_WIDTH
    sun: tuple[float, ...] = SUN_RADIANCE
    sky: tuple[float, ...] = SKY_RADIANCE
    time: float = 0.0
    passes: int | None = None

    def __post_init__(self) -> None:
        _check_counts(self)
        check_sky(self.sun_angle, self.sun_width, self.sun, self.sky)
        if not math.isfinite(self.time):
            raise InputError(f"time: expected a finite number, got {self.time:g}")


PUBLISHED = {"naive": NaiveMarch, "gi": GlobalIllumination}
"""The published shaders by name, with the source's settings."""


def render_published(
    canvas: Canvas, shader: NaiveMarch | GlobalIllumination
) -> Float[np.ndarray, "h w 3"]:
    """The picture that a published shader makes of a canvas: float64, not clamped.

    Raises InputError for more passes than the flood has, and ValueError inside ``jax.jit`` and
    ``jax.grad``.
    """
    if isinstance(canvas.opacity, Tracer) or isinstance(canvas.radiance, Tracer):
        raise ValueError(
            "flatland: 'published' has no derivative and is not compiled by JAX; use render with "
            "method 'distance' or 'march'"
        )
    scene = _texels(canvas)
    if isinstance(shader, NaiveMarch):
        return _naive(scene, shader)
    return _gi(scene, shader)


def hash_noise(size: tuple[int, int], time: float = 0.0) -> Float[np.ndarray, "h w"]:
    """The hash of sines of every pixel's texture coordinates plus ``time``, from 0 to 1."""
    u, v = _texture_coordinates(size)
    a, b = HASH_DIRECTION
    scaled = np.sin((u + time) * a + (v + time) * b) * HASH_SCALE
    return scaled - np.floor(scaled)


def flood_passes(size: tuple[int, ...]) -> int:
    """Passes of the flood of a canvas of ``size`` (h, w)."""
    return math.ceil(math.log2(max(size)))


def distance_texture(
    alpha: Float[np.ndarray, "h w"], passes: int | None = None
) -> Float[np.ndarray, "h w"]:
    """The published distance field, in texture coordinates, after ``passes`` of the flood (all of
    them if None). After 0 passes every pixel is a seed. Raises InputError."""
    most = flood_passes(alpha.shape)
    passes = most if passes is None else passes
    if not 0 <= passes <= most:
        h, w = alpha.shape
        raise InputError(
            f"passes: expected a whole number from 0 to {most} on a canvas of {w}x{h}, got {passes}"
        )
    u, v = _texture_coordinates(alpha.shape)
    weight = np.ones(alpha.shape) if passes == 0 else alpha
    seeds = np.stack([u * weight, v * weight], -1)
    for i in range(passes):
        seeds = flood_pass(seeds, 2 ** (most - i - 1))
    return np.minimum(np.sqrt((seeds[..., 0] - u) ** 2 + (seeds[..., 1] - v) ** 2), 1.0)


def _naive(scene: np.ndarray, shader: NaiveMarch) -> np.ndarray:
    size = scene.shape[:2]
    noise = hash_noise(size) if shader.noise else np.full(size, NO_NOISE_OFFSET)
    first_step = 0 if shader.accumulate_radiance else max(0, shader.steps - 1)
    rows = functools.partial(naive_rows, scene, noise, first_step, shader.steps, shader.rays)
    return _by_bands(rows, size[0])


def _gi(scene: np.ndarray, shader: GlobalIllumination) -> np.ndarray:
    size = scene.shape[:2]
    noise = hash_noise(size, shader.time) if shader.noise else np.zeros(size)
    distance = distance_texture(scene[..., 3], shader.passes)
    march = GiRays(
        shader.rays, shader.steps, shader.grain,
        -math.radians(shader.sun_angle), math.radians(shader.sun_width),
    )  # fmt: skip
    around = np.array([shader.sun, shader.sky]) * float(shader.enable_sun)
    return _by_bands(functools.partial(gi_rows, scene, distance, noise, march, around), size[0])


def _by_bands(rows: Any, height: int) -> np.ndarray:
    """The rows of a picture, some at a time, on all cores."""
    bands = [(i, min(i + BAND_ROWS, height)) for i in range(0, height, BAND_ROWS)]
    return np.concatenate(parallel_map(rows, bands))


def _texels(canvas: Canvas) -> np.ndarray:
    """(h, w, 4), float64: the canvas as its file stores it, colour not multiplied by alpha."""
    alpha = np.asarray(canvas.opacity, np.float64)[..., None]
    colour = np.asarray(canvas.radiance, np.float64) / np.where(alpha > 0, alpha, 1.0)
    return np.concatenate([colour, alpha], -1)


def _texture_coordinates(size: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """(u, v), each (h, w), of the pixels' middles."""
    h, w = size
    u = np.broadcast_to((np.arange(w) + 0.5) / w, (h, w))
    v = np.broadcast_to((h - np.arange(h)[:, None] - 0.5) / h, (h, w))
    return u, v


def _check_counts(shader: NaiveMarch | GlobalIllumination) -> None:
    for name, least in (("rays", 1), ("steps", 0)):
        value = getattr(shader, name)
        if not least <= value <= MAX_RAYS_OR_STEPS:
            raise InputError(
                f"{name}: expected a whole number from {least} to {MAX_RAYS_OR_STEPS}, got {value}"
            )

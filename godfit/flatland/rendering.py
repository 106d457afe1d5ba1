"""The picture of a canvas under a sky, by any of the methods."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from godfit.errors import InputError
from godfit.flatland.canvas import Canvas
from godfit.flatland.cascades import cascades
from godfit.flatland.rays import TraceSettings, gathered, steps_to_cross
from godfit.flatland.sky import Sky

METHODS = ("distance", "march", "cascades")
"""Ways to gather a pixel's light."""

RENDER_RAYS = 32
"""Rays of a pixel by default, the article's."""

JITTER_BINS = 64
"""Directions that a jittered ray takes one of, in its part of the circle: at 32 rays they are .18
degrees apart, less than a pixel at a distance of 300 pixels."""

MAX_RAYS_OR_STEPS = 1 << 16
"""Rays of a pixel, or steps of a ray: far more than any picture needs, and with JITTER_BINS still
within an int32."""

MARCH_STEPS_PER_PIXEL = 2
"""Steps of a march for each pixel of the canvas's diagonal, by default: longer ones leap over
corners of pixels."""

FILM_GRAIN_STREAM = 1
"""Makes the random numbers of the film grain differ from those of the jitter of the same seed."""

PUBLISHED_ELSEWHERE = (
    "expected a call of render_published(canvas, NaiveMarch()) or "
    "render_published(canvas, GlobalIllumination())"
)
"""What replaces the argument ``published``."""


@dataclass(frozen=True)
class RenderOptions:
    """How the light is gathered and noise laid on, see ``render``. Raises InputError for settings
    that mean nothing."""

    rays: int = RENDER_RAYS
    method: str = "distance"
    steps: int | None = None
    jitter: bool = False
    film_grain: float = 0.0
    seed: int | Int[Array, ""] = 0
    plain: bool | None = None

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise InputError(f"method: expected one of {', '.join(METHODS)}, got '{self.method}'")
        for name, value in (("rays", self.rays), ("steps", self.steps)):
            if value is not None and not 1 <= value <= MAX_RAYS_OR_STEPS:
                raise InputError(
                    f"{name}: expected a whole number from 1 to {MAX_RAYS_OR_STEPS}, got {value}"
                )
        check_film_grain(self.film_grain)
        if self.method == "cascades" and self.steps is not None:
            raise InputError(
                "steps: expected none with the method cascades, got some; leave them out"
            )
        if self.method == "cascades" and self.jitter:
            raise InputError(
                "jitter: expected none with the method cascades, got some; leave it out"
            )


def render(
    canvas: Canvas,
    sky: Sky | None = None,
    *,
    rays: int = RENDER_RAYS,
    method: str = "distance",
    steps: int | None = None,
    jitter: bool = False,
    film_grain: float = 0.0,
    seed: int | Int[Array, ""] = 0,
    exposure: float | Float[Array, ""] = 1.0,
    published: Any = None,
    plain: bool | None = None,
) -> Float[Array, "h w 3"]:
    """The light in the plane: every pixel has its own radiance and, as far as it is not opaque, the
    mean radiance that reaches it from all around.

    **Arguments:**

    - `canvas`: all that emits and hides light; there is nothing outside it.
    - `sky`: the radiance that comes from beyond the canvas's border; None is darkness.
    - `rays`: for each pixel, evenly around the circle; of cascades, around a probe of the first.
    - `method`: `"distance"` (see `godfit.flatland.rays`; exact but for the number of rays),
      `"march"` (fixed steps) or `"cascades"` (see `godfit.flatland.cascades`).
    - `steps`: of a march, how many the canvas's diagonal has, by default two a pixel; of the
      distance march, after how many a ray ends without the sky's light, by default enough for any.
    - `jitter`: rays go anywhere in their part of the circle, each pixel's by an angle of its own:
      bands become noise. `seed` chooses; a mean over seeds has more rays.
    - `film_grain`: standard deviation of noise laid on the picture, after the exposure.
    - `exposure`: a factor of the whole picture.
    - `published`: nothing; see `render_published`, which has the article's shaders.
    - `plain`: XLA's own loops in place of compiled ones, by default wherever JAX does not run on a
      CPU.

    **Returns:** (h, w, 3), linear, not clamped. By `"distance"` and `"march"` it is differentiable,
    forward and reverse, in the canvas's radiance and opacity (and so in the shapes of
    `godfit.flatland.drawing`), the sky's four numbers and the exposure. The others have no
    derivative: a ValueError. Raises InputError for settings that mean nothing, and for
    `"cascades"`, compiled for CPUs, where JAX runs elsewhere.
    """
    if published is not None:
        raise InputError(f"published: {PUBLISHED_ELSEWHERE}, got {published!r}")
    options = RenderOptions(rays, method, steps, jitter, film_grain, seed, plain)
    sky = Sky.none() if sky is None else sky
    if method == "cascades":
        reached = _by_cascades(canvas, sky, rays)
    else:
        reached = _by_rays(canvas, sky, options)
    light = canvas.radiance + (1 - canvas.opacity)[..., None] * reached
    return exposure * light + film_grain_of(light, film_grain, seed)


def _by_cascades(canvas: Canvas, sky: Sky, rays: int) -> Float[Array, "h w 3"]:
    """The mean radiance that reaches every pixel, by cascades."""
    if jax.default_backend() != "cpu":
        raise InputError(
            "method: expected 'distance' or 'march' where JAX does not run on a CPU, got "
            "'cascades'; set JAX_PLATFORMS=cpu"
        )
    return _without_derivative("cascades", functools.partial(cascades, rays=rays), canvas, sky)


def _by_rays(canvas: Canvas, sky: Sky, options: RenderOptions) -> Float[Array, "h w 3"]:
    """The mean radiance that reaches every pixel, by a march or the distance march."""
    jitter_bin, jitter_bins = None, 1
    if options.jitter:
        key = jax.random.key(options.seed)
        jitter_bin = jax.random.randint(key, canvas.size, 0, JITTER_BINS, jnp.int32)
        jitter_bins = JITTER_BINS
    plain = jax.default_backend() != "cpu" if options.plain is None else options.plain
    settings = _trace_settings(canvas, options)

    def reach(canvas, sky):
        directions = options.rays * jitter_bins
        return gathered(canvas, sky.over(directions), settings, jitter_bin, plain)

    if options.method == "distance" and settings.max_steps < steps_to_cross(*canvas.size):
        # Whether a ray ends too early depends on all positions, and no derivative includes it.
        return _without_derivative("distance with few steps", reach, canvas, sky)
    return reach(canvas, sky)


def _trace_settings(canvas: Canvas, options: RenderOptions) -> TraceSettings:
    diagonal = math.hypot(*canvas.size)
    if options.method == "march":
        length = diagonal / (options.steps or math.ceil(MARCH_STEPS_PER_PIXEL * diagonal))
        # The last step may end a little short.
        return TraceSettings(options.rays, math.ceil(diagonal / length) + 2, length)
    return TraceSettings(options.rays, options.steps or steps_to_cross(*canvas.size))


def film_grain_of(light, sigma: float, seed):
    """Noise of standard deviation ``sigma`` for a picture ``light``."""
    if sigma == 0:
        return jnp.zeros((), light.dtype)
    key = jax.random.fold_in(jax.random.key(seed), FILM_GRAIN_STREAM)
    return sigma * jax.random.normal(key, light.shape, light.dtype)


def check_film_grain(sigma: float) -> None:
    """Raise InputError for a standard deviation that is none."""
    if not 0 <= sigma < math.inf:
        raise InputError(f"film grain: expected a finite number of 0 or more, got {sigma:g}")


def _without_derivative(name: str, make: Any, canvas: Canvas, sky: Sky):
    """``make(canvas, sky)``, refusing to be differentiated where JAX would make it zero."""

    @jax.custom_jvp
    def made(canvas, sky):
        return make(canvas, sky)

    def refuse(primals, tangents):
        raise ValueError(
            f"flatland: '{name}' has no derivative; use method 'distance' or 'march', and with "
            "the distance march no steps"
        )

    made.defjvp(refuse)
    return made(canvas, sky)

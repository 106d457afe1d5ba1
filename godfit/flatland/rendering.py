"""A canvas and a sky -> the picture, by any of the methods."""

from __future__ import annotations

import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from godfit.errors import InputError
from godfit.flatland import published as as_published
from godfit.flatland.canvas import Canvas
from godfit.flatland.cascades import cascades
from godfit.flatland.rays import enough, gathered
from godfit.flatland.sky import Sky

METHODS = ("distance", "march", "cascades")
RAYS = 32
# Where in its part of the circle a jittered ray may go.
KINDS = 64
LARGEST_RAYS = 1 << 16
# Of a march: steps for each pixel of the way.
FINE = 2


def render(
    canvas: Canvas,
    sky: Sky | None = None,
    *,
    rays: int = RAYS,
    method: str = "distance",
    steps: int | None = None,
    jitter: bool = False,
    grain: float = 0.0,
    seed: int | Int[Array, ""] = 0,
    exposure: float | Float[Array, ""] = 1.0,
    published: bool = False,
    plain: bool | None = None,
) -> Float[Array, "h w 3"]:
    """The light in the plane: every pixel shows what it sends out and, as far as it is not opaque,
    the mean radiance that reaches it from all around.

    **Arguments:**

    - `canvas`: what emits and what hides; nothing outside it does.
    - `sky`: what is seen past the canvas's border; None is darkness.
    - `rays`: for each pixel, evenly around the circle; of cascades, around a probe of the first.
    - `method`: `"distance"` (see `godfit.flatland.rays`; exact but for the number of rays),
      `"march"` (fixed steps) or `"cascades"` (see `godfit.flatland.cascades`).
    - `steps`: of a march, how many the canvas's diagonal has, by default two a pixel; of the
      distance march, after how many a ray gives up and sees nothing, by default enough for any.
    - `jitter`: rays go anywhere in their part of the circle, each pixel's by an angle of its own:
      bands become noise. `seed` chooses; a mean over seeds has more rays.
    - `grain`: standard deviation of noise laid on the picture, after the exposure.
    - `exposure`: what everything is multiplied by.
    - `published`: as the article's shaders have it, see `godfit.flatland.published`; `jitter` is
      then always there, and the same in every frame.
    - `plain`: XLA's own loops in place of compiled ones, by default wherever JAX does not run on a
      CPU.

    **Returns:** (h, w, 3), linear, not clamped; differentiable, forward and reverse, in the
    canvas's radiance and opacity (and so in the shapes of `godfit.flatland.drawing`), the sky's
    four and the exposure, by `"distance"` and `"march"`. The others have no derivative, and say so:
    a ValueError. Raises InputError for settings that mean nothing, and for `"cascades"`, compiled
    for CPUs, where JAX runs elsewhere.
    """
    check_settings(rays, method, steps, grain, published)
    sky = Sky.none() if sky is None else sky
    h, w = canvas.size
    if published:
        make = functools.partial(as_published.published, rays=rays, steps=steps, method=method)
        light = _without_derivative("published", make, canvas, sky)
        return exposure * light + _grain(light, grain, seed)
    if method == "cascades":
        if jax.default_backend() != "cpu":
            raise InputError(
                "method: expected 'distance' or 'march' where JAX does not run on a CPU, got "
                "'cascades'; set JAX_PLATFORMS=cpu"
            )
        reached = _without_derivative(
            "cascades", functools.partial(cascades, rays=rays), canvas, sky
        )
    else:
        turn, kinds = None, 1
        if jitter:
            turn = jax.random.randint(jax.random.key(seed), (h, w), 0, KINDS, jnp.int32)
            kinds = KINDS
        step = 0.0
        if method == "march":
            many = steps or math.ceil(FINE * math.hypot(h, w))
            step = math.hypot(h, w) / many
        plain = jax.default_backend() != "cpu" if plain is None else plain
        most = enough(h, w)
        if method == "march":
            # The last step may end a little short.
            most = math.ceil(math.hypot(h, w) / step) + 2
        elif steps is not None:
            most = steps

        def reach(canvas, sky):
            return gathered(canvas, sky.over(rays * kinds), rays, most, step, turn, plain)

        if method == "distance" and most < enough(h, w):
            # Whether a ray gives up hangs on where everything is, and no derivative shows it.
            reached = _without_derivative("distance with few steps", reach, canvas, sky)
        else:
            reached = reach(canvas, sky)
    light = canvas.radiance + (1 - canvas.opacity)[..., None] * reached
    return exposure * light + _grain(light, grain, seed)


def check_settings(
    rays: int, method: str, steps: int | None, grain: float, published: bool
) -> None:
    """Raise InputError for settings that mean nothing."""
    if method not in METHODS:
        raise InputError(f"method: expected one of {', '.join(METHODS)}, got '{method}'")
    for name, value in (("rays", rays), ("steps", steps)):
        if value is not None and not 1 <= value <= LARGEST_RAYS:
            raise InputError(
                f"{name}: expected a whole number from 1 to {LARGEST_RAYS}, got {value}"
            )
    if not 0 <= grain < math.inf:
        raise InputError(f"grain: expected a finite number of 0 or more, got {grain:g}")
    if method == "cascades" and steps is not None:
        raise InputError("steps: expected none with the method cascades, got some; leave them out")
    if method == "cascades" and published:
        raise InputError("published: expected the method distance or march, got 'cascades'")


def _grain(light, grain: float, seed):
    if grain == 0:
        return jnp.zeros((), light.dtype)
    # Apart from the jitter of the same seed.
    key = jax.random.fold_in(jax.random.key(seed), 1)
    return grain * jax.random.normal(key, light.shape, light.dtype)


def _without_derivative(name: str, make: Any, canvas: Canvas, sky: Sky):
    """``make(canvas, sky)``, refusing to be differentiated where JAX would make it zero."""

    @jax.custom_jvp
    def made(canvas, sky):
        return make(canvas, sky)

    def refuse(primals, tangents):
        raise ValueError(
            f"flatland: '{name}' has no derivative; use method 'distance' or 'march', without "
            "published and, of the distance march, without steps"
        )

    made.defjvp(refuse)
    return made(canvas, sky)

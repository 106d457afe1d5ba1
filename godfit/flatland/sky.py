"""Sun and sky: the radiance that reaches the canvas from outside, by direction."""

from __future__ import annotations

import functools
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from godfit.errors import InputError

SKY_RADIANCE = (0.02, 0.08, 0.2)
"""Red, green, blue: the article's sky."""

SUN_RADIANCE = (0.95, 0.95, 0.9)
"""Red, green, blue: the article's sun."""

SUN_ANGLE = 120.0
"""Degrees, counterclockwise from the right: godfit's own default, a sun high on the left."""

SUN_WIDTH = 60.0
"""Degrees to either side: godfit's own default, wide enough that few rays resolve it."""

MAX_SUN_WIDTH = 180.0
"""Degrees to either side: all of the circle."""


class Sky(eqx.Module):
    """A sun in a plain sky.

    ``angle`` () is where the sun stands and ``width`` () how far its light reaches to either side,
    in degrees, counterclockwise from the right; ``sun`` and ``sky`` (3,) are radiances. Towards
    theta the radiance is sky + sun f(|theta - angle| / width), f(u) = 1 - 3 u^2 + 2 u^3 up to u = 1
    and 0 beyond: smooth, symmetric, of mean width / 360 over the circle. All four are
    differentiable.
    """

    angle: Float[Array, ""]
    width: Float[Array, ""]
    sun: Float[Array, "3"]
    sky: Float[Array, "3"]

    def __init__(
        self,
        angle: Any = SUN_ANGLE,
        width: Any = SUN_WIDTH,
        sun: Any = SUN_RADIANCE,
        sky: Any = SKY_RADIANCE,
    ):
        self.angle, self.width = jnp.asarray(angle, float), jnp.asarray(width, float)
        self.sun, self.sky = jnp.asarray(sun, float), jnp.asarray(sky, float)

    @staticmethod
    def none() -> Sky:
        """Darkness all around."""
        return Sky(sun=(0.0, 0.0, 0.0), sky=(0.0, 0.0, 0.0))

    def towards(self, angles: Float[Array, "*n"]) -> Float[Array, "*n 3"]:
        """Radiance in directions given in degrees."""
        off = jnp.abs((angles - self.angle + 180) % 360 - 180)
        u = jnp.minimum(off / self.width, 1)
        sun = jnp.expand_dims(self.sun, tuple(range(angles.ndim)))
        sky = jnp.expand_dims(self.sky, tuple(range(angles.ndim)))
        return sky + (1 - u * u * (3 - 2 * u))[..., None] * sun

    @functools.partial(jax.jit, static_argnums=1)
    def over(self, bins: int) -> Float[Array, "bins 3"]:
        """Mean radiance over each of ``bins`` equal parts of the circle, the first from 0 to
        360 / bins degrees. The means are exact: a sun narrower than a part is not missed, and moves
        smoothly from one part to the next."""
        half = 180 / bins
        middle = (2 * jnp.arange(bins, dtype=self.angle.dtype) + 1) * half
        off = (middle - self.angle + 180) % 360 - 180
        # A part may reach round the far side of the circle.
        turns = jnp.array([[-360.0], [0.0], [360.0]], off.dtype)
        away = off[None] + turns
        share = _integral((away + half) / self.width) - _integral((away - half) / self.width)
        return self.sky[None] + (share.sum(0) * self.width / (2 * half))[:, None] * self.sun[None]


def _integral(u):
    """The integral from 0 to u of f in ``Sky``."""
    a = jnp.minimum(jnp.abs(u), 1)
    return jnp.sign(u) * a * (1 - a**2 + a**3 / 2)


def check_sky(angle: float, width: float, sun, sky) -> None:
    """Raise InputError for numbers that make no sky: angle and width in degrees, radiances (3,)."""
    if not math.isfinite(angle):
        raise InputError(f"sun angle: expected a finite number of degrees, got {angle:g}")
    if not 0 < width <= MAX_SUN_WIDTH:
        raise InputError(
            f"sun width: expected degrees above 0, at most {MAX_SUN_WIDTH:g}, got {width:g}; "
            "for no sun give it a colour of 0,0,0"
        )
    for name, colour in (("sun colour", sun), ("sky colour", sky)):
        if len(colour) != 3 or not all(math.isfinite(c) and c >= 0 for c in colour):
            raise InputError(
                f"{name}: expected three finite numbers of 0 or more, got "
                f"{','.join(f'{c:g}' for c in colour)}"
            )

"""Sun and sky: what a ray that leaves the canvas sees."""

from __future__ import annotations

import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from godfit.errors import InputError

# The published colours.
SKY, SUN = (0.02, 0.08, 0.2), (0.95, 0.95, 0.9)
ANGLE, WIDTH = 120.0, 60.0


class Sky(eqx.Module):
    """A sun in a plain sky.

    ``angle`` () is where the sun stands and ``width`` () how far its light reaches to either side,
    in degrees, counterclockwise from the right; ``sun`` and ``sky`` (3,) are radiances. Towards
    theta there is sky + sun f(|theta - angle| / width), f(u) = 1 - 3 u^2 + 2 u^3 up to u = 1 and 0
    beyond: smooth, symmetric, of mean width / 360 over the circle. All four are differentiable.
    """

    angle: Float[Array, ""]
    width: Float[Array, ""]
    sun: Float[Array, "3"]
    sky: Float[Array, "3"]

    def __init__(self, angle: Any = ANGLE, width: Any = WIDTH, sun: Any = SUN, sky: Any = SKY):
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
        one = jnp.expand_dims(self.sun, tuple(range(angles.ndim)))
        plain = jnp.expand_dims(self.sky, tuple(range(angles.ndim)))
        return plain + (1 - u * u * (3 - 2 * u))[..., None] * one

    def over(self, bins: int) -> Float[Array, "bins 3"]:
        """Means over the ``bins`` equal parts of the circle, the first from 0 to 360 / bins
        degrees, exact: a sun narrower than a part is not missed, and moves smoothly from one to the
        next."""
        half = 180 / bins
        middle = (2 * jnp.arange(bins, dtype=self.angle.dtype) + 1) * half
        off = (middle - self.angle + 180) % 360 - 180
        # A part may reach round the far side of the circle.
        turns = jnp.array([[-360.0], [0.0], [360.0]], off.dtype)
        away = off[None] + turns
        share = _integral((away + half) / self.width) - _integral((away - half) / self.width)
        return self.sky[None] + (share.sum(0) * self.width / (2 * half))[:, None] * self.sun[None]


def _integral(u):
    """Of f from 0 to u."""
    a = jnp.minimum(jnp.abs(u), 1)
    return jnp.sign(u) * a * (1 - a**2 + a**3 / 2)


def check_sky(angle: float, width: float, sun, sky) -> None:
    """Raise InputError for what is no sky."""
    if not math.isfinite(angle):
        raise InputError(f"sun angle: expected a finite number of degrees, got {angle:g}")
    if not 0 < width <= 180:
        raise InputError(
            f"sun width: expected degrees above 0, at most 180, got {width:g}; "
            "for no sun give it a colour of 0,0,0"
        )
    for name, colour in (("sun colour", sun), ("sky colour", sky)):
        if len(colour) != 3 or not all(math.isfinite(c) and c >= 0 for c in colour):
            raise InputError(
                f"{name}: expected three finite numbers of 0 or more, got "
                f"{','.join(f'{c:g}' for c in colour)}"
            )

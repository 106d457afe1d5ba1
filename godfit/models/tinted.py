"""Mitchell's sum with a coloured light: the light pass of each channel has its own scale."""

from __future__ import annotations

import math
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from godfit.models.base import Vector
from godfit.models.mitchell import Mitchell
from godfit.models.shaded import AbstractShaded
from godfit.runtime.device import on_device
from godfit.scattering.parameters import Parameter
from godfit.scattering.upsample import Texels, at_pixels

TINT_PARAMETERS = (
    Parameter("red", "r", "of green", 0.0, math.inf, "the light's red against its green"),
    Parameter("blue", "b", "of green", 0.0, math.inf, "the light's blue against its green"),
)
"""The parameters of a tint. Green is 1: its scale is the exposure."""


class Tinted(AbstractShaded):
    """``shading`` with ``tint`` (2,), red and blue of the light pass against green. Parameters and
    coordinates are those of ``shading``, then the tint."""

    name: ClassVar[str] = "mitchell-tinted"
    banded: ClassVar[bool] = False
    channels: ClassVar[int] = 3

    shading: Mitchell
    tint: Float[Array, "2"]

    def __init__(self, shading: Mitchell, tint=(1.0, 1.0)):
        self.shading, self.tint = shading, on_device(tint, float)

    @property
    def light(self) -> Float[Array, "lights 2"]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.shading.light

    @property
    def colour(self) -> Float[Array, "3"]:
        """The light's red, green and blue."""
        return jnp.stack([self.tint[0], jnp.ones_like(self.tint[0]), self.tint[1]])

    @property
    def parameters(self) -> dict[str, Parameter]:
        return self.shading.parameters | {p.name: p for p in TINT_PARAMETERS}

    @property
    def defaults(self) -> dict[str, float]:
        return self.shading.defaults | {"red": 1.0, "blue": 1.0}

    @property
    def used(self) -> np.ndarray:
        return np.append(self.shading.used, [True, True])

    def values(self) -> dict[str, Float[Array, ""]]:
        return self.shading.values() | {"red": self.tint[0], "blue": self.tint[1]}

    def coordinates(self) -> Float[Array, " p"]:
        return jnp.concatenate([self.shading.coordinates(), self.tint])

    def moved(self, coordinates: Vector, held: Vector | None = None) -> Tinted:
        if held is None:
            held = jnp.full_like(coordinates, jnp.nan)
        tint = jnp.where(jnp.isnan(held[-2:]), coordinates[-2:], held[-2:])
        shading = self.shading.moved(coordinates[:-2], held[:-2])
        return eqx.tree_at(lambda m: (m.shading, m.tint), self, (shading, tint))

    def bounds(self) -> tuple[list[float], list[float]]:
        lower, upper = self.shading.bounds()
        return lower + [0.0] * 2, upper + [math.inf] * 2

    def linear(self) -> np.ndarray:
        return np.append(self.shading.linear(), [False, False])

    def scales(self, coordinates: np.ndarray) -> np.ndarray:
        tint = np.abs(coordinates[-2:]) * np.float32(0.1) + np.float32(0.1)
        return np.append(self.shading.scales(coordinates[:-2]), tint).astype(np.float32)

    def ranges(self, coordinates: np.ndarray) -> np.ndarray:
        return np.append(self.shading.ranges(coordinates[:-2]), [1.0, 1.0])

    def __call__(
        self,
        mask: Float[Array, "h w"] | Float[Array, "h w c"],
        background: Float[Array, "..."] | None = None,
        *,
        size: tuple[int, int] | None = None,
        pixels: Int[Array, " n"] | None = None,
        texels: Texels | None = None,
    ) -> Float[Array, "..."]:
        """(H, W, 3) or (n, 3), linear, not clamped; see ``Mitchell.__call__``."""
        shading = self.shading
        light = at_pixels(shading.light_pass, mask, size, pixels, texels, shading.full_size)
        if mask.ndim == 2:
            light = light[..., None]
        light = light * self.colour.reshape((1,) * (light.ndim - 1) + (3,))
        return self.shading.composite(light, background, pixels)


class TintedMask(Tinted):
    """The same under a mask that is known, whose edges leave bands in the image."""

    banded: ClassVar[bool] = True

    def __init__(self, shading: Mitchell, tint=(1.0, 1.0)):
        super().__init__(shading, tint)

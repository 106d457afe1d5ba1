"""The daylight of Hoffman and Preetham behind occluders: L(s, theta, phi) = (1 - D) L(s, theta).

This is Mitchell's equation 3 (GPU Gems 3, ch. 13): the analytic radiance of a pixel, less the share
D that occluders on the way to the sun keep from it. Averaging taps estimate D from a mask. The
physics is in ``atmosphere.py``.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from godfit.io.arrays import as_light
from godfit.models.atmosphere import MIN_TURBIDITY, Air, hoffman_preetham, zenith_angle
from godfit.models.base import AbstractModel, Vector
from godfit.scattering.parameters import Parameter, light_parameters
from godfit.scattering.radial import radial_sum
from godfit.scattering.radial.exact import at_run_time
from godfit.scattering.taps import Count, Taps, averaging_taps
from godfit.scattering.upsample import Texels, at_pixels

AIR_PARAMETERS = (
    Parameter("e_sun", "E", "1", 0.0, math.inf, "the sun's irradiance above the air"),
    Parameter("scale", "a", "m per unit", 0.0, math.inf, "metres of air in a unit of distance"),
    Parameter("turbidity", "T", "1", MIN_TURBIDITY, 64.0, "haze: 1 none, 2 clear, 6 hazy"),
    Parameter("g", "g", "1", -0.99, 0.99, "mean cosine of the haze's scattering"),
)
"""The parameters of ``Air`` that a fit can free."""
MIN_OPTICAL_DEPTH = 1e-4
"""Least optical depth of the typical distance at the middle wavelength: a thinner air differs from
none by less than a level."""
TINY_OPTICAL_DEPTH = 1e-9
"""Least optical depth that a gain is divided by."""


class View(eqx.Module):
    """The geometry of a picture: the vertical field of view (degrees), the world's up in the
    camera's axes (right, up, back), and ``distance``, (h, w) or (), of the surfaces along the rays.

    ``distance`` may have another size than the picture, and is read at the nearest pixel. Optical
    depths are those of ``typical``, its median.
    """

    distance: Float[Array, "..."]
    typical: Float[Array, ""]
    fov_y: Float[Array, ""]
    up: Float[Array, "3"]

    def __init__(self, distance, fov_y=60.0, up=(0.0, 1.0, 0.0)):
        self.distance = jnp.asarray(distance, float)
        self.typical = jnp.asarray(np.median(np.asarray(distance)), float)
        self.fov_y, self.up = jnp.asarray(fov_y, float), jnp.asarray(up, float)

    def direction(self, u, v, aspect: float) -> Float[Array, "... 3"]:
        """Unit vectors towards texture coordinates, in the camera's axes; ``aspect`` is width over
        height."""
        tall = jnp.tan(jnp.deg2rad(self.fov_y) / 2)
        x, y = (2 * u - 1) * (aspect * tall), (2 * v - 1) * tall
        along = jnp.stack([x, y, -jnp.ones_like(x)], -1)
        return along / jnp.linalg.norm(along, axis=-1, keepdims=True)

    def rays(self, size: tuple[int, int], pixels: Int[Array, " n"]):
        """Distances (n,) and directions (n, 3) of the row-major ``pixels`` of a picture of
        ``size``."""
        h, w = size
        row, column = pixels // w, pixels % w
        distance = self.distance
        if distance.ndim == 2:
            tall, wide = distance.shape
            distance = distance[row * tall // h, column * wide // w]
        dtype = self.distance.dtype
        u, v = (column.astype(dtype) + 0.5) / w, 1 - (row.astype(dtype) + 0.5) / h
        return jnp.broadcast_to(distance, pixels.shape), self.direction(u, v, w / h)


class HoffmanPreetham(AbstractModel):
    """Daylight behind occluders. Parameters are those of ``Air`` and the sun's place in the
    picture, ``light`` (1, 2); ``samples`` is the number of averaging taps.

    The mask is 1 where the sky is open and 0 where an object occludes it. Fit coordinates, one for
    each parameter and in their order: gain = e_sun depth; depth, the optical depth of the typical
    distance at 570 nm; turbidity; g; the light. Thin air depends on the gain alone.
    """

    name: ClassVar[str] = "hoffman-preetham"
    held_last: ClassVar[str] = "e_sun"
    mask_is_sky: ClassVar[bool] = True
    product: ClassVar[tuple[str, str]] = ("scale", "e_sun")
    banded: ClassVar[bool] = False
    channels: ClassVar[int] = 3

    air: Air
    light: Float[Array, "1 2"]
    view: View
    samples: Count = 100

    def __init__(self, air: Air, light, view: View, samples: Count = 100):
        self.air, self.view, self.samples = air, view, at_run_time(samples)
        self.light = jnp.asarray(light, float).reshape(1, 2)

    @property
    def settings(self) -> dict[str, str | int | float]:
        return {
            "samples": self.samples,
            "phase": self.air.phase,
            "fov": float(self.view.fov_y),
            "distance": float(self.view.typical),
        }

    @property
    def parameters(self) -> dict[str, Parameter]:
        return {p.name: p for p in AIR_PARAMETERS + light_parameters(1)}

    @property
    def defaults(self) -> dict[str, float]:
        return {"turbidity": 2.0, "g": 0.76}

    def values(self) -> dict[str, Float[Array, ""]]:
        air = self.air
        numbers = (air.e_sun, air.scale, air.turbidity, air.g, *self.light[0])
        return dict(zip(self.parameters, numbers, strict=True))

    def coordinates(self) -> Float[Array, " p"]:
        air = self.air
        depth = air.beta_ex[1] * self.view.typical
        return jnp.stack([air.e_sun * depth, depth, air.turbidity, air.g, *self.light[0]])

    def moved(self, coordinates: Vector, held: Vector | None = None) -> HoffmanPreetham:
        if held is None:
            held = jnp.full_like(coordinates, jnp.nan)
        count = len(AIR_PARAMETERS)
        gain, depth, turbidity, g = coordinates[:count]
        held_sun, held_scale, held_turbidity, held_g = held[:count]
        turbidity = jnp.where(jnp.isnan(held_turbidity), turbidity, held_turbidity)
        g = jnp.where(jnp.isnan(held_g), g, held_g)
        # The optical depth at a scale of 1, in which it is linear.
        unit_depth = Air(turbidity, g, 1.0, 1.0, self.air.haze, self.air.phase).beta_ex[1]
        unit_depth = unit_depth * self.view.typical.astype(unit_depth.dtype)
        scale = jnp.where(jnp.isnan(held_scale), depth / unit_depth, held_scale)
        depth = scale * unit_depth
        divisor = jnp.where(jnp.abs(depth) > TINY_OPTICAL_DEPTH, depth, TINY_OPTICAL_DEPTH)
        e_sun = jnp.where(jnp.isnan(held_sun), gain / divisor, held_sun)
        light = jnp.where(jnp.isnan(held[count:]), coordinates[count:], held[count:])
        return eqx.tree_at(
            lambda m: (m.air.e_sun, m.air.scale, m.air.turbidity, m.air.g, m.light),
            self,
            (e_sun, scale, turbidity, g, light[None]),
        )

    def bounds(self) -> tuple[list[float], list[float]]:
        inf = math.inf
        haze = AIR_PARAMETERS[2:]
        lower = [0.0, MIN_OPTICAL_DEPTH, *(p.lower for p in haze), -inf, -inf]
        return lower, [inf, inf, *(p.upper for p in haze), inf, inf]

    def linear(self) -> np.ndarray:
        return np.arange(6) == 0

    def scales(self, coordinates: np.ndarray) -> np.ndarray:
        floor = np.array([1e-3, 0.01, 0.1, 0.1, 0.1, 0.1], np.float32)
        return np.abs(coordinates) * np.float32(0.1) + floor

    def ranges(self, coordinates: np.ndarray) -> np.ndarray:
        gain, depth, *_ = coordinates
        # In air as thin as none the scale is undetermined, and only the gain is known.
        return np.array([max(gain, 0.05), depth, 3.0, 0.5, 0.5, 0.5])

    @property
    def walk(self) -> Taps:
        return averaging_taps(self.samples)

    def openness(
        self,
        mask: Any,
        at: Float[Array, "*points 2"] | None = None,
        method: str = "auto",
    ) -> Float[Array, "..."]:
        """1 - D, the open share of the way to the sun; arguments as in ``Mitchell.light_pass``."""
        return radial_sum(mask, self.light[0], averaging_taps(self.samples), at=at, method=method)

    def __call__(
        self,
        mask: Any,
        background: Any = None,
        *,
        size: tuple[int, int] | None = None,
        pixels: Int[Array, " n"] | None = None,
        texels: Texels | None = None,
        method: str = "auto",
    ) -> Float[Array, "..."]:
        """(H, W, 3) or (n, 3), linear, not clamped; see ``Mitchell.__call__``. ``background`` is
        the picture without air, L_0; None is black."""
        mask = as_light(mask, "mask")
        background = None if background is None else as_light(background, "background")
        size = (mask.shape[0], mask.shape[1]) if size is None else size

        def unoccluded(mask, at):
            return self.openness(mask, at, method)

        lit = at_pixels(unoccluded, mask, size, pixels, texels)
        lit = lit.reshape(-1, mask.shape[2] if mask.ndim == 3 else 1)
        where = jnp.arange(size[0] * size[1]) if pixels is None else pixels
        distance, direction = self.view.rays(size, where)
        u, v = self.light[0]
        sun = self.view.direction(u, v, size[1] / size[0])
        zenith = zenith_angle(sun, self.view.up)
        surface = 0.0
        if background is not None:
            surface = background.reshape(size[0] * size[1], -1)[where]
        radiance = hoffman_preetham(self.air, distance, direction @ sun, zenith, surface)
        image = lit * radiance
        return image.reshape(*(size if pixels is None else pixels.shape), 3)

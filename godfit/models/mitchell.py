"""Models: parameters + mask -> image.

A model is a module whose fields are its parameters. ``godfit.fit`` never names one: it moves the
vector of ``coordinates`` and asks the model for the image.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy import optimize

from godfit.models.base import FAINTEST, AbstractModel, Vector
from godfit.runtime.device import on_device
from godfit.scattering.parameters import SCATTERING, Parameter, table
from godfit.scattering.radial import radial_sum
from godfit.scattering.radial.exact import at_run_time
from godfit.scattering.taps import Convention, Count, Taps, convention
from godfit.scattering.upsample import Texels, at_pixels


class Mitchell(AbstractModel):
    """Mitchell's screen-space scattering sum (GPU Gems 3, ch. 13) as one shader computes it.

    ``exposure``, ``decay``, ``density`` and ``weight`` are the shader's; ``light`` is (lights, 2)
    in texture coordinates. Several lights are a sum over lights. ``samples`` is an integer and is
    not differentiated.

    Fit coordinates (one for each parameter, in order): exposure; kappa = -samples ln(decay) /
    density, the attenuation for each unit of ray; density; gain = exposure weight samples /
    density; the lights. The image depends on samples almost only through kappa and gain.
    """

    name: ClassVar[str] = "mitchell"
    held_last: ClassVar[str] = "weight"
    product: ClassVar[tuple[str, str]] = ("exposure", "weight")
    banded: ClassVar[bool] = True
    channels: ClassVar[int] = 1

    exposure: Float[Array, ""]
    decay: Float[Array, ""]
    density: Float[Array, ""]
    weight: Float[Array, ""]
    light: Float[Array, "lights 2"]
    shader: str = eqx.field(static=True, default="mitchell")
    samples: Count = 100

    def __init__(self, exposure, decay, density, weight, light, shader="mitchell", samples=None):
        self.exposure, self.decay = on_device(exposure, float), on_device(decay, float)
        self.density, self.weight = on_device(density, float), on_device(weight, float)
        self.light = on_device(light, float).reshape(-1, 2)
        self.shader = convention(shader).name
        self.samples = at_run_time(convention(shader).samples if samples is None else samples)

    @property
    def convention(self) -> Convention:
        return convention(self.shader)

    @property
    def settings(self) -> dict[str, str | int | float]:
        return {"shader": self.shader, "samples": self.samples}

    @property
    def parameters(self) -> dict[str, Parameter]:
        return table(self.light.shape[0])

    @property
    def used(self) -> np.ndarray:
        absent = {row.name for row in SCATTERING} - {*self.convention.parameters}
        return ~np.isin(list(self.parameters), list(absent))

    @property
    def defaults(self) -> dict[str, float]:
        return dict(self.convention.defaults)

    def values(self) -> dict[str, Float[Array, ""]]:
        numbers = (self.exposure, self.decay, self.density, self.weight, *self.light.reshape(-1))
        return dict(zip(self.parameters, numbers, strict=True))

    def coordinates(self) -> Float[Array, " p"]:
        per_ray = self.samples / self.density
        kappa = -per_ray * jnp.log(self.decay)
        gain = self.exposure * self.weight * per_ray
        return jnp.stack([self.exposure, kappa, self.density, gain, *self.light.reshape(-1)])

    def moved(self, coordinates: Vector, held: Vector | None = None) -> Mitchell:
        if held is None:
            held = jnp.full_like(coordinates, jnp.nan)
        free = jnp.isnan(held)
        exposure, kappa, density, gain = coordinates[:4]
        exposure = jnp.where(free[0], exposure, held[0])
        density = jnp.where(free[2], density, held[2])
        step = density / self.samples
        decay = jnp.where(free[1], jnp.exp(-kappa * step), held[1])
        # With no exposure there is no light pass, whatever the weight.
        shown = jnp.where(exposure > FAINTEST, exposure, 1.0)
        weight = jnp.where(free[3], gain * step / shown, held[3])
        light = jnp.where(free[4:], coordinates[4:], held[4:]).reshape(-1, 2)
        return eqx.tree_at(
            lambda m: (m.exposure, m.decay, m.density, m.weight, m.light),
            self,
            (exposure, decay, density, weight, light),
        )

    def bounds(self) -> tuple[list[float], list[float]]:
        inf = float("inf")
        lights = 2 * self.light.shape[0]
        # kappa >= 0 is decay <= 1. Rays shorter than a thousandth show nothing of decay or weight.
        return [0.0, 0.0, 1e-3, 0.0] + [-inf] * lights, [inf, inf, 1.0, inf] + [inf] * lights

    def linear(self) -> np.ndarray:
        return np.isin(np.arange(4 + 2 * self.light.shape[0]), (0, 3))

    def scales(self, coordinates: np.ndarray) -> np.ndarray:
        floor = np.full(coordinates.shape, 0.1, np.float32)
        floor[[0, 3]] = 1e-3
        return np.abs(coordinates) * np.float32(0.1) + floor

    def ranges(self, coordinates: np.ndarray) -> np.ndarray:
        exposure, kappa, _, gain = coordinates[:4]
        known = [max(exposure, 0.02), max(kappa, 2.0), 0.5, max(gain, 0.05)]
        return np.array(known + [0.5] * 2 * self.light.shape[0])

    @property
    def taps(self) -> tuple[Taps, ...]:
        """Those of each of the shader's passes, for every light."""
        numbers = (self.exposure, self.decay, self.density, self.weight)
        return self.convention.taps(*numbers, self.samples)

    def light_pass(
        self,
        mask: Float[Array, "h w"] | Float[Array, "h w c"],
        at: Float[Array, "*points 2"] | None = None,
        method: str = "auto",
    ) -> Float[Array, "..."]:
        """The scattering pass alone, unclamped: at ``at``, (..., 2) columns and rows of the mask,
        or at every pixel of the mask."""
        shader = self.convention
        passes = self.taps
        total = 0.0
        for light in self.light:
            image = 1 - mask if shader.box else mask
            for taps in passes[:-1]:
                image = radial_sum(image, light, taps, method=method)
            image = radial_sum(image, light, passes[-1], at=at, method=method)
            total += self.exposure * (1 - image) if shader.box else image
        return jnp.asarray(total)

    def __call__(
        self,
        mask: Float[Array, "h w"] | Float[Array, "h w c"],
        background: Float[Array, "..."] | None = None,
        *,
        size: tuple[int, int] | None = None,
        pixels: Int[Array, " n"] | None = None,
        texels: Texels | None = None,
        method: str = "auto",
    ) -> Float[Array, "..."]:
        """Light pass, upsampled if need be, on the background; linear, not clamped.

        **Arguments:**

        - `mask`: (h, w) or (h, w, channels), linear.
        - `background`: the ordinary pass, (H, W) or (H, W, channels), or None for black.
        - `size`: (H, W) of the image; by default the mask's. A smaller mask is a light pass at
          lower resolution: it is rendered at the mask's size, clamped to [0, 1] as its 8-bit
          texture is, and read bilinearly.
        - `pixels`: (n,) row-major indices of the pixels wanted; by default all.
        - `texels`: what these pixels read of a smaller light pass, all of which is rendered where
          this is not given.
        - `method`: see `godfit.scattering.radial.radial_sum`.

        **Returns:** (H, W) or (n,), then the channels of the mask or the background.
        """
        light_pass = functools.partial(self.light_pass, method=method)
        light = at_pixels(light_pass, mask, size, pixels, texels)
        return self.composite(light, background, pixels)

    def composite(
        self,
        light: Float[Array, "..."],
        background: Float[Array, "..."] | None,
        pixels: Int[Array, " n"] | None,
    ) -> Float[Array, "..."]:
        """The light pass at ``pixels``, or at all, on the background; see ``__call__``."""
        if background is None:
            return light
        if pixels is not None:
            background = background.reshape(-1, *background.shape[2:])[pixels]
        if background.ndim > light.ndim:
            light = light[..., None]
        elif light.ndim > background.ndim:
            background = background[..., None]
        if self.convention.blend == "screen":
            return background + light - background * light
        return self.convention.background_gain * background + light


def resampled(model: Mitchell, samples: int) -> Mitchell:
    """``model`` with another number of samples and parameters that make up for it; density does
    not go beyond 1."""
    if samples == model.samples or model.convention.box:
        return dataclasses.replace(model, samples=samples)
    density = float(model.density)
    kappa = -model.samples * math.log(max(float(model.decay), 1e-12)) / density
    total, centroid = _moments(model)

    def at(rho: float) -> Mitchell:
        decay = math.exp(-kappa * rho / samples)
        return eqx.tree_at(
            lambda m: (m.decay, m.density),
            dataclasses.replace(model, samples=samples),
            (jnp.float32(decay), jnp.float32(rho)),
        )

    def off(rho: float) -> float:
        return _moments(at(rho))[1] - centroid

    low, high = 0.25 * density, 1.0
    if off(low) < 0 < off(high):
        rho = float(optimize.brentq(off, low, high, xtol=1e-9))  # pyright: ignore[reportArgumentType]
    else:
        rho = high if off(high) <= 0 else low
    other = at(rho)
    weight = float(model.weight) * total / max(_moments(other)[0], 1e-30)
    return eqx.tree_at(lambda m: m.weight, other, jnp.float32(weight))


def _moments(model: Mitchell) -> tuple[float, float]:
    """Sum of the taps' weights but for the pixel's own, and their centroid along the ray."""
    (taps,) = model.taps
    c = float(taps.first) * float(taps.ratio) ** np.arange(taps.count, dtype=float)
    t = float(taps.step) * np.arange(1, taps.count + 1)
    total = float(c.sum())
    return total, float(c @ t) / max(total, 1e-30)

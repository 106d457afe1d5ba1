"""Mitchell's screen-space scattering sum: parameters + mask -> image."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from godfit.errors import InputError, Remark
from godfit.io.arrays import as_light
from godfit.models.base import FAINTEST, AbstractModel, Vector
from godfit.models.coordinates import DENSITY, EXPOSURE, GAIN, KAPPA, SCATTERING_COUNT
from godfit.runtime.device import on_device
from godfit.runtime.program_cache import cached_jit
from godfit.scattering.conventions import Convention, convention
from godfit.scattering.parameters import (
    MAX_DENSITY,
    SCATTERING,
    Parameter,
    density_reach,
    table,
)
from godfit.scattering.passes import Pass, composed_sum
from godfit.scattering.radial import radial_sum
from godfit.scattering.radial.exact import at_run_time
from godfit.scattering.taps import Count, Taps
from godfit.scattering.upsample import Texels, at_pixels

MIN_DENSITY = 1e-3
"""Least density, a share of the ray: over a shorter ray neither decay nor weight has an effect."""
MIN_RESAMPLED_DENSITY = 0.25
"""Least density of a model with another number of samples, as a share of the old density."""
DENSITY_TOLERANCE = 1e-9
"""Absolute error of that density."""
AT_SLIDER_END = 1e-3
"""Distance of a density from the end of a slider within which it is that end: a tenth of the step
of the published ones."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(9)
UNIFORM = tuple(math.sqrt(3) * _NODES), tuple(_WEIGHTS / 2)
"""Places, in standard deviations, and weights (Gauss and Legendre's) whose mean is that over a
uniform distribution, of bilinear reads some texels apart to a hundredth of a level."""
EDGE, BLACK = "edge", "black"
"""What a shader's reads beyond the mask's edge return: the nearest pixel, or black."""
TINY_DECAY = 1e-12
"""Least decay in a logarithm: 0 has none, and no tap after the first counts at either."""
TINY_SUM = 1e-30
"""Least sum of weights to divide by: a weight of 0 is allowed."""


class Mitchell(AbstractModel):
    """Mitchell's screen-space scattering sum (GPU Gems 3, ch. 13) as one shader computes it.

    ``exposure``, ``decay``, ``density`` and ``weight`` are the shader's; ``light`` is (lights, 2)
    in texture coordinates. Several lights are a sum over lights. ``samples`` is an integer and is
    not differentiated. With ``full_size`` the light pass has the image's size where the mask is
    smaller, and reads the mask between its texels. ``border`` is what the taps read beyond the
    mask's edge: ``"edge"``, the nearest pixel, or ``"black"``. ``jitter`` is the standard deviation
    in steps by which the taps of a pixel lie elsewhere, all by the same random share: the image is
    then the mean over that.

    Fit coordinates (one for each parameter, in order): exposure; kappa = -samples ln(decay) /
    density, the attenuation for each unit of ray; density; gain = exposure weight samples /
    density; the lights. The image depends on samples almost only through kappa and gain.

    >>> import godfit
    >>> model = godfit.Mitchell(0.05, 0.99, 0.8, 0.8, light=(0.5, 0.5), shader="dawntime")
    >>> model(godfit.read_image("mask.png")).shape
    (96, 96)
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
    full_size: bool = eqx.field(static=True, default=False)
    border: str = eqx.field(static=True, default=EDGE)
    jitter: Float[Array, ""] | None = None

    def __init__(
        self, exposure, decay, density, weight, light, shader="mitchell", samples=None,
        full_size: Any = False, border: Any = EDGE, jitter: Any = None,
    ):  # fmt: skip
        self.exposure, self.decay = on_device(exposure, float), on_device(decay, float)
        self.density, self.weight = on_device(density, float), on_device(weight, float)
        self.light = on_device(light, float).reshape(-1, 2)
        own = convention(shader)
        self.shader = own.key
        count = own.samples if samples is None else samples
        # The loops of sums that are no sequence of taps need a known number.
        self.samples = count if own.passes else at_run_time(count)
        self.full_size, self.border = full_size, border
        self.jitter = None if jitter is None else on_device(jitter, float)

    @property
    def convention(self) -> Convention:
        """The convention of the shader."""
        return convention(self.shader)

    @property
    def settings(self) -> dict[str, Any]:
        own = self.convention
        border = {} if self.border == EDGE else {"border": self.border}
        definition = {"shader_definition": own.definition()} if own.own_file else {}
        return {"shader": own.name, "samples": self.samples, **definition, **border}

    @property
    def jumps(self) -> bool:
        return self.convention.jumps

    def with_pass(self, **settings: Any) -> Mitchell:
        """This model with other ``settings`` of its light pass: its fields by name."""
        return dataclasses.replace(self, **settings)

    def on_copy(self, scale: float) -> Mitchell:
        own = self.convention
        small = own.on_copy(scale)
        return self if small is own else dataclasses.replace(self, shader=convention(small).key)

    @property
    def parameters(self) -> dict[str, Parameter]:
        rows = table(self.light.shape[0])
        most = self.convention.most_density
        if most != MAX_DENSITY:
            rows["density"] = dataclasses.replace(rows["density"], upper=most)
        return rows

    @property
    def absent(self) -> dict[str, float]:
        return dict(self.convention.absent)

    @property
    def used(self) -> np.ndarray:
        absent = {row.name for row in SCATTERING} - {*self.convention.parameters}
        return ~np.isin(list(self.parameters), list(absent))

    @property
    def defaults(self) -> dict[str, float]:
        return self.convention.defaults | self.convention.absent

    def values(self) -> dict[str, Float[Array, ""]]:
        scattering = (self.exposure, self.decay, self.density, self.weight)
        numbers = (*scattering, *self.light.reshape(-1))
        return dict(zip(self.parameters, numbers, strict=True))

    def coordinates(self) -> Float[Array, " p"]:
        scattering = (self.exposure, self.decay, self.density, self.weight)
        return _coordinates(*scattering, self.light, self.samples)

    def moved(self, coordinates: Vector, held: Vector | None = None) -> Mitchell:
        if held is None:
            held = jnp.full_like(coordinates, jnp.nan)
        free, lights = jnp.isnan(held), slice(SCATTERING_COUNT, None)
        exposure, kappa, density, gain = coordinates[:SCATTERING_COUNT]
        exposure = jnp.where(free[EXPOSURE], exposure, held[EXPOSURE])
        density = jnp.where(free[DENSITY], density, held[DENSITY])
        step = density / self.samples
        # The parameters decay and weight have the places of the coordinates kappa and gain.
        decay = jnp.where(free[KAPPA], jnp.exp(-kappa * step), held[KAPPA])
        # With no exposure there is no light pass, whatever the weight.
        shown = jnp.where(exposure > FAINTEST, exposure, 1.0)
        weight = jnp.where(free[GAIN], gain * step / shown, held[GAIN])
        light = jnp.where(free[lights], coordinates[lights], held[lights]).reshape(-1, 2)
        return eqx.tree_at(
            lambda m: (m.exposure, m.decay, m.density, m.weight, m.light),
            self,
            (exposure, decay, density, weight, light),
        )

    def bounds(self) -> tuple[list[float], list[float]]:
        inf = float("inf")
        lights = self.light.size
        # kappa >= 0 is decay <= 1.
        lower, upper = [0.0, 0.0, MIN_DENSITY, 0.0], [inf, inf, self.convention.most_density, inf]
        return lower + [-inf] * lights, upper + [inf] * lights

    def linear(self) -> np.ndarray:
        # A saturated sum is not linear in its exposure, and nothing in it depends on the gain.
        linear = () if self.convention.saturated else (EXPOSURE, GAIN)
        return np.isin(np.arange(SCATTERING_COUNT + self.light.size), linear)

    def scales(self, coordinates: np.ndarray) -> np.ndarray:
        floor = np.full(coordinates.shape, 0.1, np.float32)
        floor[[EXPOSURE, GAIN]] = 1e-3
        return np.abs(coordinates) * np.float32(0.1) + floor

    def ranges(self, coordinates: np.ndarray) -> np.ndarray:
        exposure, kappa, _, gain = coordinates[:SCATTERING_COUNT]
        scattering = [max(exposure, 0.02), max(kappa, 2.0), 0.5, max(gain, 0.05)]
        return np.array(scattering + [0.5] * self.light.size)

    def notes(self, free: Sequence[str]) -> tuple[str, ...]:
        shader = self.convention
        end = shader.density_slider
        if "density" not in free or end is None or abs(float(self.density) - end) > AT_SLIDER_END:
            return ()
        return (Remark(f"density is {end:g}, where the slider of {shader.name} ends", "slider"),)

    @property
    def taps(self) -> tuple[Taps, ...]:
        """The taps of each of the shader's passes, the same for every light."""
        numbers = (self.exposure, self.decay, self.density, self.weight)
        return self.convention.taps(*numbers, self.samples)

    @property
    def reads_between(self) -> bool:
        return self.full_size

    @property
    def walk(self) -> Taps | None:
        return None if self.convention.box else self.taps[0]

    def light_pass(
        self,
        mask: Any,
        at: Float[Array, "*points 2"] | None = None,
        method: str = "auto",
    ) -> Float[Array, "..."]:
        """The scattering pass alone, not clamped: at ``at``, (..., 2) columns and rows of the mask,
        or at every pixel of the mask."""
        mask = as_light(mask, "mask")
        shader, total = self.convention, 0.0
        read = shader.reads(mask)
        for light in self.light:
            total += self._scattered(read, light, at, method)
        return jnp.asarray(total)

    def moved_sums(
        self, mask: Any, lags: Sequence[float], pixels: np.ndarray
    ) -> Float[np.ndarray, "lags n"]:
        """The linear scattering pass of a shader with one set of taps under a grey ``mask``, (h, w)
        or (h, w, 1), at row-major indices ``pixels`` (n,), with all taps moved towards the pixel by
        each of ``lags``, in steps."""
        mask = mask if mask.ndim == 2 else mask[..., 0]
        row, column = np.divmod(pixels, mask.shape[1])
        at = jnp.asarray(np.stack([column, row], -1).astype(np.float32))
        (taps,) = self.taps
        sums = np.zeros((len(lags), len(pixels)))
        for light in self.light:
            for i, lag in enumerate(lags):
                moved = eqx.tree_at(lambda t: t.lag, taps, lag)
                sums[i] += np.asarray(radial_sum(mask, light, moved, at=at))
        return sums

    def _scattered(self, read, light, at, method):
        """The light pass of one ``light``, of what it ``read``s."""
        shader = self.convention
        if shader.passes and self.border != EDGE:
            raise InputError(f"border: expected {EDGE} with {self.shader}, got {self.border}")
        if shader.passes:
            given = Pass(light, self.density, self.samples, shader.pass_options, at)
            image = composed_sum(shader, read, given)
        else:
            passes, image = self.taps, 1 - read if shader.box else read
            for taps in passes[:-1]:
                image = self._summed(image, light, taps, None, method)
            image = self._mean_sum(image, light, passes[-1], at, method)
        if shader.power != 1:
            # The sum has the exposure already, which is no part of what is raised.
            exposure = shader.gain * self.exposure
            image = exposure * _raised(image / jnp.maximum(exposure, FAINTEST), shader.power)
        if shader.box:
            image = 1 - image
        # What is blended towards a light pass has its exposure there.
        scaled = shader.composed and shader.blend != "towards"
        return self.exposure * image if scaled else image

    def _mean_sum(self, image, light, taps, at, method):
        """The radial sum of ``image``, or its mean over the jitter."""
        if self.jitter is None:
            return self._summed(image, light, taps, at, method)
        mean = 0.0
        for place, weight in zip(*UNIFORM, strict=True):
            moved = dataclasses.replace(taps, lag=taps.lag + place * self.jitter)
            mean += weight * self._summed(image, light, moved, at, method)
        return mean

    def _summed(
        self,
        image: Any,
        light: Float[Array, "2"],
        taps: Taps,
        at: Float[Array, "*points 2"] | None,
        method: str,
    ) -> Float[Array, "..."]:
        """The radial sum of ``image``, which beyond its edge is its edge or black."""
        if self.border == EDGE:
            return radial_sum(image, light, taps, at=at, method=method)
        if taps.unit != "ray":
            raise InputError(f"border: expected {EDGE} with {self.shader}, got {self.border}")
        # One ring of black pixels: beyond it, the edge that is repeated is black.
        h, w = image.shape[:2]
        framed = jnp.pad(image, ((1, 1), (1, 1), *[(0, 0)] * (image.ndim - 2)))
        size = jnp.array([w, h], light.dtype)
        moved = (light * size + 1) / (size + 2)
        if at is not None:
            return radial_sum(framed, moved, taps, at=at + 1, method=method)
        return radial_sum(framed, moved, taps, method=method)[1:-1, 1:-1]

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
        """Light pass, upsampled if need be, on the background; linear, not clamped.

        **Arguments:**

        - `mask`: (h, w) or (h, w, channels), linear; integers are levels.
        - `background`: the ordinary pass, (H, W) or (H, W, channels), or None for black.
        - `size`: (H, W) of the image; by default the mask's. A mask that is larger by more than 2%
          is read between its texels. Another one is a light pass of its own size, unless
          `full_size`: it is rendered at the mask's size, clamped to [0, 1] as its 8-bit texture
          is, and read bilinearly.
        - `pixels`: (n,) row-major indices of the pixels wanted; by default all.
        - `texels`: the texels of a smaller light pass that these pixels need. Without it the
          whole light pass is rendered.
        - `method`: see `godfit.scattering.radial.radial_sum`.

        **Returns:** (H, W) or (n,), then the channels of the mask or the background.
        """
        mask = as_light(mask, "mask")
        background = None if background is None else as_light(background, "background")
        light_pass = functools.partial(self.light_pass, method=method)
        light = at_pixels(light_pass, mask, size, pixels, texels, self.full_size)
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
        blend = self.convention.blend
        if blend == "screen":
            return background + light - background * light
        if blend == "modulate":
            return background * (1 + light)
        if blend == "towards":
            mean = light.mean(-1, keepdims=True) if light.ndim == background.ndim > 1 else light
            return background + self.exposure * mean * (light - background)
        return self.convention.background_gain * background + light


@cached_jit
def _coordinates(exposure, decay, density, weight, light, samples):
    per_ray = samples / density
    kappa = -per_ray * jnp.log(jnp.maximum(decay, TINY_DECAY))
    return jnp.stack([exposure, kappa, density, exposure * weight * per_ray, *light.reshape(-1)])


def _raised(image, power):
    """``image`` to ``power``; at 0 its derivative is finite too."""
    return jnp.where(image > 0, jnp.where(image > 0, image, 1.0) ** power, 0.0)


def resampled(model: Mitchell, samples: int) -> Mitchell:
    """``model`` with another number of samples, and with decay, density and weight that make up for
    it: the attenuation, the centroid and the sum of its taps stay the same. Density stays in its
    ``density_reach``, at whose end the centroid may differ."""
    if samples == model.samples or model.convention.composed:
        return dataclasses.replace(model, samples=samples)
    density = float(model.density)
    kappa = -model.samples * math.log(max(float(model.decay), TINY_DECAY)) / density
    total, centroid = _moments(model)

    def at_density(rho: float) -> Mitchell:
        decay = math.exp(-kappa * rho / samples)
        return eqx.tree_at(
            lambda m: (m.decay, m.density),
            dataclasses.replace(model, samples=samples),
            (jnp.float32(decay), jnp.float32(rho)),
        )

    def centroid_error(rho: float) -> float:
        return _moments(at_density(rho))[1] - centroid

    low, high = MIN_RESAMPLED_DENSITY * density, density_reach(density)
    if centroid_error(low) < 0 < centroid_error(high):
        from scipy import optimize

        root: Any = optimize.brentq(centroid_error, low, high, xtol=DENSITY_TOLERANCE)
        rho = float(root)
    else:
        rho = high if centroid_error(high) <= 0 else low
    other = at_density(rho)
    weight = float(model.weight) * total / max(_moments(other)[0], TINY_SUM)
    return eqx.tree_at(lambda m: m.weight, other, jnp.float32(weight))


def _moments(model: Mitchell) -> tuple[float, float]:
    """The sum of the taps' weights without the pixel's own, and their centroid along the ray."""
    (taps,) = model.taps
    c = float(taps.first) * float(taps.ratio) ** np.arange(taps.count, dtype=float)
    t = float(taps.step) * (np.arange(1, taps.count + 1) - float(taps.lag))
    total = float(c.sum())
    return total, float(c @ t) / max(total, TINY_SUM)

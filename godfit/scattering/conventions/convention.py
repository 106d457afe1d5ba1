"""A shader's convention: how its parameters become taps, and how its light pass is blended."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from godfit.runtime.device import on_device
from godfit.scattering.parameters import MAX_DENSITY
from godfit.scattering.taps import Count, Scalar, Taps, as_count

UNPUBLISHED_SAMPLES = 100
"""Samples of a shader that publishes no default: the most common of the published ones."""
LUMA = (0.2126, 0.7152, 0.0722)
"""Weights of red, green and blue in a colour's luma (ITU-R BT.709)."""
SAME_DECAY = 1e-6
"""Logarithm of a decay, per tap, below which it is 1: the geometric series is then a limit."""
LEAST_DECAY = 1e-12
"""Least decay in a logarithm: a decay of 0 has none."""
SCATTERING_NAMES = ("exposure", "decay", "density", "weight")
"""The four numbers of Mitchell's sum, in the order of reports."""

PIXEL_OPTIONS = ("radius", "gaussian")
"""Those of ``pass_options`` that are lengths in pixels of the light pass."""
NEAREST_READS = ("godot4",)
"""The ``passes`` that read the nearest texel."""

Blend = Literal["add", "screen", "modulate", "towards"]


@dataclass(frozen=True, eq=False)
class Convention:
    """The formula of one shader, from its parameters to taps.

    Most are g E (own M + w sum_{i=1..n-drop} d^(i-order) M_i), with the exposure E, weight w, decay
    d and number of samples n; g is ``gain``. ``own`` is 0 in a shader without the pixel's own
    value, ``drop`` the number of samples that its loop leaves out (negative: taps beyond n), and
    ``order`` 1 where decay is applied after a tap, 0 where before.

    A tap lies ``density / (n - step_drop)`` of the ray behind the one before it, the first tap
    ``1 - lag`` of that from the pixel. ``most_taps`` ends the loop. An ``averaged`` sum is divided
    by n. Where ``own_scaled`` is False, neither exposure nor gain acts on the pixel's own value. A
    ``saturated`` sum is divided by 1 + E S - threshold, with S the sum of its weights. ``absent``
    has the parameters that the formula lacks, at the values that stand for them.

    The pass reads max(M - ``threshold``, 0), or the ``luma`` of that, and raises the sum to
    ``power``.

    A ``box`` convention runs a pass of equal weights for each of its steps (in texture coordinates)
    on 1 - M, one after another, and its light pass is E (1 - result). A ``blurs`` convention
    averages ``blur_taps`` equal taps along the ray in each pass; the numbers are the passes' shares
    of the density. ``passes`` names a sum that is no sequence of such taps, see
    ``godfit.scattering.passes``; ``pass_options`` are its further numbers.

    ``blend`` is how the light pass L is composited onto the background B: ``"add"`` is
    background_gain * B + L, ``"screen"`` is B + L - B L, ``"modulate"`` is B (1 + L), ``"towards"``
    is B + E mean(L) (L - B), where the mean is that of the channels and L has no exposure.
    ``pass_scale`` is the size of the light pass relative to the picture, where nothing else is
    known. ``half_floats`` is whether mask and light pass are stored in these, and not in bytes.

    ``defaults`` are the published default parameters by name, none where none are published;
    ``names`` are the engine's own names of parameters, ``source`` is where both are found.
    ``density_slider`` is where the slider of density ends in the published program, None where
    none is published; ``most_density`` is the largest one that is fitted. ``family`` groups what
    ``godfit shaders`` prints. ``own_file`` is True of a convention that a user's file defines.

    Texture coordinates are those of GLSL, v up. In HLSL v runs down; that changes the light's v to
    1 - v and no tap, because taps lie on straight lines to the light.
    """

    name: str
    formula: str
    own: float = 1.0
    drop: int = 0
    order: int = 1
    gain: float = 1.0
    box: tuple[float, ...] = ()
    defaults: dict[str, float] = field(default_factory=dict)
    blend: Blend = "add"
    background_gain: float = 1.0
    density_slider: float | None = None
    pass_scale: float = 1.0
    half_floats: bool = False
    remarks: str = ""
    own_scaled: bool = True
    averaged: bool = False
    saturated: bool = False
    step_drop: int = 0
    lag: float = 0.0
    most_taps: int | None = None
    absent: dict[str, float] = field(default_factory=dict)
    threshold: float = 0.0
    luma: bool = False
    power: float = 1.0
    blurs: tuple[float, ...] = ()
    blur_taps: int = 6
    passes: str = ""
    pass_options: dict[str, float] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    source: str = ""
    most_density: float = MAX_DENSITY
    family: str = ""
    own_file: bool = False

    def taps(
        self, exposure: Scalar, decay: Scalar, density: Scalar, weight: Scalar, samples: Count
    ) -> tuple[Taps, ...]:
        """The taps of each pass. Those of a convention of several passes do not include the
        exposure."""
        density = self.absent.get("density", density)
        if self.box:
            return tuple(Taps(1 / 6, 1 / 6, 1.0, step, 5, "uv") for step in self.box)
        if self.blurs:
            share, count = 1 / self.blur_taps, self.blur_taps - 1
            unit = density / (count * sum(self.blurs))
            return tuple(Taps(share, share, 1.0, part * unit, count) for part in self.blurs)
        decay = self.absent.get("decay", decay)
        weight = self.absent.get("weight", weight)
        numbers: Any = exposure, decay, density, weight
        if any(isinstance(number, Tracer) for number in (*numbers, samples)):
            numbers = jnp.asarray(exposure), jnp.asarray(decay), density, weight
            own, first, ratio, step = self._numbers(numbers, samples)
        else:
            # In NumPy: outside of a program, each operation of JAX's would be compiled by itself.
            kind = jnp.result_type(float)
            with np.errstate(divide="ignore"):
                found = self._numbers([np.asarray(number, kind) for number in numbers], samples)
            own, first, ratio, step = (on_device(number, kind) for number in found)
        count = as_count(self.count(samples))
        return (Taps(own, first, ratio, step, count, lag=self.lag),)

    def _numbers(self, parameters: Sequence[Any], samples: Any) -> tuple[Any, Any, Any, Any]:
        """The own weight, the first one, the ratio and the step of a convention of one pass, from
        exposure, decay, density and weight."""
        exposure, decay, density, weight = parameters
        count = self.count(samples)
        scale = self.gain * exposure
        if self.averaged:
            scale = scale / samples
        if self.saturated:
            scale = scale / (
                1 - self.threshold + scale * weight * self.weights(jnp.asarray(decay), count)
            )
        first = scale * weight * decay ** (1 - self.order)
        own = self.own * scale if self.own_scaled else self.own
        step = density / (samples - self.step_drop)
        return own, first, decay, step

    def count(self, samples: Any) -> Any:
        """The number of taps for a number of samples, which may be traced."""
        count = samples - self.drop
        if self.most_taps is None:
            return count
        if isinstance(count, Tracer):
            return jnp.minimum(count, self.most_taps)
        return min(count, self.most_taps)

    def weights(self, decay: Scalar, count: Any) -> Float[Array, ""]:
        """sum_{i=1..count} d^(i-order), differentiable at a decay of 1 too."""
        u = jnp.log(jnp.maximum(jnp.asarray(decay), LEAST_DECAY))
        flat = jnp.abs(u) < SAME_DECAY
        apart = jnp.where(flat, 1.0, u)
        series = jnp.expm1(count * apart) / jnp.expm1(apart)
        limit = count * (1 + (count - 1) / 2 * u)
        return jnp.where(flat, limit, series) * jnp.exp(u * (1 - self.order))

    def reads(self, mask: Any) -> Any:
        """What the sum reads of a mask (h, w) or (h, w, channels), of the same shape."""
        if self.threshold:
            mask = jnp.maximum(mask - self.threshold, 0)
        if self.luma and mask.ndim == 3 and mask.shape[-1] == len(LUMA):
            mask = jnp.broadcast_to((mask @ jnp.asarray(LUMA, mask.dtype))[..., None], mask.shape)
        return mask

    def on_copy(self, scale: float) -> Convention:
        """The convention on a copy of the pass at ``scale``, whose pixels are larger."""
        lengths = {n: v * scale for n, v in self.pass_options.items() if n in PIXEL_OPTIONS}
        if scale == 1 or not lengths:
            return self
        return dataclasses.replace(self, pass_options=self.pass_options | lengths)

    @property
    def composed(self) -> bool:
        """Whether the light pass is no single sum over taps of geometric weights."""
        return bool(self.box or self.blurs or self.passes)

    @property
    def plain(self) -> bool:
        """Whether five numbers of one set of taps determine the light pass, so that it can be
        translated to another convention by algebra."""
        return not (self.composed or self.threshold or self.luma or self.lag or self.power != 1)

    @property
    def jumps(self) -> bool:
        """Whether the light pass reads the nearest texel, so that it jumps as the light moves."""
        return self.passes in NEAREST_READS

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of those of exposure, decay, density and weight that the formula uses."""
        if self.box:
            return ("exposure",)
        return tuple(name for name in SCATTERING_NAMES if name not in self.absent)

    @property
    def samples(self) -> int:
        """The shader's default number of samples."""
        return int(self.defaults.get("samples", UNPUBLISHED_SAMPLES))

    @property
    def own_pixel(self) -> bool:
        """Whether the pixel's own value enters with the exposure: without it, only exposure*weight
        is determined."""
        return self.own != 0 and self.own_scaled

    @property
    def product_open(self) -> bool:
        """Whether a picture determines the product of exposure and weight alone."""
        return not (self.composed or self.own_pixel) and "weight" not in self.absent

    @property
    def key(self) -> str:
        """The name under which a model finds the convention: one definition has one key, so that
        what was compiled for a user's file serves no other content of it."""
        if not self.own_file:
            return self.name
        digest = hashlib.sha256(repr(self.definition()).encode()).hexdigest()[:12]
        return f"{self.name}#{digest}"

    def definition(self) -> dict[str, Any]:
        """The fields that differ from their defaults, by name: what a file of the convention has.
        Lists stand for tuples, as in TOML and JSON."""
        found: dict[str, Any] = {}
        for row in fields(self):
            value = getattr(self, row.name)
            empty = row.default_factory() if callable(row.default_factory) else row.default
            if row.name != "own_file" and value != empty:
                found[row.name] = list(value) if isinstance(value, tuple) else value
        return found

    def value_of(self, values: Mapping[str, float], name: str) -> float | None:
        """A parameter's value among ``values``, else what stands for it, else its default."""
        return values.get(name, self.absent.get(name, self.defaults.get(name)))


def defaults_of(
    exposure: float, decay: float, density: float, weight: float, samples: int
) -> dict[str, float]:
    """Published defaults by name."""
    return {
        "exposure": exposure,
        "decay": decay,
        "density": density,
        "weight": weight,
        "samples": samples,
    }

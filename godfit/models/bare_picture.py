"""A picture that comes with nothing: a hypothesis of the mask that its light pass read, on a smooth
background.

A mask hypothesis (``DiscLight``) has three numbers of shape, and makes the mask
from an open mask, which is known. The background is a polynomial of the place (``background.py``),
linear in its coefficients. The light is white, or of one colour.
"""

from __future__ import annotations

import dataclasses
import functools
from abc import abstractmethod
from typing import ClassVar, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from godfit.models.background import CHANNEL_NAMES, DARKEST_BACKGROUND, TERM_POWERS, terms
from godfit.models.base import FAINTEST, Vector
from godfit.models.coordinates import (
    DENSITY,
    EXPOSURE,
    FIRST_BACKGROUND,
    GAIN,
    RADIUS,
    SCATTERING_COUNT,
    SHADING_COUNT,
    VEIL,
)
from godfit.models.mitchell import Mitchell
from godfit.models.shaded import AbstractShaded
from godfit.models.tinted import TINT_PARAMETERS
from godfit.scattering.parameters import (
    LIGHT_DENSITY,
    SCATTERING,
    Parameter,
    light_parameters,
)
from godfit.scattering.radial.derivatives import is_symbolic_zero
from godfit.scattering.upsample import Texels, at_pixels

Model = TypeVar("Model", bound="AbstractBarePicture")

FAINTEST_VEIL = 0.01
"""Least mask value of a veil whose rays are visible, a hundredth of the light's. A gain is at most
the veil's part of it over this."""
DERIVATIVE_EDGE = 0.3
"""Least width of a disc's edge in derivatives, in texels. A harder edge lies between the texels'
middles and has no derivative there, though the sum steps as it passes them."""

BARE_SCATTERING = tuple(
    dataclasses.replace(row, upper=LIGHT_DENSITY) if row.name == "density" else row
    for row in SCATTERING
)
"""The scattering of a bare picture: its searches place no taps beyond the light."""


class AbstractBarePicture(AbstractShaded):
    """Mitchell's sum over the mask of a hypothesis, on a background.

    ``shading`` holds the scattering and the light's place; ``shape`` (3,) is the hypothesis's own,
    its third number the mask's value without the light; ``background`` (k, c) holds the
    coefficients of ``background.terms``, linear values; ``tint`` (2,) is red and blue of the light
    against green, (0,) for a white light.

    Coordinates are Mitchell's, then these numbers. But gain (1 - veil) stands for the gain, and
    gain veil for the veil, the third number of the shape: the picture is linear in these two, while
    gain and veil trade in a bent valley.
    """

    name: ClassVar[str] = Mitchell.name
    banded: ClassVar[bool] = False
    channels: ClassVar[int] = 1
    # The rows of ``shape``.
    shape_parameters: eqx.AbstractClassVar[tuple[Parameter, ...]]

    shape: eqx.AbstractVar[Float[Array, " 3"]]
    background: eqx.AbstractVar[Float[Array, "k c"]]
    tint: eqx.AbstractVar[Float[Array, " t"]]

    @property
    @abstractmethod
    def shape_used(self) -> list[bool]:
        """[3] False for numbers of the shape that have no effect here."""

    @abstractmethod
    def shape_bounds(self) -> tuple[list[float], list[float]]:
        """Lower and upper bounds of the three coordinates of the shape."""

    @abstractmethod
    def shape_scales(self, coordinates: np.ndarray) -> np.ndarray:
        """(2,) ``scales`` of the first two coordinates of the shape."""

    @abstractmethod
    def shape_ranges(self) -> tuple[float, float]:
        """``ranges`` of the first two coordinates of the shape."""

    @abstractmethod
    def occlusion(self, open_: Float[Array, "h w"], least: float = 0.0) -> Float[Array, "h w"]:
        """The mask that the light pass reads, from the open mask; an edge of the light is at
        ``least`` so wide, in texels."""

    @abstractmethod
    def occlusion_slopes(
        self, open_: Float[Array, "h w"], least: float
    ) -> list[Float[Array, "h w"]]:
        """The five derivatives of ``occlusion``, by the light's place and by ``shape``."""

    @property
    def light(self) -> Float[Array, "1 2"]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.shading.light

    @property
    def colour(self) -> Float[Array, " c"]:
        """The light's colour, by channel of the background."""
        if not self.tint.size:
            return jnp.ones(self.background.shape[1], self.tint.dtype)
        return jnp.stack([self.tint[0], jnp.ones_like(self.tint[0]), self.tint[1]])

    @property
    def darkest(self) -> float:
        """Least value of a constant background. A polynomial only approximates a background, and
        has no bound: its search may pass through dark values."""
        return DARKEST_BACKGROUND if len(self.background) == 1 else -np.inf

    @property
    def used(self) -> np.ndarray:
        rest = np.ones(len(self.parameters) - FIRST_BACKGROUND, bool)
        return np.concatenate([self.shading.used, self.shape_used, rest])

    @property
    def parameters(self) -> dict[str, Parameter]:
        rows = [*BARE_SCATTERING, *light_parameters(1), *self.shape_parameters]
        k, c = self.background.shape
        for i, j in TERM_POWERS[:k]:
            place = "x" * i + "y" * j
            for channel in CHANNEL_NAMES if c == 3 else ("",):
                name = "_".join(filter(None, ("background", channel, place)))
                rows.append(Parameter(name, "", "1", self.darkest, np.inf, "of the ordinary pass"))
        rows += TINT_PARAMETERS[: self.tint.size]
        return {row.name: row for row in rows}

    def values(self) -> dict[str, Float[Array, ""]]:
        numbers = [
            *self.shading.values().values(), *self.shape, *self.background.reshape(-1), *self.tint
        ]  # fmt: skip
        return dict(zip(self.parameters, numbers, strict=True))

    def coordinates(self) -> Float[Array, " p"]:
        scattering, (first, second, veil) = self.shading.coordinates(), self.shape
        gain = scattering[GAIN]
        scattering = scattering.at[GAIN].set(gain * (1 - veil))
        shape = jnp.stack([first, second, gain * veil])
        return jnp.concatenate([scattering, shape, self.background.reshape(-1), self.tint])

    def moved(self: Model, coordinates: Vector, held: Vector | None = None) -> Model:
        coordinates = jnp.asarray(coordinates)
        if held is None:
            held = jnp.full_like(coordinates, jnp.nan)
        free = jnp.isnan(jnp.asarray(held))
        disc, veiled = coordinates[GAIN], coordinates[VEIL]
        gain = jnp.where(
            free[VEIL], disc + veiled, disc / (1 - jnp.where(free[VEIL], 0, held[VEIL]))
        )
        scattering = jnp.asarray(coordinates[:SHADING_COUNT]).at[GAIN].set(gain)
        shading = self.shading.moved(scattering, held[:SHADING_COUNT])
        # With a held weight, the gain is that of the moved shading.
        gain = jnp.where(free[GAIN], gain, shading.coordinates()[GAIN])
        # A derivative divides by the square of the gain, which underflows for a tiny gain.
        veil = veiled / jnp.where(gain > FAINTEST, gain, 1.0)
        # By jnp.where, whose derivative at 1 is that from below: without a disc the veil is 1, and
        # what a disc adds takes from the veil's part.
        veil = jnp.where(veil > 1, 1.0, jnp.maximum(veil, 0.0))
        rest = jnp.where(free[SHADING_COUNT:], coordinates[SHADING_COUNT:], held[SHADING_COUNT:])
        shape = rest[:3].at[2].set(jnp.where(free[VEIL], veil, held[VEIL]))
        background, tint = jnp.split(rest[3:], [self.background.size])
        at = (shading, shape, background.reshape(self.background.shape), tint)
        return eqx.tree_at(lambda m: (m.shading, m.shape, m.background, m.tint), self, at)

    def bounds(self) -> tuple[list[float], list[float]]:
        lower, upper = self.shading.bounds()
        upper[DENSITY] = LIGHT_DENSITY
        shape_lower, shape_upper = self.shape_bounds()
        count, tint = self.background.size, self.tint.size
        lower = [*lower, *shape_lower, *[self.darkest] * count, *[0.0] * tint]
        return lower, [*upper, *shape_upper, *[float("inf")] * (count + tint)]

    def linear(self) -> np.ndarray:
        end = FIRST_BACKGROUND + self.background.size
        index = np.arange(end + self.tint.size)
        return (index == EXPOSURE) | (index >= FIRST_BACKGROUND) & (index < end)

    def scales(self, coordinates: np.ndarray) -> np.ndarray:
        rest = np.full(len(coordinates) - SHADING_COUNT, 0.02, np.float32)
        rest[VEIL - SHADING_COUNT] = 0.1 * np.abs(coordinates[VEIL]) + 1e-3
        scales = np.concatenate([self.shading.scales(coordinates[:SHADING_COUNT]), rest])
        scales[RADIUS:VEIL] = self.shape_scales(coordinates)
        return scales

    def ranges(self, coordinates: np.ndarray) -> np.ndarray:
        rest = np.full(len(coordinates) - SHADING_COUNT, 0.3)
        rest[:3] = *self.shape_ranges(), max(coordinates[VEIL], 0.05)
        scattering = self.shading.ranges(coordinates[:SHADING_COUNT])
        # The gain of a disc outside the picture is known by the veil's part alone.
        scattering[GAIN] = max(scattering[GAIN], coordinates[VEIL] / FAINTEST_VEIL)
        return np.concatenate([scattering, rest])

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
        """The picture, linear, not clamped; see ``Mitchell.__call__``. ``mask`` (h, w) is the open
        mask; ``background`` is the model's own, and the argument ignored."""
        light = self.light_pass(mask, size=size, pixels=pixels, texels=texels, method=method)
        return self.composite(light, size or (mask.shape[0], mask.shape[1]), pixels)

    def light_pass(self, mask, *, size=None, pixels=None, texels=None, method="auto"):
        """The light pass alone, (h, w) or (n,), of one channel; arguments as in ``__call__``."""
        scattered = functools.partial(self._scattered, method=method)
        return at_pixels(scattered, mask, size, pixels, texels)

    def composite(self, light, size: tuple[int, int], pixels=None):
        """The light pass on the background: (h, w, c) or (n, c), without c where it is 1."""
        every = jnp.arange(size[0] * size[1]) if pixels is None else pixels
        back = jnp.asarray(terms(every, size, self.background.shape[0])) @ self.background
        back = back.reshape(*light.shape, -1)
        light = light[..., None] * self.colour.reshape((1,) * light.ndim + (-1,))
        if self.convention.blend == "screen":
            out = back + light - back * light
        else:
            out = self.convention.background_gain * back + light
        return out if out.shape[-1] > 1 else out[..., 0]

    def _scattered(self, open_, at=None, method="auto"):
        """The sum over ``occlusion``, everywhere or at ``at`` (..., 2).

        The sum depends on nine numbers, and not on the background's many coefficients: derivatives
        in any number of directions cost as much as nine. The sum is linear in the mask, so a change
        of the mask is summed as if it were a channel.
        """

        @jax.custom_jvp
        def value(numbers, open_, at):
            model = self._with_numbers(numbers)
            return model._sum_and_slopes(open_, at, method, False)[0]

        @functools.partial(value.defjvp, symbolic_zeros=True)
        def _(primals, tangents):
            (numbers, open_, at), (along, *others) = primals, tangents
            if not all(map(is_symbolic_zero, jax.tree.leaves(others))):
                raise ValueError("a disc's light pass is differentiable in its own numbers alone")
            model = self._with_numbers(numbers)
            out, by_shading, by_mask = model._sum_and_slopes(open_, at, method, True)
            d_out = jnp.tensordot(along[:SHADING_COUNT], by_shading, 1)
            return out, d_out + by_mask @ along[SCATTERING_COUNT:]

        return value(self._pass_numbers, open_, at)

    @abstractmethod
    def _sum_and_slopes(self, open_, at, method, slopes) -> tuple[Array, ...]:
        """The sum, and with ``slopes`` its derivatives: by scattering and light with the mask held
        fixed (6, ...), and by light and shape through the mask (..., 5)."""

    def _sum_over_mask(self, open_, at, method, slopes) -> tuple[Array, ...]:
        """``_sum_and_slopes`` with a whole mask for the value and for every derivative."""
        mask = self.occlusion(open_)

        def over_mask(numbers):
            return self._shading_with(numbers).light_pass(mask, at, method)

        if not slopes:
            return (self.shading.light_pass(mask, at, method),)
        out, by_shading = value_and_derivatives(over_mask, self._pass_numbers[:SHADING_COUNT])
        changes = self.occlusion_slopes(open_, DERIVATIVE_EDGE)
        by_mask = [self.shading.light_pass(change, at, method) for change in changes]
        return out, by_shading, jnp.stack(by_mask, -1)

    @property
    def _pass_numbers(self) -> Float[Array, " 9"]:
        """Scattering, light and shape: all numbers that the light pass depends on."""
        return jnp.stack([*self.shading.values().values(), *self.shape])

    def _with_numbers(self: Model, numbers: Float[Array, " 9"]) -> Model:
        """This model with scattering, light and shape from ``numbers``."""
        shading = self._shading_with(numbers[:SHADING_COUNT])
        at = (shading, numbers[SHADING_COUNT:])
        return eqx.tree_at(lambda m: (m.shading, m.shape), self, at)

    def _shading_with(self, numbers: Float[Array, " 6"]) -> Mitchell:
        """The shading with scattering and light from ``numbers``."""
        return eqx.tree_at(
            lambda m: (m.exposure, m.decay, m.density, m.weight, m.light),
            self.shading,
            (*numbers[:SCATTERING_COUNT], numbers[SCATTERING_COUNT:].reshape(1, 2)),
        )


def value_and_derivatives(function, numbers):
    """``function(numbers)`` and its derivatives, (numbers, ...), by forward mode."""
    unit = jnp.eye(numbers.shape[0], dtype=numbers.dtype)
    move = functools.partial(jax.jvp, function, (numbers,))
    return jax.vmap(move, out_axes=(None, 0))((unit,))

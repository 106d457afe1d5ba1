"""A picture that comes with nothing: a disc light on a veil, what stands before them, a background.

The occlusion mask is open * (veil + (1 - veil) disc): the light is a disc with a soft edge; the
veil is what the mask is cleared to; ``open`` is 0 where something stands in the way. Light and veil
are white, or of one colour. The background is a polynomial of the place, of so low a degree as will
do, linear in its coefficients.
"""

from __future__ import annotations

import functools
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from godfit.models.base import FAINTEST, AbstractModel, Vector
from godfit.models.disc_mask import from_light, occluded, occluded_slopes
from godfit.models.mitchell import Mitchell
from godfit.models.tinted import TINT
from godfit.runtime.device import on_device
from godfit.scattering.parameters import SCATTERING, Parameter, light_parameters
from godfit.scattering.radial.coordinates import to_pixels
from godfit.scattering.radial.derivatives import (
    RayParameters,
    is_symbolic_zero,
    partial_derivatives,
)
from godfit.scattering.radial.exact import fastest
from godfit.scattering.taps import Convention, Count, Taps, number_of
from godfit.scattering.upsample import Texels, at_pixels

try:
    from godfit.models.disc_kernel import disc_pass
except ImportError:
    # Without numba, of which the sums themselves warn.
    disc_pass = None

SHAPE = (
    Parameter("radius", "R", "of the height", 0.0, np.inf, "of the light's disc"),
    Parameter("edge", "s", "of the height", 0.0, np.inf, "width of the disc's soft edge"),
    Parameter("veil", "c", "1", 0.0, 1.0, "what the mask is cleared to; the light is 1"),
)
FIRST = len(SCATTERING) + 2 + len(SHAPE)
# Coordinates: attenuation, density, what the disc adds, light, radius, edge, what the veil adds.
KAPPA, DENSITY, GAIN, LIGHT_X, LIGHT_Y, RADIUS, EDGE, VEIL = range(1, 9)
CHANNELS = "rgb"
# As dark as a veil that is seen may be.
DARK = 0.01
# Least value of a constant background: a window whose colours are managed takes black to below it.
DARKEST = -0.05
# Texels that a disc's edge is wide, least, in derivatives: a harder one steps from texel to texel.
SOFT = 0.3
# Texels from the middle of one that is cut by a disc's edge to that edge, most.
RIM = 1.0
# Powers of x and y, each from -1 to 1 over the picture, in order of degree.
POWERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))
TERMS = {0: 1, 1: 3, 2: 6, 3: 10}


def powers(x, y, count: int) -> list:
    """The first ``count`` powers of places ``x`` and ``y``, from -1 to 1, of any one shape."""
    return [x**i * y**j for i, j in POWERS[:count]]


def terms(
    pixels: Int[Array | np.ndarray, " n"], size: tuple[int, int], count: int
) -> Float[Array | np.ndarray, "n k"]:
    """The first ``count`` powers of the place at row-major ``pixels`` of a picture of ``size``, by
    the library that these are of: NumPy compiles nothing for how many there are."""
    h, w = size
    x, y = 2 * (pixels % w + 0.5) / w - 1, 1 - 2 * (pixels // w + 0.5) / h
    return pixels.__array_namespace__().stack(powers(x, y, count), -1)


class DiscLight(AbstractModel):
    """Mitchell's sum over the mask of a disc light, on a background.

    ``shading`` holds the scattering and the light's place; ``shape`` (3,) is radius and edge, in
    picture heights, and veil; ``background`` (k, c) holds linear values at the middle of the
    picture and coefficients of ``terms``; ``tint`` (2,) is red and blue of the light against green,
    (0,) if it is white; texels that the disc's edge crosses are ``cut`` into so many parts a side,
    each of which is in or out, as a renderer does that draws without anti-aliasing and scales down.
    Coordinates are Mitchell's and then these numbers, but that for gain and
    veil stand gain (1 - veil) and gain veil: the picture is linear in what the disc and the veil
    add, while gain and veil trade in a bent valley.
    """

    name: ClassVar[str] = Mitchell.name
    held_last: ClassVar[str] = Mitchell.held_last
    product: ClassVar[tuple[str, str]] = Mitchell.product
    banded: ClassVar[bool] = False
    channels: ClassVar[int] = 1
    # Of ``shape``.
    rows: ClassVar[tuple[Parameter, ...]] = SHAPE
    # Whether the mask is a disc's, which ``disc_pass`` sums.
    is_disc: ClassVar[bool] = True

    shading: Mitchell
    shape: Float[Array, " 3"]
    background: Float[Array, "k c"]
    tint: Float[Array, " t"]
    cut: int = eqx.field(static=True)

    def __init__(self, shading, shape, background, tint=(), cut=1):
        self.shading = shading
        self.shape = on_device(shape, float)
        self.background = jnp.atleast_2d(on_device(background, float))
        self.tint = on_device(tint, float)
        self.cut = cut

    @property
    def colour(self) -> Float[Array, " c"]:
        """The light's, by channel."""
        if not self.tint.size:
            return jnp.ones(self.background.shape[1], self.tint.dtype)
        return jnp.stack([self.tint[0], jnp.ones_like(self.tint[0]), self.tint[1]])

    @property
    def settings(self) -> dict[str, str | int | float]:
        return self.shading.settings

    @property
    def convention(self) -> Convention:
        return self.shading.convention

    @property
    def samples(self) -> Count:
        return self.shading.samples

    @property
    def light(self) -> Float[Array, "1 2"]:
        return self.shading.light

    @property
    def taps(self) -> tuple[Taps, ...]:
        return self.shading.taps

    @property
    def used(self) -> np.ndarray:
        rest = np.ones(len(self.parameters) - 6, bool)
        return np.concatenate([self.shading.used, rest])

    @property
    def darkest(self) -> float:
        """Least value of a background that is constant. A field is but approached by its terms,
        and the way there may lead through the dark."""
        return DARKEST if len(self.background) == 1 else -np.inf

    @property
    def parameters(self) -> dict[str, Parameter]:
        rows = [*SCATTERING, *light_parameters(1), *self.rows]
        k, c = self.background.shape
        for i, j in POWERS[:k]:
            place = "x" * i + "y" * j
            for channel in CHANNELS if c == 3 else ("",):
                name = "_".join(filter(None, ("background", channel, place)))
                rows.append(Parameter(name, "", "1", self.darkest, np.inf, "of the ordinary pass"))
        rows += TINT[: self.tint.size]
        return {row.name: row for row in rows}

    @property
    def defaults(self) -> dict[str, float]:
        return dict(self.shading.defaults) | {"veil": 0.0}

    def values(self) -> dict[str, Float[Array, ""]]:
        numbers = [
            *self.shading.values().values(), *self.shape, *self.background.reshape(-1), *self.tint
        ]  # fmt: skip
        return dict(zip(self.parameters, numbers, strict=True))

    def coordinates(self) -> Float[Array, " p"]:
        scattering, (radius, edge, veil) = self.shading.coordinates(), self.shape
        gain = scattering[GAIN]
        scattering = scattering.at[GAIN].set(gain * (1 - veil))
        shape = jnp.stack([radius, edge, gain * veil])
        return jnp.concatenate([scattering, shape, self.background.reshape(-1), self.tint])

    def moved(self, coordinates: Vector, held: Vector | None = None) -> DiscLight:
        coordinates = jnp.asarray(coordinates)
        if held is None:
            held = jnp.full_like(coordinates, jnp.nan)
        free = jnp.isnan(jnp.asarray(held))
        disc, veiled = coordinates[GAIN], coordinates[VEIL]
        gain = jnp.where(
            free[VEIL], disc + veiled, disc / (1 - jnp.where(free[VEIL], 0, held[VEIL]))
        )
        shading = self.shading.moved(jnp.asarray(coordinates[:6]).at[GAIN].set(gain), held[:6])
        # A weight that is held says what the gain is.
        gain = jnp.where(free[GAIN], gain, shading.coordinates()[GAIN])
        # The square of what is next to nothing is nothing, and a derivative over it is none.
        veil = veiled / jnp.where(gain > FAINTEST, gain, 1.0)
        # Not clipped: where there is no disc, what one adds takes from the veil's share.
        veil = jnp.where(veil > 1, 1.0, jnp.maximum(veil, 0.0))
        rest = jnp.where(free[6:], coordinates[6:], held[6:])
        shape = rest[:3].at[2].set(jnp.where(free[VEIL], veil, held[VEIL]))
        background, tint = jnp.split(rest[3:], [self.background.size])
        at = (shading, shape, background.reshape(self.background.shape), tint)
        return eqx.tree_at(lambda m: (m.shading, m.shape, m.background, m.tint), self, at)

    def bounds(self) -> tuple[list[float], list[float]]:
        lower, upper = self.shading.bounds()
        count, tint = self.background.size, self.tint.size
        inf = float("inf")
        lower = [*lower, 1e-3, 1e-6, 0.0, *[self.darkest] * count, *[0.0] * tint]
        return lower, [*upper, 2.0, 0.5, inf, *[inf] * (count + tint)]

    def linear(self) -> np.ndarray:
        index = np.arange(FIRST + self.background.size + self.tint.size)
        return (index == 0) | (index >= FIRST) & (index < FIRST + self.background.size)

    def scales(self, coordinates: np.ndarray) -> np.ndarray:
        rest = np.full(len(coordinates) - 6, 0.02, np.float32)
        rest[:2] = np.maximum(0.2 * np.abs(coordinates[6:8]), (0.01, 2e-3))
        rest[2] = 0.1 * np.abs(coordinates[VEIL]) + 1e-3
        return np.concatenate([self.shading.scales(coordinates[:6]), rest])

    def ranges(self, coordinates: np.ndarray) -> np.ndarray:
        rest = np.full(len(coordinates) - 6, 0.3)
        rest[:3] = 0.2, 0.01, max(coordinates[VEIL], 0.05)
        scattering = self.shading.ranges(coordinates[:6])
        # What a disc out of sight would add is told by its veil alone, and by how dark veils are.
        scattering[GAIN] = max(scattering[GAIN], coordinates[VEIL] / DARK)
        return np.concatenate([scattering, rest])

    def occlusion(self, open_: Float[Array, "h w"], least: float = 0.0) -> Float[Array, "h w"]:
        """The mask that the light pass reads, with the disc's edge at ``least`` so wide, in
        texels. What is more than open, at the disc's rim, is as bright as the disc at most."""
        return occluded(self.light[0], self.shape, open_, least, self.cut)

    def occlusion_slopes(
        self, open_: Float[Array, "h w"], least: float
    ) -> list[Float[Array, "h w"]]:
        """The five derivatives of ``occlusion`` by the light's place and ``shape``, of texels that
        are not cut, the edge at ``least`` so wide."""
        return occluded_slopes(self.light[0], self.shape, open_, least)

    def away(self, size: tuple[int, int]) -> Float[Array, "h w"]:
        """How far from the light texels are, in picture heights."""
        return from_light(self.light[0], size)[2]

    def rim(self, size: tuple[int, int]) -> Bool[Array, "h w"]:
        """Texels that the disc's edge may cut."""
        return jnp.abs(self.away(size) - self.shape[0]) < RIM / size[0]

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
        """See ``Mitchell``; ``mask`` (h, w) is what of the picture is open."""
        light = self.light_pass(mask, size=size, pixels=pixels, texels=texels, method=method)
        return self.composite(light, size or (mask.shape[0], mask.shape[1]), pixels)

    def light_pass(self, mask, *, size=None, pixels=None, texels=None, method="auto"):
        """The light pass alone, (h, w) or (n,)."""
        scattered = functools.partial(self._scattered, method=method)
        return at_pixels(scattered, mask, size, pixels, texels)

    def _scattered(self, open_, at=None, method="auto"):
        """The sum over ``occlusion``, everywhere or at ``at`` (..., 2).

        Derivatives by any number of directions cost one by the nine numbers that it depends on: the
        background's coefficients, many, do not change it. It is linear in the mask, so that what
        these numbers change there is summed as if it were channels.
        """

        @jax.custom_jvp
        def value(numbers, open_, at):
            here = self._with(numbers)
            return here._summed(open_, at, method, False)[0]

        @functools.partial(value.defjvp, symbolic_zeros=True)
        def _(primals, tangents):
            (numbers, open_, at), (along, *others) = primals, tangents
            if not all(map(is_symbolic_zero, jax.tree.leaves(others))):
                raise ValueError("a disc's light pass is differentiable in its own numbers alone")
            out, by_first, by_rest = self._with(numbers)._summed(open_, at, method, True)
            d_out = jnp.tensordot(along[:6], by_first, 1)
            return out, d_out + by_rest @ along[4:]

        return value(self._numbers, open_, at)

    def _summed(self, open_, at, method, slopes) -> tuple[Array, ...]:
        """The sum, and with ``slopes`` its derivatives by scattering and light, the mask left as it
        is, (6, ...), and by what changes in the mask (..., 5)."""
        (taps,) = self.taps
        in_one = self.is_disc and disc_pass is not None
        if at is not None and in_one and method == "auto" and fastest(taps) == "strips":
            return self._in_one(open_, at, slopes)
        return self._of_the_whole(open_, at, method, slopes)

    def _of_the_whole(self, open_, at, method, slopes):
        """See ``_summed``: a mask for everything."""
        still = self.occlusion(open_)

        def under_it(first):
            return self._lit_by(first).light_pass(still, at, method)

        if not slopes:
            return (self.shading.light_pass(still, at, method),)
        out, by_first = _jacobian(under_it, self._numbers[:6])
        changes = self.occlusion_slopes(open_, SOFT)
        by_rest = [self.shading.light_pass(by, at, method) for by in changes]
        return out, by_first, jnp.stack(by_rest, -1)

    def _in_one(self, open_, at, slopes):
        """See ``_summed``: no mask but what is open."""
        assert disc_pass is not None
        size, dtype = open_.shape, open_.dtype

        def taps_of(shader):
            (taps,) = self._lit_by(jnp.concatenate([shader, self._numbers[4:6]])).taps
            return jnp.stack(
                [jnp.asarray(z, dtype) for z in (taps.own, taps.first, taps.ratio, taps.step)]
            )

        (taps,), shader = self.taps, self._numbers[:4]
        own, first, ratio, step = taps_of(shader)
        numbers = RayParameters(
            *to_pixels(self.light[0].astype(dtype), *size), ratio, step, jnp.asarray(taps.lag)
        )
        where = at.reshape(-1, 2).T.astype(dtype)
        lit = disc_pass(
            open_, where, numbers, self.shape.astype(dtype), number_of(taps), self.cut, SOFT, slopes
        )
        out = (own * lit.itself + first * lit.sums[0]).reshape(at.shape[:-1])
        if not slopes:
            return (out,)
        by = partial_derivatives(lit.itself, lit.sums, first, numbers, size, at)
        by_shader = _jacobian(taps_of, shader)[1] @ jnp.stack(by[:4])
        by_first = jnp.concatenate([by_shader, jnp.stack(by[4:])])
        by_rest = own * lit.itself_by + first * lit.sum_by
        return out, by_first.reshape(-1, *out.shape), by_rest.T.reshape(*out.shape, -1)

    def cut_into(self, parts: int) -> DiscLight:
        """The same with texels ``cut`` otherwise."""
        return DiscLight(self.shading, self.shape, self.background, self.tint, parts)

    @property
    def _numbers(self) -> Float[Array, " 9"]:
        """Scattering, light and shape: all that the light pass depends on."""
        return jnp.stack([*self.shading.values().values(), *self.shape])

    def _with(self, numbers: Float[Array, " 9"]) -> DiscLight:
        """The same with scattering, light and shape from ``numbers``."""
        shading = self._lit_by(numbers[:6])
        return eqx.tree_at(lambda m: (m.shading, m.shape), self, (shading, numbers[6:]))

    def _lit_by(self, numbers: Float[Array, " 6"]) -> Mitchell:
        """Scattering and light from ``numbers``."""
        return eqx.tree_at(
            lambda m: (m.exposure, m.decay, m.density, m.weight, m.light),
            self.shading,
            (*numbers[:4], numbers[4:].reshape(1, 2)),
        )

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


def _jacobian(function, numbers):
    """``function(numbers)`` and its derivatives, (numbers, ...)."""
    unit = jnp.eye(numbers.shape[0], dtype=numbers.dtype)
    move = functools.partial(jax.jvp, function, (numbers,))
    return jax.vmap(move, out_axes=(None, 0))((unit,))

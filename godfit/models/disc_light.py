"""A bare picture whose light is a disc with a soft edge, on a veil.

The occlusion mask is open * (veil + (1 - veil) disc). The veil is the value that the mask is
cleared to, and ``open_`` is 0 where an object occludes light and veil.
"""

from __future__ import annotations

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.models.bare_picture import (
    DERIVATIVE_EDGE,
    AbstractBarePicture,
    value_and_derivatives,
)
from godfit.models.coordinates import RADIUS, SCATTERING_COUNT, SHADING_COUNT, VEIL
from godfit.models.disc_mask import occluded, occluded_slopes
from godfit.models.mitchell import Mitchell
from godfit.runtime.device import on_device
from godfit.scattering.parameters import Parameter
from godfit.scattering.radial.coordinates import to_pixels
from godfit.scattering.radial.derivatives import (
    RayParameters,
    partial_derivatives,
)
from godfit.scattering.radial.exact import fastest
from godfit.scattering.taps import number_of

try:
    from godfit.models.disc_pass import DiscShape, disc_pass
except ImportError:
    # Without numba. ``radial.exact`` warns of that.
    disc_pass = None

MIN_RADIUS = 1e-3
"""Least radius of a disc, in picture heights: about a pixel of a large picture."""
MAX_RADIUS = 2.0
"""Largest radius of a disc, in picture heights: it covers the whole picture."""
MIN_EDGE = 1e-6
"""Least width of a disc's edge, in picture heights: a hard edge, by which nothing is divided by
0."""
MAX_EDGE = 0.5
"""Largest width of a disc's edge, in picture heights: a wider one is a glow without an edge."""


class DiscLight(AbstractBarePicture):
    """Mitchell's sum over the mask of a disc light, on a background.

    ``shape`` (3,) is radius and edge width, in picture heights, and veil. Texels that the disc's
    edge crosses are ``cut`` into that many parts a side, each of which is inside or outside: as a
    renderer without anti-aliasing computes them, whose mask is scaled down.
    """

    shape_parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("radius", "R", "of the height", 0.0, np.inf, "of the light's disc"),
        Parameter("edge", "s", "of the height", 0.0, np.inf, "width of the disc's soft edge"),
        Parameter("veil", "c", "1", 0.0, 1.0, "the value that the mask is cleared to"),
    )

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
    def shape_used(self) -> list[bool]:
        return [True, True, True]

    @property
    def defaults(self) -> dict[str, float]:
        return dict(self.shading.defaults) | {"veil": 0.0}

    def shape_bounds(self) -> tuple[list[float], list[float]]:
        return [MIN_RADIUS, MIN_EDGE, 0.0], [MAX_RADIUS, MAX_EDGE, float("inf")]

    def shape_scales(self, coordinates: np.ndarray) -> np.ndarray:
        scales = np.maximum(0.2 * np.abs(coordinates[RADIUS:VEIL]), (0.01, 2e-3))
        return scales.astype(np.float32)

    def shape_ranges(self) -> tuple[float, float]:
        return 0.2, 0.01

    def occlusion(self, open_: Float[Array, "h w"], least: float = 0.0) -> Float[Array, "h w"]:
        """The mask that the light pass reads, with the disc's edge at ``least`` so wide, in texels.
        Where ``open_`` is above 1, at the disc's rim, the mask is at most 1."""
        return occluded(self.light[0], self.shape, open_, least, self.cut)

    def occlusion_slopes(
        self, open_: Float[Array, "h w"], least: float
    ) -> list[Float[Array, "h w"]]:
        """The five derivatives of ``occlusion`` without cut texels, by the light's place and by
        ``shape``."""
        return occluded_slopes(self.light[0], self.shape, open_, least)

    def _sum_and_slopes(self, open_, at, method, slopes) -> tuple[Array, ...]:
        (taps,) = self.taps
        compiled = disc_pass is not None and fastest(taps) == "strips"
        if at is not None and method == "auto" and compiled:
            return self._sum_by_kernel(open_, at, slopes)
        return self._sum_over_mask(open_, at, method, slopes)

    def _sum_by_kernel(self, open_, at, slopes) -> tuple[Array, ...]:
        """``_sum_and_slopes`` at the points ``at`` in one compiled call, without a mask but the
        open one."""
        assert disc_pass is not None
        size, dtype = open_.shape, open_.dtype

        def tap_numbers(scattering):
            light = self._pass_numbers[SCATTERING_COUNT:SHADING_COUNT]
            (taps,) = self._shading_with(jnp.concatenate([scattering, light])).taps
            return jnp.stack(
                [jnp.asarray(z, dtype) for z in (taps.own, taps.first, taps.ratio, taps.step)]
            )

        (taps,), scattering = self.taps, self._pass_numbers[:SCATTERING_COUNT]
        own, first, ratio, step = tap_numbers(scattering)
        numbers = RayParameters(
            *to_pixels(self.light[0].astype(dtype), *size), ratio, step, jnp.asarray(taps.lag)
        )
        points = at.reshape(-1, 2).T.astype(dtype)
        disc = DiscShape(self.shape.astype(dtype), self.cut, DERIVATIVE_EDGE)
        lit = disc_pass(open_, points, numbers, number_of(taps), disc, slopes)
        out = (own * lit.itself + first * lit.sums[0]).reshape(at.shape[:-1])
        if not slopes:
            return (out,)
        by = partial_derivatives(lit.itself, lit.sums, first, numbers, size, at)
        by_scattering = value_and_derivatives(tap_numbers, scattering)[1] @ jnp.stack(by[:4])
        by_shading = jnp.concatenate([by_scattering, jnp.stack(by[4:])])
        by_mask = own * lit.itself_by + first * lit.sum_by
        return out, by_shading.reshape(-1, *out.shape), by_mask.T.reshape(*out.shape, -1)

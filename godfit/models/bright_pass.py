"""A photograph: its brightest parts are the light, on a smooth background.

The occlusion mask is a soft bright pass of the picture's own brightness, as post effects without a
scene compute it. The mask ``open_`` of a bare picture is here the brightness of the picture.
"""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.models.bare_picture import AbstractBarePicture
from godfit.models.coordinates import SOFTNESS
from godfit.models.mitchell import Mitchell
from godfit.runtime.device import on_device
from godfit.scattering.parameters import Parameter

LUMA = (0.2126, 0.7152, 0.0722)
"""Red, green and blue in luma: Rec. ITU-R BT.709-6 (2015), item 3.2."""
MIN_SOFTNESS = 1 / 255
"""Least softness of a bright pass: one 8-bit level, the step of the picture."""
MAX_SOFTNESS = 0.15
"""Largest softness of a bright pass: a softer one lets the dark parts of the picture through."""


def brightness(image: np.ndarray) -> np.ndarray:
    """(h, w) luma of an image (h, w, c)."""
    return image[..., 0] if image.shape[-1] == 1 else image @ np.array(LUMA, image.dtype)


class BrightPass(AbstractBarePicture):
    """Mitchell's sum over a soft bright pass of the picture.

    ``shape`` (3,) is the threshold and the softness, both a brightness, and the mask's value where
    the picture is dark. The threshold is at ``least`` the brightness at which the dark part of the
    picture ends: a mask that is open everywhere adds little but another background.
    """

    shape_parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("threshold", "b", "1", 0.0, 1.0, "brightness at which the mask is half open"),
        Parameter("softness", "s", "1", 0.0, 1.0, "width of the bright pass, a sigmoid"),
        Parameter("dark", "c", "1", 0.0, 1.0, "the mask's value where the picture is dark"),
    )

    shading: Mitchell
    shape: Float[Array, " 3"]
    background: Float[Array, "k c"]
    tint: Float[Array, " t"]
    least: Float[Array, ""]

    def __init__(self, shading, shape, background, least=0.0):
        self.shading = shading
        self.shape = on_device(shape, float)
        self.background = jnp.atleast_2d(on_device(background, float))
        self.tint = on_device((), float)
        self.least = on_device(least, float)

    @property
    def shape_used(self) -> list[bool]:
        # A light from all dark parts of the picture would be little but another background.
        return [True, True, False]

    @property
    def defaults(self) -> dict[str, float]:
        return dict(self.shading.defaults)

    def shape_bounds(self) -> tuple[list[float], list[float]]:
        return [float(self.least), MIN_SOFTNESS, 0.0], [1.0, MAX_SOFTNESS, 0.0]

    def shape_scales(self, coordinates: np.ndarray) -> np.ndarray:
        return np.array([0.02, 0.2 * abs(coordinates[SOFTNESS]) + 2e-3])

    def shape_ranges(self) -> tuple[float, float]:
        return 0.3, 0.1

    def occlusion(self, open_: Float[Array, "h w"], least: float = 0.0) -> Float[Array, "h w"]:
        """The bright pass of a picture of brightness ``open_``. It has no edge, and ``least`` no
        effect."""
        threshold, softness, dark = self.shape
        return dark + (1 - dark) * jax.nn.sigmoid((open_ - threshold) / softness)

    def occlusion_slopes(
        self, open_: Float[Array, "h w"], least: float
    ) -> list[Float[Array, "h w"]]:
        """The five derivatives of ``occlusion``, of which those by the light's place are zero."""
        threshold, softness, dark = self.shape
        away = (open_ - threshold) / softness
        passed, none = jax.nn.sigmoid(away), jnp.zeros_like(open_)
        by_threshold = -(1 - dark) * passed * (1 - passed) / softness
        return [none, none, by_threshold, by_threshold * away, 1 - passed]

    def _sum_and_slopes(self, open_, at, method, slopes) -> tuple[Array, ...]:
        return self._sum_over_mask(open_, at, method, slopes)

"""A photograph: what is bright in it is the light, on a smooth background.

The occlusion mask is a soft bright-pass of the picture's own brightness, as post effects take it
that have no scene to draw it from. ``open`` of a disc light is here how bright the picture is.
"""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.models.disc_light import DiscLight
from godfit.runtime.device import on_device
from godfit.scattering.parameters import Parameter

# Rec. ITU-R BT.709-6 (2015), item 3.2: red, green and blue in luma.
LUMA = (0.2126, 0.7152, 0.0722)
# How soft a bright-pass may be: a level at least, and not so soft that it lets the dark through.
HARDEST, SOFTEST = 1 / 255, 0.15
THRESHOLD, SOFTNESS, DARK = 6, 7, 8


def brightness(image: np.ndarray) -> np.ndarray:
    """(h, w) luma of an image (h, w, c)."""
    return image[..., 0] if image.shape[-1] == 1 else image @ np.array(LUMA, image.dtype)


class BrightPass(DiscLight):
    """Mitchell's sum over a soft bright-pass of the picture.

    ``shape`` (3,) is threshold and softness, of brightness, and what the mask is where the picture
    is dark; the threshold is at ``least`` where what is dark ends, as what all of the picture adds
    is all but another background. The rest, the coordinates among them, is as ``DiscLight`` has it.
    """

    rows: ClassVar[tuple[Parameter, ...]] = (
        Parameter("threshold", "b", "1", 0.0, 1.0, "brightness that is half let through"),
        Parameter("softness", "s", "1", 0.0, 1.0, "of the bright-pass, a sigmoid"),
        Parameter("dark", "c", "1", 0.0, 1.0, "what the mask is where the picture is dark"),
    )

    is_disc: ClassVar[bool] = False

    least: Float[Array, ""]

    def __init__(self, shading, shape, background, least=0.0):
        super().__init__(shading, shape, background)
        self.least = on_device(least, float)

    @property
    def used(self) -> np.ndarray:
        # What is let through of the dark is nothing: it would be all but another background.
        return super().used & (np.arange(len(self.parameters)) != DARK)

    @property
    def defaults(self) -> dict[str, float]:
        return dict(self.shading.defaults)

    def bounds(self) -> tuple[list[float], list[float]]:
        lower, upper = super().bounds()
        lower[THRESHOLD : DARK + 1] = float(self.least), HARDEST, 0.0
        upper[THRESHOLD : DARK + 1] = 1.0, SOFTEST, 0.0
        return lower, upper

    def scales(self, coordinates: np.ndarray) -> np.ndarray:
        scales = super().scales(coordinates)
        scales[THRESHOLD : SOFTNESS + 1] = 0.02, 0.2 * abs(coordinates[SOFTNESS]) + 2e-3
        return scales

    def ranges(self, coordinates: np.ndarray) -> np.ndarray:
        ranges = super().ranges(coordinates)
        ranges[THRESHOLD : SOFTNESS + 1] = 0.3, 0.1
        return ranges

    def occlusion(self, open_: Float[Array, "h w"], least: float = 0.0) -> Float[Array, "h w"]:
        """What is let through of a picture as bright as ``open_``."""
        threshold, softness, dark = self.shape
        return dark + (1 - dark) * jax.nn.sigmoid((open_ - threshold) / softness)

    def occlusion_slopes(
        self, open_: Float[Array, "h w"], least: float
    ) -> list[Float[Array, "h w"]]:
        """The five derivatives of ``occlusion`` by the light's place, of which there are none, and
        ``shape``."""
        threshold, softness, dark = self.shape
        away = (open_ - threshold) / softness
        passed, none = jax.nn.sigmoid(away), jnp.zeros_like(open_)
        by_threshold = -(1 - dark) * passed * (1 - passed) / softness
        return [none, none, by_threshold, by_threshold * away, 1 - passed]

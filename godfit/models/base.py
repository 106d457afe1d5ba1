"""What a model is: parameters and a mask in, an image out.

A model is a module whose fields are its parameters. A fit moves the vector of ``coordinates`` and
evaluates the image; it names no model.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from godfit.scattering.parameters import Parameter
from godfit.scattering.taps import Count
from godfit.scattering.upsample import Texels

# By coordinate or by parameter; what lives between two calls is kept as a numpy array.
Vector = Float[Array, " p"] | Float[np.ndarray, " p"]
# Exposures and gains that are none: derivatives divide by their squares.
FAINTEST = 1e-12
# By pixel and channel.
Values = Float[Array, " m"] | Float[np.ndarray, " m"]


class AbstractModel(eqx.Module):
    """What fit and report need to know of a model."""

    name: eqx.AbstractClassVar[str]
    # Coordinates are held where a picture leaves them open: this one last.
    held_last: eqx.AbstractClassVar[str]
    # Whether the mask is 1 where the sky is open, and 0 where anything hides it.
    mask_is_sky: ClassVar[bool] = False
    # (open, other): where the first is open and the other is not, only their product is known.
    product: eqx.AbstractClassVar[tuple[str, str]]
    # Whether the cost has a dip for every band that taps leave, see ``dips.py``.
    banded: eqx.AbstractClassVar[bool]
    # Channels that the image has whatever the mask has.
    channels: eqx.AbstractClassVar[int]
    samples: eqx.AbstractVar[Count]
    light: eqx.AbstractVar[Float[Array, "lights 2"]]

    @property
    @abstractmethod
    def settings(self) -> dict[str, str | int | float]:
        """What was given and not fitted, for reports: the shader and the like."""

    @property
    @abstractmethod
    def parameters(self) -> dict[str, Parameter]:
        """The table of this model's parameters, by name."""

    @property
    @abstractmethod
    def defaults(self) -> dict[str, float]:
        """What parameters are where nothing is said of them."""

    @property
    def used(self) -> np.ndarray:
        """(p,) False for parameters that say nothing here."""
        return np.ones(len(self.parameters), bool)

    @abstractmethod
    def values(self) -> dict[str, Float[Array, ""]]:
        """The parameters, by name, in the table's order."""

    @abstractmethod
    def coordinates(self) -> Float[Array, " p"]:
        """The point in fit coordinates, one for each parameter and in their order."""

    @abstractmethod
    def moved(self, coordinates: Vector, held: Vector | None = None) -> AbstractModel:
        """This model at another point. ``held`` holds parameters (not coordinates) at a value;
        NaN leaves them free."""

    @abstractmethod
    def bounds(self) -> tuple[list[float], list[float]]:
        """Lower and upper bounds of the coordinates."""

    @abstractmethod
    def linear(self) -> np.ndarray:
        """(p,) True for coordinates that the light pass is linear in."""

    @abstractmethod
    def scales(self, coordinates: np.ndarray) -> np.ndarray:
        """(p,) sizes that bring every coordinate's useful steps to order one. Unscaled,
        Levenberg-Marquardt needs several times the steps."""

    @abstractmethod
    def ranges(self, coordinates: np.ndarray) -> np.ndarray:
        """How far each coordinate could plausibly lie from where it is."""

    @abstractmethod
    def __call__(
        self,
        mask: Float[Array, "h w"] | Float[Array, "h w c"],
        background: Float[Array, "..."] | None = None,
        *,
        size: tuple[int, int] | None = None,
        pixels: Int[Array, " n"] | None = None,
        texels: Texels | None = None,
    ) -> Float[Array, "..."]:
        """The image; see ``Mitchell``."""

    def occlusion(self, mask: Float[Array, "h w"]) -> Float[Array, "h w"]:
        """The mask that the light pass reads where ``mask`` is what was given."""
        return mask

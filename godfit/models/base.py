"""The interface of a model: parameters and a mask in, an image out.

A model is a module whose fields are its parameters. A fit moves the vector of ``coordinates`` and
evaluates the image; it names no model.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from godfit.scattering.parameters import Parameter
from godfit.scattering.taps import Count, Taps
from godfit.scattering.upsample import Texels

Vector = Float[Array, " p"] | Float[np.ndarray, " p"]
"""A number for each coordinate, or for each parameter. Between two compiled calls it is a NumPy
array."""
Values = Float[Array, " m"] | Float[np.ndarray, " m"]
"""A number for each pixel and channel."""
FAINTEST = 1e-12
"""Exposure or gain up to which there is no light pass: derivatives divide by its square, which has
to be a float32."""


class AbstractModel(eqx.Module):
    """The part of a model that fit and report use."""

    name: eqx.AbstractClassVar[str]
    # The parameter that is held last, where a picture leaves several undetermined.
    held_last: eqx.AbstractClassVar[str]
    # Whether the mask is 1 where the sky is open, and 0 where anything hides it.
    mask_is_sky: ClassVar[bool] = False
    # (open, other): where the first is undetermined and the other is not, only the product of both
    # is known.
    product: eqx.AbstractClassVar[tuple[str, str]]
    # Whether taps leave bands in the image, each of which makes a local minimum of the cost.
    banded: eqx.AbstractClassVar[bool]
    # Least number of channels of the image, for a mask of one channel.
    channels: eqx.AbstractClassVar[int]
    samples: eqx.AbstractVar[Count]
    light: eqx.AbstractVar[Float[Array, "lights 2"]]

    @property
    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """The settings that are given and not fitted, for reports: the shader and the like."""

    @property
    @abstractmethod
    def parameters(self) -> dict[str, Parameter]:
        """The table of this model's parameters, by name."""

    @property
    @abstractmethod
    def defaults(self) -> dict[str, float]:
        """The values of parameters that are not given, by name."""

    @property
    def absent(self) -> dict[str, float]:
        """The values that stand for parameters that the formula lacks, by name: none."""
        return {}

    @property
    def used(self) -> np.ndarray:
        """(p,) False for parameters that have no effect here."""
        return np.ones(len(self.parameters), bool)

    @abstractmethod
    def values(self) -> dict[str, Float[Array, ""]]:
        """The values of the parameters, by name, in the table's order."""

    @abstractmethod
    def coordinates(self) -> Float[Array, " p"]:
        """The fit coordinates, one for each parameter and in their order."""

    @abstractmethod
    def moved(self, coordinates: Vector, held: Vector | None = None) -> AbstractModel:
        """This model at other coordinates. ``held`` holds parameters (not coordinates) at a value;
        NaN leaves a parameter free."""

    @abstractmethod
    def bounds(self) -> tuple[list[float], list[float]]:
        """Lower and upper bounds of the coordinates."""

    @abstractmethod
    def linear(self) -> np.ndarray:
        """(p,) True for coordinates that the light pass is linear in."""

    @abstractmethod
    def scales(self, coordinates: np.ndarray) -> np.ndarray:
        """(p,) the size of a useful step in every coordinate, to divide by. Without scales,
        Levenberg-Marquardt needs several times the steps."""

    @abstractmethod
    def ranges(self, coordinates: np.ndarray) -> np.ndarray:
        """(p,) the distance at which each coordinate could plausibly lie from its present value."""

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
        """The image; see ``Mitchell.__call__``."""

    def notes(self, free: Sequence[str]) -> tuple[str, ...]:
        """Notes on the values of the parameters ``free``, for reports: none."""
        return ()

    def flat(self, mask: Any) -> tuple[AbstractModel, Any]:
        """A model whose ``light`` is a field of its own, and the mask that its taps read: this
        one, and the mask that was given."""
        return self, mask

    @property
    def reads_between(self) -> bool:
        """Whether the light pass has the image's size where the mask is smaller, and reads the mask
        between its texels."""
        return False

    @property
    def jumps(self) -> bool:
        """Whether the image jumps where a coordinate moves: its derivative is then that of a mean
        over the jumps, and holds for no single level."""
        return False

    def on_copy(self, scale: float) -> AbstractModel:
        """This model on a copy of its images at ``scale``, whose pixels are larger."""
        return self

    @property
    def walk(self) -> Taps | None:
        """The taps to which a shader walks along the ray, None where there is no such walk."""
        return None

    def occlusion(self, mask: Float[Array, "h w"]) -> Float[Array, "h w"]:
        """The mask that the light pass reads, from the mask that was given: the same."""
        return mask

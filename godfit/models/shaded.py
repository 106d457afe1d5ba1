"""Models whose light pass is Mitchell's sum, with something around it."""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx

from godfit.models.base import AbstractModel
from godfit.models.mitchell import Mitchell
from godfit.scattering.conventions import Convention
from godfit.scattering.taps import Taps


class AbstractShaded(AbstractModel):
    """A model with an inner ``shading``, which holds the scattering, its shader and its settings.
    Coordinates begin with those of the shading."""

    held_last: ClassVar[str] = Mitchell.held_last
    product: ClassVar[tuple[str, str]] = Mitchell.product

    shading: eqx.AbstractVar[Mitchell]

    @property
    def convention(self) -> Convention:
        """The convention of the shading's shader."""
        return self.shading.convention

    @property
    def samples(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.shading.samples

    @property
    def settings(self) -> dict[str, Any]:
        return self.shading.settings

    @property
    def absent(self) -> dict[str, float]:
        return self.shading.absent

    @property
    def taps(self) -> tuple[Taps, ...]:
        """The taps of each pass of the shader."""
        return self.shading.taps

    @property
    def jumps(self) -> bool:
        return self.shading.jumps

    def on_copy(self, scale: float) -> AbstractShaded:
        return eqx.tree_at(lambda m: m.shading, self, self.shading.on_copy(scale))

    def with_pass(self, **settings: Any) -> AbstractShaded:
        """This model with other ``settings`` of its light pass: fields of ``Mitchell`` by name."""
        return eqx.tree_at(lambda m: m.shading, self, self.shading.with_pass(**settings))

    @property
    def reads_between(self) -> bool:
        return self.shading.full_size

    @property
    def walk(self) -> Taps | None:
        return self.shading.walk

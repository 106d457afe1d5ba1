"""Mitchell's sum over a scene's own mask: the light, the camera and the objects are fitted too.

The mask follows the scene through ``rasterise``. The light's place on the screen is the projection
of its place in the world, so that the rays and the shapes of a picture determine the same numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from godfit.models.base import Vector
from godfit.models.coordinates import EXPOSURE, GAIN, SCATTERING_COUNT
from godfit.models.mitchell import Mitchell
from godfit.models.shaded import AbstractShaded
from godfit.scattering.parameters import SCATTERING, Parameter
from godfit.scattering.upsample import Texels
from godfit.scenes.raster import on_screen, rasterise
from godfit.scenes.scene import Scene
from godfit.scenes.view import resized

MAX_OFFSET = 1.0
"""Largest offset of a vector, in its unit: what a picture shows does not move by more than the
picture's height, or turn by more than a radian."""
MAX_SIZE_OFFSET = 0.9
"""Largest offset of a size, in its own start: a size stays above a tenth of it."""


class Staged(AbstractShaded):
    """Mitchell's sum over the mask that a scene draws.

    ``shading`` holds exposure, decay, density and weight; its light is not used. ``scene`` is the
    start of the fit. ``offsets`` (g,) are the distances of the numbers named in ``free`` from the
    start, in units in which a picture's height, a radian or the start's own size is 1. Coordinates
    are the scattering coordinates of ``Mitchell``, then the offsets; parameters are in the scene's
    units.
    """

    name: ClassVar[str] = Mitchell.name
    banded: ClassVar[bool] = True
    channels: ClassVar[int] = 1

    shading: Mitchell
    scene: Scene
    offsets: Float[Array, " g"]
    free: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, shading, scene, free, offsets=None):
        # The mask follows the scene, and its derivative needs a known number of taps.
        known = eqx.tree_at(lambda m: m.samples, shading, int(shading.samples))
        self.shading, self.scene, self.free = known, scene, tuple(free)
        count = sum(scene.value(name).size for name in self.free)
        self.offsets = jnp.zeros(count) if offsets is None else offsets

    @property
    def used(self) -> np.ndarray:
        scattering = self.shading.used[:SCATTERING_COUNT]
        return np.concatenate([scattering, np.ones(self.offsets.size, bool)])

    @property
    def light(self) -> Float[Array, "1 2"]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return on_screen(self.staged())[None]

    @property
    def parameters(self) -> dict[str, Parameter]:
        rows = list(SCATTERING)
        for name in self.free:
            axes = [".x", ".y", ".z"] if self.scene.value(name).ndim else [""]
            lower = 0.0 if name.endswith(("radius", "scale", "fov_y")) else -np.inf
            unit = "degrees" if name.endswith(("rotation", "fov_y")) else "of the scene"
            rows += [Parameter(name + a, "", unit, lower, np.inf, name) for a in axes]
        return {row.name: row for row in rows}

    @property
    def defaults(self) -> dict[str, float]:
        geometry = list(self.parameters)[SCATTERING_COUNT:]
        start = map(float, self._start())
        return dict(self.shading.defaults) | dict(zip(geometry, start, strict=True))

    def values(self) -> dict[str, Float[Array, ""]]:
        scattering = list(self.shading.values().values())[:SCATTERING_COUNT]
        numbers = [*scattering, *self._geometry()]
        return dict(zip(self.parameters, numbers, strict=True))

    def coordinates(self) -> Float[Array, " p"]:
        return jnp.concatenate([self.shading.coordinates()[:SCATTERING_COUNT], self.offsets])

    def moved(self, coordinates: Vector, held: Vector | None = None) -> Staged:
        if held is None:
            held = jnp.full_like(coordinates, jnp.nan)
        nowhere = jnp.full(2, jnp.nan, coordinates.dtype)
        light = self.shading.light.reshape(-1)[:2].astype(coordinates.dtype)
        shading = self.shading.moved(
            jnp.concatenate([coordinates[:SCATTERING_COUNT], light]),
            jnp.concatenate([held[:SCATTERING_COUNT], nowhere]),
        )
        geometry = held[SCATTERING_COUNT:]
        offsets = jnp.where(
            jnp.isnan(geometry),
            self._across_view(jnp.asarray(coordinates[SCATTERING_COUNT:])),
            (geometry - self._start()) / self._units(),
        )
        return eqx.tree_at(lambda m: (m.shading, m.offsets), self, (shading, offsets))

    def bounds(self) -> tuple[list[float], list[float]]:
        lower, upper = self.shading.bounds()
        reach = [
            MAX_SIZE_OFFSET if self.scene.value(name).ndim == 0 else MAX_OFFSET
            for name in self.free
            for _ in range(self.scene.value(name).size)
        ]
        lower, upper = lower[:SCATTERING_COUNT], upper[:SCATTERING_COUNT]
        return lower + [-r for r in reach], upper + reach

    def linear(self) -> np.ndarray:
        return np.isin(np.arange(SCATTERING_COUNT + self.offsets.size), (EXPOSURE, GAIN))

    def scales(self, coordinates: np.ndarray) -> np.ndarray:
        return self.shading.scales(coordinates)

    def ranges(self, coordinates: np.ndarray) -> np.ndarray:
        scattering, light = coordinates[:SCATTERING_COUNT], np.zeros(2)
        known = self.shading.ranges(np.concatenate([scattering, light]))[:SCATTERING_COUNT]
        return np.concatenate([known, np.full(len(coordinates) - SCATTERING_COUNT, 0.5)])

    def notes(self, free: Sequence[str]) -> tuple[str, ...]:
        return self.shading.notes(free)

    def staged(self) -> Scene:
        """The scene with this model's numbers."""
        numbers, at = self._geometry(), 0
        values = {}
        for name in self.free:
            start = self.scene.value(name)
            values[name] = numbers[at : at + start.size].reshape(start.shape)
            at += start.size
        return self.scene.replaced(values)

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
        """The image; see ``Mitchell.__call__``. Only the shape of ``mask`` counts: the scene is
        drawn at that size."""
        lit, drawn = self.flat(mask)
        return lit(drawn, background, size=size, pixels=pixels, texels=texels, method=method)

    def flat(self, mask: Float[Array, "h w"] | Float[Array, "h w c"]) -> tuple[Mitchell, Any]:
        lit = eqx.tree_at(lambda m: m.light, self.shading, self.light)
        return lit, self.occlusion(mask)

    def occlusion(self, mask: Float[Array, "h w"]) -> Float[Array, "h w"]:
        """The mask drawn from the scene, at the size of ``mask``."""
        drawn = rasterise(resized(self.staged(), (mask.shape[0], mask.shape[1])))
        # A light pass reads an 8-bit mask. The derivative is that of the mask before it is rounded.
        return drawn + jax.lax.stop_gradient(jnp.round(255 * drawn) / 255 - drawn)

    def _geometry(self) -> Float[Array, " g"]:
        """The free numbers of the scene, in its units."""
        return self._start() + self.offsets * self._units()

    def _across_view(self, offsets: Float[Array, " g"]) -> Float[Array, " g"]:
        """The offsets without the light's motion along the view, where position and radius of the
        light are both free: distance and radius trade exactly, and the light would drift until it
        touches the objects."""
        if not {"light.position", "light.radius"} <= set(self.free):
            return offsets
        first = sum(
            self.scene.value(n).size for n in self.free[: self.free.index("light.position")]
        )
        away = jax.lax.stop_gradient(self.scene.camera_axes()[2]).astype(offsets.dtype)
        return offsets.at[first : first + 3].add(-away * (away @ offsets[first : first + 3]))

    def _start(self) -> Float[Array, " g"]:
        """The free numbers of the scene at the start of the fit."""
        return jax.lax.stop_gradient(
            jnp.concatenate([self.scene.value(name).reshape(-1) for name in self.free])
        )

    def _units(self) -> Float[Array, " g"]:
        """The scene's units in an offset of 1, for each free number."""
        sizes = [
            jnp.broadcast_to(_unit(self.scene, name), self.scene.value(name).shape).reshape(-1)
            for name in self.free
        ]
        return jax.lax.stop_gradient(jnp.concatenate(sizes))


def _unit(scene: Scene, name: str) -> Float[Array, ""]:
    """The scene's units in an offset of 1 of the number ``name``: a picture's height at the
    number's distance for places, a radian for rotations, the number itself for sizes."""
    value, camera = scene.value(name), scene.camera
    height = 2 * jnp.tan(jnp.deg2rad(camera.fov_y) / 2)
    if name == "camera.position":
        return height * jnp.linalg.norm(camera.position - camera.target)
    if name.endswith(("position", "target")):
        return height * jnp.linalg.norm(value - camera.position)
    if name.endswith("rotation"):
        return jnp.asarray(180 / np.pi, value.dtype)
    return jnp.abs(value) if value.ndim == 0 else jnp.ones((), value.dtype)

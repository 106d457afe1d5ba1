"""A scene's own mask under Mitchell's sum: the light, the camera and the objects are fitted too.

The mask follows the scene through ``rasterise``, and the light's place on the screen is the
projection of its place in the world, so that a picture's rays and its shapes are read together.
"""

from __future__ import annotations

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from godfit.models.base import AbstractModel, Vector
from godfit.models.mitchell import Mitchell
from godfit.scattering.parameters import SCATTERING, Parameter
from godfit.scattering.taps import Convention, Count
from godfit.scattering.upsample import Texels
from godfit.scenes.raster import on_screen, rasterise
from godfit.scenes.scene import Scene
from godfit.scenes.view import resized


class Staged(AbstractModel):
    """Mitchell's sum over the mask that a scene draws.

    ``shading`` holds exposure, decay, density and weight (its light is not used); ``scene`` is
    where the fit starts; ``offsets`` (g,) says how far each number named in ``free`` has moved, in
    units that make a picture's height, a radian or the start's own size 1. Coordinates are the
    first four of ``Mitchell`` and the offsets; parameters are in the scene's units.
    """

    name: ClassVar[str] = Mitchell.name
    held_last: ClassVar[str] = Mitchell.held_last
    product: ClassVar[tuple[str, str]] = Mitchell.product
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
    def settings(self) -> dict[str, str | int | float]:
        return self.shading.settings

    @property
    def convention(self) -> Convention:
        return self.shading.convention

    @property
    def used(self) -> np.ndarray:
        return np.concatenate([self.shading.used[:4], np.ones(self.offsets.size, bool)])

    @property
    def samples(self) -> Count:
        return self.shading.samples

    @property
    def light(self) -> Float[Array, "1 2"]:
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
        geometry = list(self.parameters)[4:]
        start = map(float, self._base())
        return dict(self.shading.defaults) | dict(zip(geometry, start, strict=True))

    def values(self) -> dict[str, Float[Array, ""]]:
        four = list(self.shading.values().values())[:4]
        numbers = [*four, *(self._base() + self.offsets * self._units())]
        return dict(zip(self.parameters, numbers, strict=True))

    def coordinates(self) -> Float[Array, " p"]:
        return jnp.concatenate([self.shading.coordinates()[:4], self.offsets])

    def moved(self, coordinates: Vector, held: Vector | None = None) -> Staged:
        if held is None:
            held = jnp.full_like(coordinates, jnp.nan)
        nowhere = jnp.full(2, jnp.nan, coordinates.dtype)
        light = self.shading.light.reshape(-1)[:2].astype(coordinates.dtype)
        shading = self.shading.moved(
            jnp.concatenate([coordinates[:4], light]), jnp.concatenate([held[:4], nowhere])
        )
        offsets = jnp.where(
            jnp.isnan(held[4:]),
            self._across(jnp.asarray(coordinates[4:])),
            (held[4:] - self._base()) / self._units(),
        )
        return eqx.tree_at(lambda m: (m.shading, m.offsets), self, (shading, offsets))

    def bounds(self) -> tuple[list[float], list[float]]:
        lower, upper = self.shading.bounds()
        # What is looked for is in the picture: nothing moves by more than a picture's height.
        reach = [
            0.9 if self.scene.value(name).ndim == 0 else 1.0
            for name in self.free
            for _ in range(self.scene.value(name).size)
        ]
        return lower[:4] + [-r for r in reach], upper[:4] + reach

    def linear(self) -> np.ndarray:
        return np.isin(np.arange(4 + self.offsets.size), (0, 3))

    def scales(self, coordinates: np.ndarray) -> np.ndarray:
        return self.shading.scales(coordinates)

    def ranges(self, coordinates: np.ndarray) -> np.ndarray:
        known = self.shading.ranges(np.concatenate([coordinates[:4], np.zeros(2)]))[:4]
        return np.concatenate([known, np.full(len(coordinates) - 4, 0.5)])

    def staged(self) -> Scene:
        """The scene with its numbers where this model puts them."""
        numbers, at = self._base() + self.offsets * self._units(), 0
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
        """See ``Mitchell``. Of ``mask`` only the shape counts: the scene is drawn at that size."""
        scene = self.staged()
        drawn = rasterise(resized(scene, (mask.shape[0], mask.shape[1])))
        # A light pass reads bytes; the derivative is that of the mask before they were rounded.
        drawn = drawn + jax.lax.stop_gradient(jnp.round(255 * drawn) / 255 - drawn)
        lit = eqx.tree_at(lambda m: m.light, self.shading, on_screen(scene)[None])
        return lit(drawn, background, size=size, pixels=pixels, texels=texels, method=method)

    def _across(self, offsets: Float[Array, " g"]) -> Float[Array, " g"]:
        """A light's distance and radius trade exactly: where both are free it keeps the distance at
        which it starts, or it would drift until it touches the objects."""
        if not {"light.position", "light.radius"} <= set(self.free):
            return offsets
        first = sum(
            self.scene.value(n).size for n in self.free[: self.free.index("light.position")]
        )
        away = jax.lax.stop_gradient(self.scene.camera_axes()[2]).astype(offsets.dtype)
        return offsets.at[first : first + 3].add(-away * (away @ offsets[first : first + 3]))

    def _base(self) -> Float[Array, " g"]:
        return jax.lax.stop_gradient(
            jnp.concatenate([self.scene.value(name).reshape(-1) for name in self.free])
        )

    def _units(self) -> Float[Array, " g"]:
        sizes = [
            jnp.broadcast_to(_unit(self.scene, name), self.scene.value(name).shape).reshape(-1)
            for name in self.free
        ]
        return jax.lax.stop_gradient(jnp.concatenate(sizes))


def _unit(scene: Scene, name: str) -> Float[Array, ""]:
    """What a step of one means for a number of the scene."""
    value, camera = scene.value(name), scene.camera
    height = 2 * jnp.tan(jnp.deg2rad(camera.fov_y) / 2)
    if name == "camera.position":
        return height * jnp.linalg.norm(camera.position - camera.target)
    if name.endswith(("position", "target")):
        return height * jnp.linalg.norm(value - camera.position)
    if name.endswith("rotation"):
        return jnp.asarray(180 / np.pi, value.dtype)
    return jnp.abs(value) if value.ndim == 0 else jnp.ones((), value.dtype)

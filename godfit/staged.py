"""A scene's own mask under Mitchell's sum: the light, the camera and the objects are fitted too.

The mask follows the scene through ``rasterise``, and the light's place on the screen is the
projection of its place in the world, so that a picture's rays and its shapes are read together.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from godfit.models import AbstractModel, Mitchell, Vector
from godfit.observation import Picture
from godfit.parameters import SCATTERING, Parameter
from godfit.raster import on_screen, rasterise
from godfit.scene import Scene
from godfit.screen import starts
from godfit.solver import solve

# Longest side of the copies on which geometry is looked for, starts kept, sigma in levels.
LADDER = ((64, 4, 4.0), (128, 2, 2.0), (256, 1, 1.0))
# Placements tried at first, and how far (in picture heights) positions are moved in them.
PLACEMENTS, REACH = 96, 0.15


class Staged(AbstractModel):
    """Mitchell's sum over the mask that a scene draws.

    ``shading`` holds exposure, decay, density and weight (its light is not used); ``scene`` is
    where the fit starts; ``offsets`` (g,) says how far each number named in ``free`` has moved, in
    units that make a picture's height, a radian or the start's own size 1. Coordinates are the
    first four of ``Mitchell`` and the offsets; parameters are in the scene's units.
    """

    name: ClassVar[str] = "mitchell"

    shading: Mitchell
    scene: Scene
    offsets: Float[Array, " g"]
    free: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, shading, scene, free, offsets=None):
        self.shading, self.scene, self.free = shading, scene, tuple(free)
        count = sum(scene.value(name).size for name in self.free)
        self.offsets = jnp.zeros(count) if offsets is None else offsets

    @property
    def shader(self) -> str:
        return self.shading.shader

    @property
    def samples(self) -> int:
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
        return dict(self.convention.defaults) | dict(zip(geometry, start, strict=True))

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
            jnp.isnan(held[4:]), coordinates[4:], (held[4:] - self._base()) / self._units()
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
        method: str = "auto",
    ) -> Float[Array, "..."]:
        """See ``Mitchell``. Of ``mask`` only the shape counts: the scene is drawn at that size."""
        scene = self.staged()
        drawn = rasterise(resized(scene, (mask.shape[0], mask.shape[1])))
        lit = eqx.tree_at(lambda m: m.light, self.shading, on_screen(scene)[None])
        return lit(drawn, background, size=size, pixels=pixels, method=method)

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


def resized(scene: Scene, size: tuple[int, int]) -> Scene:
    """The scene in a picture of another size."""
    return dataclasses.replace(scene, size=size)


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


def place(
    picture: Picture,
    model: Staged,
    given: dict[str, float],
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
    report: Callable[[str], None],
) -> np.ndarray:
    """Coordinates of a staged model near the best: placements drawn about the start are tried on a
    small copy of the picture, the best are followed to larger copies."""
    side = max(picture.size)
    coarse = picture.shrunk(-(-side // LADDER[0][0]))
    movable = np.array(
        [
            name.endswith(("position", "target")) and not name.startswith("camera.position")
            for name in model.free
            for _ in range(model.scene.value(name).size)
        ],
        bool,
    )
    rng = np.random.default_rng(seed)
    tries = PLACEMENTS if movable.any() else 1
    report(f"{tries} placements")
    begun = []
    for trial in range(tries):
        offsets = np.where(movable & (trial > 0), rng.uniform(-REACH, REACH, movable.size), 0.0)
        offsets = np.where(np.isnan(held[4:]), offsets, 0.0).astype(np.float32)
        stage = eqx.tree_at(lambda m: m.offsets, model, jnp.asarray(offsets))
        drawn, light = _drawn(stage, coarse.mask.shape[:2])
        seen_from = dataclasses.replace(coarse, mask=np.asarray(drawn))
        known = given | {"light_x": float(light[0]), "light_y": float(light[1])}
        found = starts(seen_from, model.shading, known, keep=2, seed=seed)
        begun += [np.concatenate([z[:4], offsets]) for z in found]
    for side_now, keep, sigma in LADDER:
        factor = -(-side // side_now)
        small = picture.shrunk(factor)
        seen = small.observe(np.flatnonzero(small.valid))
        if side_now == LADDER[0][0]:
            costs = [_cost(z, held, model, seen) for z in begun]
            begun = [begun[i] for i in np.argsort(costs)[: 2 * keep]]
        report(f"{len(begun)} placements at {small.size[1]}x{small.size[0]} pixels")
        points = [solve(z, free, held, model, seen, sigma, bounded=False) for z in begun]
        points.sort(key=lambda p: p.cost)
        begun = [p.coordinates for p in points[:keep]]
        if factor == 1:
            break
    return begun[0]


@eqx.filter_jit
def _drawn(model: Staged, size: tuple[int, int]):
    return rasterise(resized(model.staged(), size)), model.light[0]


def _cost(z: np.ndarray, held: np.ndarray, model: Staged, seen) -> float:
    prediction = np.asarray(_predicted(z, held, model, seen))
    lo, hi = np.asarray(seen.lo), np.asarray(seen.hi)
    off = np.maximum(np.maximum(lo - prediction, prediction - hi), 0)
    return float((off**2).sum())


@eqx.filter_jit
def _predicted(z, held, model: Staged, seen):
    return seen.predict(model.moved(z, held))

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

from godfit.errors import InputError
from godfit.inference.observation import Observation, Picture
from godfit.inference.solver import Point, solve
from godfit.models.mitchell import AbstractModel, Mitchell, Vector
from godfit.scattering.parameters import SCATTERING, Parameter
from godfit.scattering.taps import Convention
from godfit.scattering.upsample import Texels
from godfit.scenes.raster import on_screen, rasterise
from godfit.scenes.scene import Scene
from godfit.search.multigrid import PIXELS
from godfit.search.screening import starts

# Longest side of the copies on which geometry is looked for; taps, pixels and noise on the first.
LADDER = (64, 128, 256)
COARSE_SAMPLES, COARSE_PIXELS, SIGMA = 32, 1024, 4.0
# Placements tried, how far (in picture heights) positions are moved in them, how many are followed
# downhill, and how many must agree.
PLACEMENTS, REACH, FOLLOWED, AGREE = 120, 0.15, 40, 2
MAX_SOLVES = 6


class Staged(AbstractModel):
    """Mitchell's sum over the mask that a scene draws.

    ``shading`` holds exposure, decay, density and weight (its light is not used); ``scene`` is
    where the fit starts; ``offsets`` (g,) says how far each number named in ``free`` has moved, in
    units that make a picture's height, a radian or the start's own size 1. Coordinates are the
    first four of ``Mitchell`` and the offsets; parameters are in the scene's units.
    """

    name: ClassVar[str] = Mitchell.name
    kept: ClassVar[str] = Mitchell.kept
    product: ClassVar[tuple[str, str]] = Mitchell.product
    banded: ClassVar[bool] = True
    channels: ClassVar[int] = 1

    shading: Mitchell
    scene: Scene
    offsets: Float[Array, " g"]
    free: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, shading, scene, free, offsets=None):
        self.shading, self.scene, self.free = shading, scene, tuple(free)
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
    """Coordinates of a staged model near the best.

    On a small copy of the picture, placements of the light and the objects drawn about the start,
    across the view, are each given the scattering that suits them best; the best are followed
    downhill, and what two of them agree on is followed to larger copies.
    """
    side = max(picture.size)
    coarse = picture.shrunk(-(-side // LADDER[0]))
    # Fewer taps serve a small picture: coordinates do not depend on their number.
    few = min(model.samples, COARSE_SAMPLES)
    shading = dataclasses.replace(model.shading, samples=few)
    rough = Staged(shading, model.scene, model.free)
    seen = coarse.observe(coarse.informative(COARSE_PIXELS, seed))
    blocks = _movable(model, held)
    across = np.asarray(model.scene.camera_axes()[:2])
    rng = np.random.default_rng(seed)
    report(f"{PLACEMENTS if blocks else 1} placements")
    found: list[tuple[float, np.ndarray]] = []
    for trial in range(PLACEMENTS if blocks else 1):
        offsets = np.zeros(len(model.offsets), np.float32)
        for block in blocks if trial else []:
            offsets[block] = rng.uniform(-REACH, REACH, 2) @ across
        stage = eqx.tree_at(lambda m: m.offsets, model, jnp.asarray(offsets))
        drawn, light = _drawn(stage, coarse.mask.shape[:2])
        known = given | {"light_x": float(light[0]), "light_y": float(light[1])}
        by = dataclasses.replace(coarse, mask=np.asarray(drawn))
        for z in starts(by, rough.shading, known, keep=2, seed=seed):
            z = np.concatenate([z[:4], offsets])
            found.append((_cost(z, held, rough, seen), z))
    found.sort(key=lambda f: f[0])
    report(f"downhill from {min(FOLLOWED, len(found))} placements")
    points: list[Point] = []
    for _, z in found[:FOLLOWED]:
        point = _descend(z, free, held, rough, seen, SIGMA)
        if any(np.abs(point.coordinates[4:][block]).max() > 2 * REACH for block in blocks):
            # An object that has left the picture is no answer: nothing calls it back.
            continue
        points.append(point)
        points.sort(key=lambda p: p.cost)
        if len(points) >= AGREE and points[AGREE - 1].cost < 1.02 * points[0].cost:
            break
    z = points[0].coordinates if points else found[0][1]
    for side_now in LADDER[1:]:
        factor = -(-side // side_now)
        small = picture.shrunk(factor)
        report(f"{small.size[1]}x{small.size[0]} pixels")
        pixels = small.informative(PIXELS, seed)
        z = _descend(z, free, held, model, small.observe(pixels), SIGMA / 4).coordinates
        if factor == 1:
            break
    lower, upper = (np.asarray(b, np.float32) for b in model.bounds())
    return np.clip(z, lower, upper)


def _descend(
    z: np.ndarray,
    free: np.ndarray,
    held: np.ndarray,
    model: Staged,
    seen: Observation,
    sigma: float,
) -> Point:
    """Solve until it makes no more headway: valleys of depth and size are long and bent."""
    point = Point(z, np.inf, False, 0)
    for _ in range(MAX_SOLVES):
        before = point
        try:
            point = solve(before.coordinates, free, held, model, seen, sigma, bounded=False)
        except jax.errors.JaxRuntimeError as error:
            if InputError.within(error) is None:
                raise
            # The way led to where nothing can be drawn, behind the camera say.
            return before
        if not point.cost < 0.98 * before.cost:
            break
    return point


def _movable(model: Staged, held: np.ndarray) -> list[slice]:
    """The offsets of every free position but the camera's, the light's first."""
    blocks, at = [], 0
    for name in model.free:
        size = model.scene.value(name).size
        loose = np.isnan(held[4 + at : 4 + at + size]).all()
        if loose and name.endswith("position") and not name.startswith("camera"):
            blocks.append((name != "light.position", slice(at, at + size)))
        at += size
    return [block for _, block in sorted(blocks, key=lambda b: b[0])]


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

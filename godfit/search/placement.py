"""Where the light, the camera and the objects of a scene are, near enough to be fitted."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from godfit.errors import InputError
from godfit.inference.observation import Observation, Picture
from godfit.inference.problem import PIXELS
from godfit.inference.solver import Point, solve
from godfit.models.staged import Staged
from godfit.scenes.raster import rasterise
from godfit.scenes.view import resized
from godfit.search.screening import starts

# Longest side of the copies on which geometry is looked for; taps, pixels and noise on the first.
LADDER = (64, 128, 256)
COARSE_SAMPLES, COARSE_PIXELS, SIGMA = 32, 1024, 4.0
# Placements tried, how far (in picture heights) positions are moved in them, how many are followed
# downhill, and how many must agree.
PLACEMENTS, REACH, FOLLOWED, AGREE = 120, 0.15, 40, 2
MAX_SOLVES = 6


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

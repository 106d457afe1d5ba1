"""The fit of a scene: its light, camera and objects together with the scattering.

The geometry is found on small copies of the picture, the scattering through the mask that it
draws, and then both are fitted together.
"""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from godfit.errors import InputError
from godfit.inference.fitted import Found
from godfit.inference.information import evidence
from godfit.inference.observation import Observation
from godfit.inference.problem import SEARCH_PIXELS, Problem
from godfit.inference.settle import settle
from godfit.inference.solver import Point, solve
from godfit.inference.strategy import Effort, Open, Report, left_open, search, starts
from godfit.models.base import AbstractModel
from godfit.models.staged import Staged
from godfit.scattering.parameters import SCATTERING
from godfit.scenes.raster import rasterise
from godfit.scenes.view import drawn_mask, resized
from godfit.search.masked import hold_open, search_mask

COPY_SIDES = (64, 128, 256)
"""Longest sides, in pixels, of the copies on which the geometry is found."""
COARSE_SAMPLES = 32
"""Taps on the first copy, at most: coordinates hardly depend on their number."""
COARSE_PIXELS = 1024
"""Pixels of the first copy that are compared."""
COARSE_SIGMA = 4.0
"""Noise on the first copy, in levels: what is drawn at so few pixels is off by as much."""
PLACEMENTS = 120
"""Placements drawn about the start."""
PLACEMENT_RANGE = 0.15
"""Distance, in picture heights, by which positions are moved in them, at most."""
SOLVED_PLACEMENTS = 40
"""The best placements, which are solved, at most."""
AGREEING = 2
"""Solved placements that must agree in cost before the rest is left out."""
PLACEMENT_SOLVES = 6
"""Solves one after another: valleys of depth and size are long and bent."""
GEOMETRY = slice(len(SCATTERING), None)
"""Coordinates of a staged model behind those of the scattering."""
SHADING = slice(0, len(SCATTERING))


@search.register
def search_scene(model: Staged, problem: Problem, given: dict[str, float], effort: Effort) -> Found:
    """The fit of a picture whose mask follows a scene."""
    picture = problem.picture
    z = place(problem, given, effort.report)
    stage = problem.at(z)
    assert isinstance(stage, Staged)
    drawn = np.asarray(drawn_mask(resized(stage.staged(), picture.mask.shape[:2]), True))
    light = np.asarray(stage.light[0], np.float32)
    flat = problem.replaced(
        model=model.shading,
        picture=dataclasses.replace(picture, mask=drawn),
        free=np.append(problem.free[SHADING], [False, False]),
        held=np.append(problem.held[SHADING], light),
    )
    at_light = {"light_x": float(light[0]), "light_y": float(light[1])}
    found = search_mask(flat, given | at_light, effort)
    z = np.append(found.settled.coordinates[SHADING], z[GEOMETRY]).astype(np.float32)
    effort.report("scene and scattering")
    settled, tangent = settle(z, problem, found.observation)
    at = evidence(settled, tangent, found.observation)
    whole = Found(problem, found.observation, settled, at, inquire=effort.inquire)
    return hold_open(whole, given)


@left_open.register
def _(model: Staged, problem: Problem) -> Open | None:
    return left_open(model.shading, problem)


def place(problem: Problem, given: dict[str, float], report: Report) -> np.ndarray:
    """(p,) coordinates of a staged model near the best.

    On a small copy of the picture, placements of the light and the objects drawn about the start,
    across the view, are each given the scattering that suits them best. The best are solved, and
    what two of them agree on is solved on larger copies.
    """
    model, picture, seed = problem.model, problem.picture, problem.seed
    assert isinstance(model, Staged)
    side = max(picture.size)
    coarse = picture.shrunk(-(-side // COPY_SIDES[0]))
    shading = dataclasses.replace(model.shading, samples=min(model.samples, COARSE_SAMPLES))
    rough = problem.replaced(model=Staged(shading, model.scene, model.free), picture=coarse)
    observation = rough.observe(COARSE_PIXELS)
    blocks = _movable(model, problem.held)
    across = np.asarray(model.scene.camera_axes()[:2])
    rng = np.random.default_rng(seed)
    report(f"{PLACEMENTS if blocks else 1} placements")
    found: list[tuple[float, np.ndarray]] = []
    for trial in range(PLACEMENTS if blocks else 1):
        offsets = np.zeros(len(model.offsets), np.float32)
        for block in blocks if trial else []:
            offsets[block] = rng.uniform(-PLACEMENT_RANGE, PLACEMENT_RANGE, 2) @ across
        stage = eqx.tree_at(lambda m: m.offsets, model, jnp.asarray(offsets))
        drawn, light = _drawn(stage, coarse.mask.shape[:2])
        known = given | {"light_x": float(light[0]), "light_y": float(light[1])}
        by = dataclasses.replace(coarse, mask=np.asarray(drawn))
        for z in starts(shading, by, known, keep=2, seed=seed):
            z = np.concatenate([z[SHADING], offsets])
            found.append((_cost(z, rough, observation), z))
    found.sort(key=lambda f: f[0])
    report(f"{min(SOLVED_PLACEMENTS, len(found))} placements are solved")
    points: list[Point] = []
    for _, z in found[:SOLVED_PLACEMENTS]:
        point = _descend(z, rough, observation, COARSE_SIGMA)
        offsets = point.coordinates[GEOMETRY]
        if any(np.abs(offsets[block]).max() > 2 * PLACEMENT_RANGE for block in blocks):
            # An object that has left the picture is no answer: no derivative brings it back.
            continue
        points.append(point)
        points.sort(key=lambda p: p.cost)
        if len(points) >= AGREEING and points[AGREEING - 1].cost < 1.02 * points[0].cost:
            break
    z = points[0].coordinates if points else found[0][1]
    for side_now in COPY_SIDES[1:]:
        factor = -(-side // side_now)
        small = problem.replaced(picture=picture.shrunk(factor))
        rows, columns = small.picture.size
        report(f"{columns}x{rows} pixels")
        z = _descend(z, small, small.observe(SEARCH_PIXELS), COARSE_SIGMA / 4).coordinates
        if factor == 1:
            break
    return np.clip(z, *problem.bounds)


def _descend(z: np.ndarray, problem: Problem, observation: Observation, sigma: float) -> Point:
    """Solve until the cost falls no more."""
    point = Point(z, np.inf, False, 0)
    for _ in range(PLACEMENT_SOLVES):
        before = point
        try:
            point = solve(before.coordinates, problem, observation, sigma, bounded=False)
        except jax.errors.JaxRuntimeError as error:
            if InputError.within(error) is None:
                raise
            # A step led to where nothing can be drawn, behind the camera for example.
            return before
        if not point.cost < 0.98 * before.cost:
            break
    return point


def _movable(model: Staged, held: np.ndarray) -> list[slice]:
    """The offsets of every free position but the camera's, the light's first."""
    blocks, at = [], 0
    for name in model.free:
        size = model.scene.value(name).size
        loose = np.isnan(held[GEOMETRY][at : at + size]).all()
        if loose and name.endswith("position") and not name.startswith("camera"):
            blocks.append((name != "light.position", slice(at, at + size)))
        at += size
    return [block for _, block in sorted(blocks, key=lambda b: b[0])]


@eqx.filter_jit
def _drawn(model: Staged, size: tuple[int, int]):
    return rasterise(resized(model.staged(), size)), model.light[0]


def _cost(z: np.ndarray, problem: Problem, observation: Observation) -> float:
    """Squared levels outside the intervals, in sum."""
    prediction = np.asarray(_predicted(z, problem.held, problem.model, observation))
    lo, hi = np.asarray(observation.lo), np.asarray(observation.hi)
    off = np.maximum(np.maximum(lo - prediction, prediction - hi), 0)
    return float((off**2).sum())


@eqx.filter_jit
def _predicted(z, held, model: AbstractModel, observation: Observation):
    return observation.predict(model.moved(z, held))

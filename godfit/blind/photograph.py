"""The fit of a photograph: its light is what is bright in it, see ``bright_pass.py``.

What is dark is where rays are seen; what is bright says nothing itself, as it is the light. The
rays brighten the picture that the bright-pass is of: they are taken off it, in turns.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from godfit.blind import first_look, screen_disc
from godfit.blind.beginnings import coordinates_of, with_background
from godfit.blind.doubts import next_dip
from godfit.blind.explained import explained_of_cells, grain
from godfit.blind.no_rays import NO_RAYS
from godfit.blind.screenshot import FOREIGN
from godfit.blind.segment import grown
from godfit.blind.unaided import DISAGREE, LEAST, blocks
from godfit.errors import InputError
from godfit.inference.distinct import local_minima
from godfit.inference.evaluate import occlusion_of, predictions
from godfit.inference.fitted import Found
from godfit.inference.information import evidence
from godfit.inference.observation import Observation, Picture
from godfit.inference.problem import Problem, given_and_held
from godfit.inference.settle import settle
from godfit.inference.solver import Point, solve
from godfit.io.image import LEVELS, Image
from godfit.io.sources import shrink_mask
from godfit.models.background import TERM_COUNTS, terms
from godfit.models.bright_pass import BrightPass, brightness
from godfit.models.coordinates import (
    DARK_VALUE,
    DENSITY,
    GAIN,
    LIGHT_X,
    LIGHT_Y,
    SOFTNESS,
    THRESHOLD,
)
from godfit.models.mitchell import Mitchell
from godfit.runtime.blas import one_thread
from godfit.runtime.device import on_device
from godfit.runtime.parallel import parallel_map
from godfit.runtime.program_cache import cached_jit

# Degrees of the background that is searched with, and in the end.
DEGREE, FINER = 2, 3
# Thresholds tried first, from where what is dark ends (0) to the mean of what is bright (1) and to
# the brightest (2), and how soft they are.
THRESHOLDS, SOFT = (0.0, 0.4, 0.7, 0.9, 1.2, 1.5, 1.8), 0.04
# Starts of each, those followed in all, and noise in levels allowed for on the way.
STARTS, FOLLOWED, SIGMAS = 3, 6, (8.0, 4.0, 2.0, 1.0)
# Pixels of the search, and turns of light and bright-pass.
PIXELS, TURNS = 4096, 4
# Densities are looked for from here on, so many to a dip; dips that are gone into, and how far
# those beside an answer are.
SPARSE, TO_A_DIP, DIPS, BESIDE = 0.2, 3, 6, (-2, -1, 1, 2)
# Of what varies where it is dark, the share that light must explain to be called rays: .8 to .9 of
# photographs with rays, up to .46 of such without, where it goes after texture.
RAYS = 0.6
# A disc so large is all of the picture.
EVERYWHERE = (9.9,)
# Exposure of a shader without a default: of what is dark, no pixel's own value tells.
EXPOSURE = 0.1


# Searches go on side by side, a core each.
@one_thread()
def found_in(
    target: Image,
    shading: Mitchell,
    valid: np.ndarray | None,
    pass_scale: float | None,
    fix: Mapping[str, float | None],
    start: Mapping[str, float],
    seed: int,
    say: Callable[[str], None],
) -> Found:
    """What was found, see ``unaided.found_in``. Raises InputError for what cannot be read so."""
    scale = pass_scale or 1.0
    picture, thresholds = _read(target, valid)
    least = thresholds[0]
    model = _template(shading, picture.channels, DEGREE, least)
    given, held = given_and_held(model, fix, start)
    free = np.isnan(held) & model.used
    opened: list[tuple[int, list[int]]] = []
    if free[0] and free[3]:
        held[0] = given.get("exposure", shading.defaults.get("exposure", EXPOSURE))
        free[0] = False
        opened.append((0, [3]))
    if "threshold" in given:
        thresholds = np.array([given["threshold"]])
    small = picture.shrunk(-(-max(picture.size) // first_look.SIDE))
    say("votes for the light")
    begun = _begun(small, model, given, thresholds, seed)
    say(f"{len(begun)} starts")
    points = _climbed(begun, Problem(model, small, free, held, seed))
    say("light and bright-pass in turn")
    z, mask = _in_turn(points[0].coordinates, Problem(model, picture, free, held, seed), scale)
    picture = picture.with_mask(mask)
    model = _template(shading, picture.channels, FINER, least)
    more = (TERM_COUNTS[FINER] - TERM_COUNTS[DEGREE]) * picture.channels
    z, held, free = (
        np.append(old, np.full(more, new, old.dtype))
        for old, new in ((z, 0), (held, np.nan), (free, True))
    )
    seen = picture.observe(blocks(picture, seed))
    say(f"all of the {len(seen.pixels):,} pixels")
    problem = Problem(model, picture, free, held, seed)
    z = solve(z, problem, seen, max(1.0, grain(picture))).coordinates
    settled, tangent = settle(z, problem, seen)
    at = evidence(settled, tangent, seen).within(model.ranges(settled.coordinates))
    shifts = (next_dip(settled, at.covariance(free), model.samples),) if free[DENSITY] else ()
    share = explained_of_cells(settled.coordinates, held, model, picture)
    objection = "" if share > RAYS else NO_RAYS.format(100 * max(share, 0))
    lights = np.stack([p.coordinates[LIGHT_X : LIGHT_Y + 1] for p in points])
    agreed = first_look.agreed(lights, settled.coordinates[LIGHT_X : LIGHT_Y + 1])
    remarks = (DISAGREE.format(*agreed),) if agreed[0] < 2 <= agreed[1] else ()
    return Found(
        problem, seen, settled, at, tuple(opened), False, remarks, objection, shifts, agreed
    )


def _read(target: Image, valid: np.ndarray | None) -> tuple[Picture, np.ndarray]:
    """The picture, its mask how bright it is and valid where it is dark, and thresholds to try."""
    picture = Picture.make(target, np.zeros(target.values.shape[:2], np.float32), None, valid)
    bright = _brightness(picture.levels)
    middle = _between(bright[picture.valid])
    dark = picture.valid & ~grown(bright > middle, 2)
    light = picture.valid & (bright > middle)
    if np.count_nonzero(dark) < LEAST or not light.any():
        raise InputError(
            f"bright pass: expected at least {LEAST} pixels that are darker than others, got "
            f"{np.count_nonzero(dark)}; give --mask"
        )
    knots = middle, bright[light].mean(), bright[light].max()
    picture = dataclasses.replace(picture, mask=bright, valid=dark, foreign=FOREIGN)
    return picture, np.interp(THRESHOLDS, (0, 1, 2), knots)


def _brightness(levels: np.ndarray) -> np.ndarray:
    return (brightness(levels) / LEVELS).astype(np.float32)


def _between(bright: np.ndarray) -> float:
    """What tells dark from bright (Otsu, IEEE Trans. Syst. Man Cybern. 9 (1979), 62)."""
    counts, edges = np.histogram(bright, 256, (0, 1))
    middles = (edges[1:] + edges[:-1]) / 2
    below = counts.cumsum()
    above = below[-1] - below
    sums = (counts * middles).cumsum()
    apart = sums / np.maximum(below, 1) - (sums[-1] - sums) / np.maximum(above, 1)
    return float(edges[1 + np.argmax(below * above * apart**2)])


def _template(shading: Mitchell, channels: int, degree: int, least: float) -> BrightPass:
    return BrightPass(shading, [least, SOFT, 0.0], np.zeros((TERM_COUNTS[degree], channels)), least)


def _begun(
    small: Picture, model: BrightPass, given: Mapping[str, float], thresholds: np.ndarray, seed: int
) -> list[np.ndarray]:
    """Coordinates (p,) to start from, without a background."""
    lights = screen_disc.places(small, seed)
    if {"light_x", "light_y"} <= set(given):
        lights = np.array([[given["light_x"], given["light_y"]]])
    softness, begun = given.get("softness", SOFT), []
    for threshold in thresholds:
        here = eqx.tree_at(lambda m: m.shape, model, jnp.array([threshold, softness, 0.0]))
        open_ = np.asarray(occlusion_of(here, small.mask))
        for start in screen_disc.starts(
            small, open_, len(model.background), lights, seed, STARTS, EVERYWHERE
        ):
            z = coordinates_of(start, model)
            z[[GAIN, THRESHOLD, SOFTNESS, DARK_VALUE]] = (
                z[GAIN] + z[DARK_VALUE],
                threshold,
                softness,
                0,
            )
            begun.append(z)
    return begun


def _climbed(begun: list[np.ndarray], problem: Problem) -> list[Point]:
    """Solved from every start, and further from the best, cheapest first."""
    model, small, held = problem.model, problem.picture, problem.held
    assert isinstance(model, BrightPass)
    seen, texture = small.observe(small.informative(PIXELS, problem.seed)), grain(small)

    def climb(z: np.ndarray, sigmas: Sequence[float]) -> Point:
        *wide, last = (max(sigma, texture) for sigma in sigmas)
        for sigma in wide:
            z = solve(z, problem, seen, sigma).coordinates
        return solve(z, problem, seen, last)

    def first(z: np.ndarray) -> Point:
        return climb(with_background(z, held, model, seen), SIGMAS[:1])

    def further(point: Point) -> Point:
        return climb(point.coordinates, SIGMAS[1:])

    points = sorted(parallel_map(first, begun), key=lambda p: p.cost)
    return sorted(parallel_map(further, points[:FOLLOWED]), key=lambda p: p.cost)


def _in_turn(z: np.ndarray, problem: Problem, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (p,), and how bright the picture is without its rays, of the light pass's size:
    they are not among what the bright-pass is of."""
    model, picture, held = problem.model, problem.picture, problem.held
    assert isinstance(model, BrightPass)
    seen = picture.observe(picture.informative(PIXELS, problem.seed))
    mask, texture = shrink_mask(picture.mask, scale), grain(picture)
    for turn in range(TURNS):
        here = seen.with_mask(mask)
        for sigma in SIGMAS if turn == 0 else SIGMAS[-1:]:
            z = solve(z, problem, here, max(sigma, texture)).coordinates
        if problem.free[DENSITY] and turn in (0, TURNS - 1):
            z = _densest(z, problem, here, max(SIGMAS[-1], texture))
        light = np.asarray(_light_pass(on_device(z), held, model, on_device(mask), picture.size))
        mask = shrink_mask(_brightness(_unlit(model, picture.levels, light)), scale)
    return z, mask


def _densest(z: np.ndarray, problem: Problem, seen: Observation, sigma: float) -> np.ndarray:
    """Coordinates (p,) in the deepest dip of density: every tap leaves one, see ``dips.py``. Those
    that stand out with gain and background solved for are gone into, and then their neighbours."""
    model, held = problem.model, problem.held
    assert isinstance(model, BrightPass)
    dip = z[DENSITY] / model.samples
    line = np.arange(SPARSE, 1 + dip / TO_A_DIP, dip / TO_A_DIP).clip(max=1).astype(np.float32)
    points = np.tile(z, (len(line), 1))
    points[:, DENSITY] = line
    unlit = z.copy()
    unlit[[0, GAIN]] = 0
    levels = np.asarray(predictions(on_device(np.vstack([unlit, points])), held, model, seen))
    lo, hi = np.asarray(seen.lo), np.asarray(seen.hi)
    basis = terms(np.asarray(seen.pixels), seen.size, len(model.background))
    basis = np.linalg.qr(basis)[0]

    def alone(values: np.ndarray) -> np.ndarray:
        # (..., n c) without what a background explains.
        values = values.reshape(*values.shape[:-1], -1, seen.channels)
        return (values - basis @ (basis.T @ values)).reshape(*values.shape[:-2], -1)

    goal, light = alone((np.maximum(lo, 0) + hi) / 2), alone(levels[1:] - levels[:1])
    gain = (light @ goal) / np.maximum((light**2).sum(1), 1e-9)
    cost = np.abs(goal - gain[:, None] * light).sum(1)
    deepest = local_minima(cost)
    deepest = deepest[np.argsort(cost[deepest])][:DIPS]
    begun = points[deepest]
    begun[:, GAIN] *= gain[deepest].clip(min=0)

    def solved(start: np.ndarray) -> Point:
        return solve(start, problem, seen, sigma)

    best = min(parallel_map(solved, [z, *begun]), key=lambda p: p.cost)
    near = np.tile(best.coordinates, (len(BESIDE), 1))
    near[:, DENSITY] = (near[:, DENSITY] * (1 + np.array(BESIDE) / model.samples)).clip(max=1)
    return min(best, *parallel_map(solved, list(near)), key=lambda p: p.cost).coordinates


def _unlit(model: BrightPass, levels: np.ndarray, light: np.ndarray) -> np.ndarray:
    """(h, w, c) levels without the light pass (h, w)."""
    light = light[..., None] * np.asarray(model.colour)
    back = levels - np.float32(LEVELS) * light
    if model.convention.blend == "screen":
        return back / np.maximum(1 - light, 0.05)
    return back / np.float32(model.convention.background_gain)


@cached_jit
def _light_pass(z, held, model: BrightPass, mask, size: tuple[int, int]):
    return model.moved(z, held).light_pass(mask, size=size)

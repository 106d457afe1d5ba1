"""The cost along density, over all of its range or near a point, and the minima there.

Each of the shader's taps leaves a band where the rays end, so that the cost has a minimum for every
band. ``scan_density`` goes over all densities, the other coordinates following, and settles in the
deepest minima; ``nearby_minima`` tries those next to a point. ``density_minima.py`` decides between
what they find.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.inference.distinct import DOUBT, distinct, local_minima
from godfit.inference.evaluate import predictions
from godfit.inference.likelihood import deviance_residuals
from godfit.inference.observation import Observation
from godfit.inference.problem import SEARCH_PIXELS, Problem
from godfit.inference.settle import Settled, settle
from godfit.inference.solver import Point, solve
from godfit.inference.strategy import COARSE_TO_FINE
from godfit.inference.variable_projection import least_squares
from godfit.models.base import AbstractModel, Vector
from godfit.runtime.blas import one_thread
from godfit.runtime.device import on_device
from godfit.runtime.parallel import parallel_map
from godfit.runtime.program_cache import cached_jit
from godfit.scattering.parameters import LIGHT_DENSITY

SCAN_DENSITIES = 400
"""Densities tried from LOWEST_DENSITY to 1, and in proportion in a larger range: a minimum is about
1/samples wide."""
CLOSE_DENSITIES = 120
"""Densities tried within CLOSE_RANGE of the start, where the right minimum most likely lies."""
CLOSE_RANGE = 0.06
"""Relative distance from the start that counts as close."""
LOWEST_DENSITY = 0.05
"""Rays shorter than this are hardly visible, and no shader ships with them."""
SETTLED_MINIMA = 4
"""Minima, cheapest first, that are worth a noise of their own."""
SCAN_PIXELS = 1 << 9
"""Pixels of the scan: enough to find the minima, whose depths more pixels then compare."""
NEARBY_BANDS = 6
"""Bands either way within which another minimum may be the right one."""
NEARBY_TRIES = 2
"""The deepest of these minima that are solved."""
BEYOND_DOUBT = 32.0
"""Log-likelihood on a quarter of the pixels, not settled yet, by which a minimum that is behind
cannot be ahead on all of them."""
SHARPEST_SIGMA = 0.02
"""Noise of a scan in levels, at least: a sharper likelihood is flat where the bottom of a minimum
lies a little beside the line."""
BLUNTEST_SIGMA = 0.3
"""Noise of a scan in levels, at most: a blunter likelihood does not separate minima."""
RIDGE = 1e-9
"""Ridge of the linear coordinates, as a share of the trace: less than float32 resolves."""


def nearby_minima(
    start: Settled, problem: Problem, along: int, band: float, count: int
) -> list[np.ndarray]:
    """Coordinates in the deepest minima of coordinate ``along`` within some ``band`` widths of
    ``start``, without its own.

    ``count`` pixels decide which of them may be likelier on all: where noise hides the bands, a few
    thousand do not distinguish the minima.
    """
    pixels = problem.picture.informative(count, problem.seed)
    observation = problem.picture.observe(pixels)
    smooth = problem.picture.observe(pixels, _valley_blur(problem))
    at = start.coordinates
    follow = _valley_direction(at, problem, along, smooth)
    away = band * np.linspace(-NEARBY_BANDS, NEARBY_BANDS, 10 * NEARBY_BANDS)
    line = np.clip(at + np.outer(away, follow), *problem.bounds)
    sigma = jnp.float32(start.sigma)

    def costs_at(points: np.ndarray) -> np.ndarray:
        levels = predictions(
            on_device(points, np.float32), problem.held, problem.model, observation
        )
        return np.asarray(_costs(levels, observation, sigma))

    costs = np.concatenate(parallel_map(costs_at, np.array_split(line, 2)))
    costs = np.where(np.isfinite(costs) & (np.abs(away) > band / 2), costs, np.inf)
    minima = local_minima(costs)
    best = minima[np.argsort(costs[minima])][:NEARBY_TRIES]
    begun = line[best].astype(np.float32)
    ends = parallel_map(lambda z: solve(z, problem, observation, start.sigma), begun)
    own = float(costs_at(at[None])[0])
    return [end.coordinates for end in ends if end.cost < own + DOUBT]


def along_valley(at: np.ndarray, values: np.ndarray, problem: Problem, along: int) -> np.ndarray:
    """(n, p) ``at`` with coordinate ``along`` at ``values`` (n,), the others on the floor of the
    valley."""
    smooth = problem.observe(SEARCH_PIXELS, _valley_blur(problem))
    follow = _valley_direction(at, problem, along, smooth)
    return _line(at, values, along, problem, follow).astype(np.float32)


def _line(
    at: np.ndarray, values: np.ndarray, along: int, problem: Problem, follow: np.ndarray
) -> np.ndarray:
    """(n, p) ``at`` with coordinate ``along`` at ``values``, all others moved along ``follow``."""
    return np.clip(at + np.outer(values - at[along], follow), *problem.bounds)


def _valley_blur(problem: Problem) -> float:
    """Pixels of blur at which the bands are gone and the valley of the cost is left."""
    return COARSE_TO_FINE[1].blur * max(problem.picture.size)


def _valley_direction(
    at: np.ndarray, problem: Problem, along: int, observation: Observation
) -> np.ndarray:
    """(p,) how the other coordinates follow coordinate ``along`` on the floor of the valley."""
    free = problem.free.astype(np.float32)
    free[along] = 1
    with one_thread():
        floor = _floor(on_device(at), free, problem.held, along, problem.model, observation)
        return np.asarray(floor)


@cached_jit
def _floor(
    coordinates: Vector,
    free: Vector,
    held: Vector,
    along: int,
    model: AbstractModel,
    observation: Observation,
) -> Float[Array, " p"]:
    jacobian = jax.jacfwd(lambda z: observation.predict(model.moved(z, held)))(coordinates)
    inside = jnp.isfinite(observation.lo) & jnp.isfinite(observation.hi)
    jacobian = jnp.where(inside[:, None], jacobian, 0.0) * free[None]
    size = jnp.sqrt((jacobian**2).sum(0))
    size = jnp.where(size > 0, size, 1.0)
    others = (jacobian / size[None]).at[:, along].set(0.0)
    follow = -jnp.linalg.lstsq(others, jacobian[:, along], rcond=1e-4)[0] / size
    return follow.at[along].set(1.0)


def _following(
    at: np.ndarray,
    values: np.ndarray,
    along: int,
    problem: Problem,
    scanned: Observation,
    follow: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """(n, p) ``at`` with coordinate ``along`` at ``values`` and all others following it along the
    floor of the valley, in direction ``follow``; and (n, m) levels there."""
    line = _line(at, values, along, problem, follow)
    points = on_device(line, np.float32)
    return line, np.asarray(predictions(points, problem.held, problem.model, scanned))


def _projected(
    at: np.ndarray, values: np.ndarray, along: int, problem: Problem, scanned: Observation
) -> tuple[np.ndarray, np.ndarray]:
    """(n, p) ``at`` with coordinate ``along`` at ``values`` and the free ones that the image is
    linear in solved for, inside their bounds; and (n, m) levels there."""
    model = problem.model
    line = np.tile(at.astype(np.float64), (len(values), 1))
    line[:, along] = values
    linear = np.flatnonzero(problem.free & model.linear())
    known = np.isfinite(scanned.lo) & np.isfinite(scanned.hi)

    def images(points: np.ndarray) -> np.ndarray:
        levels = predictions(on_device(points, np.float32), problem.held, model, scanned)
        return np.asarray(levels, np.float64)

    shown = images(line)
    if not len(linear) or scanned.transfer != "none" or not known.any():
        return line, shown
    # The image is b + sum_i x_i s_i. Doubling one x_i gives x_i s_i. Only the last component, the
    # gain's, changes with density.
    doubled = np.tile(at, (len(linear), 1))
    doubled[np.arange(len(linear)), linear] *= 2
    here = images(at[None])[0]
    parts = images(doubled) - here
    rest = here - parts.sum(0)
    target = ((np.asarray(scanned.lo) + np.asarray(scanned.hi)) / 2 - rest)[known]
    gain = shown - rest - parts[:-1].sum(0)
    # (n, linear, m) each component at each place.
    components = np.concatenate(
        [np.broadcast_to(parts[:-1], (len(line), *parts[:-1].shape)), gain[:, None]], 1
    )
    share = least_squares(components[..., known], target, RIDGE)
    bounds = (np.asarray(b, np.float64)[linear] for b in model.bounds())
    line[:, linear] = np.clip(line[:, linear] * share, *bounds)
    # A component at 0 stays there, whatever it is multiplied by.
    share = line[:, linear] / np.where(at[linear] == 0, 1, at[linear])
    shown = rest + np.einsum("nl,nlm->nm", share, components)
    return line, shown


@cached_jit
def _costs(
    levels: Float[Array, "n m"], observation: Observation, sigma: Float[Array, ""]
) -> Float[Array, " n"]:
    """Half the deviance of each of n predictions."""
    lo, hi, foreign = observation.lo, observation.hi, observation.foreign

    def cost(prediction):
        return 0.5 * (deviance_residuals(prediction, lo, hi, sigma, foreign) ** 2).sum()

    return jax.lax.map(cost, levels)


def scan_density(
    start: Settled, problem: Problem, along: int, *, tries: int = 8, count: int = SEARCH_PIXELS
) -> list[Settled]:
    """Settle in the deepest minima along coordinate ``along``; the best first, ``start`` among
    them. ``count`` pixels decide, and at most ``tries`` minima are solved."""
    observation, coarse = problem.observe(count), problem.observe(count // 4)
    scanned = problem.observe(SCAN_PIXELS)
    lower, upper = problem.bounds
    at = start.coordinates
    smooth = problem.observe(count, _valley_blur(problem))
    follow = _valley_direction(at, problem, along, smooth)
    here = at[along]
    lowest, highest = max(lower[along], LOWEST_DENSITY), upper[along]
    everywhere = round(SCAN_DENSITIES * (highest - lowest) / (LIGHT_DENSITY - LOWEST_DENSITY))
    near = np.linspace(
        max((1 - CLOSE_RANGE) * here, lowest),
        min((1 + CLOSE_RANGE) * here, highest),
        CLOSE_DENSITIES,
    )
    values = np.sort(np.concatenate([near, np.linspace(lowest, highest, everywhere)]))
    sigma = float(np.clip(start.sigma, SHARPEST_SIGMA, BLUNTEST_SIGMA))

    # Two lines through the start: one follows the valley, the other suits a start that is right but
    # for density.
    def minima_on(follows: bool) -> list[Point]:
        line = at, values, along, problem, scanned
        points, levels = _following(*line, follow) if follows else _projected(*line)
        points = points.astype(np.float32)
        costs = np.asarray(_costs(jnp.asarray(levels, jnp.float32), scanned, jnp.float32(sigma)))
        return [Point(points[i], float(costs[i]), False, 0) for i in local_minima(costs)]

    lines = parallel_map(minima_on, [True, False])
    band = float(here) / problem.model.samples
    begun = _apart([p for line in lines for p in line], along, band / 4)
    points = parallel_map(lambda p: solve(p.coordinates, problem, coarse, sigma), begun[:tries])
    if len(points) > SETTLED_MINIMA:
        # The few pixels that they were solved on cannot rank them.
        ends = np.array([points[i % len(points)].coordinates for i in range(tries)], np.float32)
        levels = predictions(on_device(ends), problem.held, problem.model, observation)
        costs = np.asarray(_costs(levels, observation, jnp.float32(sigma)))
        points = [p._replace(cost=float(c)) for p, c in zip(points, costs, strict=False)]
    points = _apart(points, along, band / 20)[:SETTLED_MINIMA]
    if points and start.sigma > sigma:
        # With noise of its own, a point is behind by half of n values times the log of the ratio.
        far = points[0].cost * math.exp(2 * BEYOND_DOUBT / len(coarse.lo))
        points = [p for p in points if p.cost <= far]
    found = parallel_map(lambda p: settle(p.coordinates, problem, observation)[0], points)
    return sorted([start, *found], key=lambda s: -s.log_likelihood)


def _apart(points: list[Point], along: int, near: float) -> list[Point]:
    """Points, cheapest first, none of them within ``near`` of a cheaper one in ``along``."""

    def same(p: Point, q: Point) -> bool:
        return bool(abs(p.coordinates[along] - q.coordinates[along]) <= near)

    return distinct(sorted(points, key=lambda p: p.cost), same)

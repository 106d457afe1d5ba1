"""Along the valley of the cost, from dip to dip.

``reseed`` walks it over all densities, the other coordinates following, and settles in the deepest
dips; ``rivals`` looks at those near a point. ``dips.py`` decides between what they find.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.inference.likelihood import deviance_residuals
from godfit.inference.observation import Observation, Picture
from godfit.inference.problem import PIXELS
from godfit.inference.scan import DOUBT, bottoms, predictions
from godfit.inference.settle import Settled, settle
from godfit.inference.solver import Point, solve
from godfit.models.base import AbstractModel, Vector
from godfit.runtime.blas import one_thread
from godfit.runtime.device import on_device
from godfit.runtime.parallel import parallel_map
from godfit.runtime.program_cache import cached_jit
from godfit.search.multigrid import LADDER

# A dip of density is about 1/samples wide.
FAR_VALUES, NEAR_VALUES = 400, 120
# Ends of solves, apart and cheapest first, that are worth a noise of their own.
SETTLED = 4
# Pixels that are enough to see where the dips are.
SCAN_PIXELS = 1 << 9
# Dips either way that are looked into, and how many of them are tried.
RIVAL_DIPS, RIVALS = 6, 2
# And by which one, on a quarter of these and not settled yet, cannot be.
BEYOND_DOUBT = 32.0


def rivals(
    start: Settled,
    along: int,
    dip: float,
    model: AbstractModel,
    picture: Picture,
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
    count: int,
) -> list[np.ndarray]:
    """Coordinates in the deepest dips of ``along`` near ``start`` but for its own, on ``count``
    pixels, those of them that may be likelier: where noise hides the bands, a few thousand cannot
    tell one dip from another."""
    pixels = picture.informative(count, seed)
    seen = picture.observe(pixels)
    smooth = picture.observe(pixels, LADDER[1][0] * max(picture.size))
    lower, upper = (np.asarray(b, np.float32) for b in model.bounds())
    at = start.coordinates
    switch = free.astype(np.float32)
    follow = _valley(at, switch, held, along, model, smooth)
    away = dip * np.linspace(-RIVAL_DIPS, RIVAL_DIPS, 10 * RIVAL_DIPS)
    line = np.clip(at + np.outer(away, follow), lower, upper)
    sigma = jnp.float32(start.sigma)

    def costs_at(points: np.ndarray) -> np.ndarray:
        levels = predictions(on_device(points, np.float32), held, model, seen)
        return np.asarray(_costs(levels, seen, sigma))

    costs = np.concatenate(parallel_map(costs_at, np.array_split(line, 2)))
    costs = np.where(np.isfinite(costs) & (np.abs(away) > dip / 2), costs, np.inf)
    dips = bottoms(costs)
    best = dips[np.argsort(costs[dips])][:RIVALS]
    begun = line[best].astype(np.float32)
    ends = parallel_map(lambda z: solve(z, free, held, model, seen, start.sigma), begun)
    own = float(costs_at(at[None])[0])
    return [end.coordinates for end in ends if end.cost < own + DOUBT]


def _valley(
    at: np.ndarray,
    free: np.ndarray,
    held: np.ndarray,
    along: int,
    model: AbstractModel,
    seen: Observation,
) -> np.ndarray:
    """(p,) how the other coordinates follow coordinate ``along`` on the valley's floor."""
    with one_thread():
        return np.asarray(_floor(on_device(at), free, held, along, model, seen))


@cached_jit
def _floor(
    coordinates: Vector,
    free: Vector,
    held: Vector,
    along: int,
    model: AbstractModel,
    seen: Observation,
) -> Float[Array, " p"]:
    jacobian = jax.jacfwd(lambda z: seen.predict(model.moved(z, held)))(coordinates)
    inside = jnp.isfinite(seen.lo) & jnp.isfinite(seen.hi)
    jacobian = jnp.where(inside[:, None], jacobian, 0.0) * free[None]
    size = jnp.sqrt((jacobian**2).sum(0))
    size = jnp.where(size > 0, size, 1.0)
    others = (jacobian / size[None]).at[:, along].set(0.0)
    follow = -jnp.linalg.lstsq(others, jacobian[:, along], rcond=1e-4)[0] / size
    return follow.at[along].set(1.0)


def _projected(
    at: np.ndarray,
    values: np.ndarray,
    along: int,
    free: np.ndarray,
    held: np.ndarray,
    model: AbstractModel,
    seen: Observation,
) -> tuple[np.ndarray, np.ndarray]:
    """(n, p) ``at`` with coordinate ``along`` at ``values`` and the free ones that the image is
    linear in where least squares has them, inside their bounds (variable projection: Golub &
    Pereyra 1973); and (n, m) levels there."""
    line = np.tile(at.astype(np.float64), (len(values), 1))
    line[:, along] = values
    linear = np.flatnonzero(free & model.linear())
    known = np.isfinite(seen.lo) & np.isfinite(seen.hi)

    def images(points: np.ndarray) -> np.ndarray:
        found = predictions(on_device(points, np.float32), held, model, seen)
        return np.asarray(found, np.float64)

    shown = images(line)
    if not len(linear) or seen.transfer != "none" or not known.any():
        return line, shown
    # The image is b + sum_i x_i s_i. Twice one x_i shows x_i s_i; only the last, the gain's,
    # changes with density.
    doubled = np.tile(at, (len(linear), 1))
    doubled[np.arange(len(linear)), linear] *= 2
    here = images(at[None])[0]
    parts = images(doubled) - here
    rest = here - parts.sum(0)
    target = ((np.asarray(seen.lo) + np.asarray(seen.hi)) / 2 - rest)[known]
    gain = shown - rest - parts[:-1].sum(0)
    # (n, linear, m) what each of them shows at each place.
    each = np.concatenate(
        [np.broadcast_to(parts[:-1], (len(line), *parts[:-1].shape)), gain[:, None]], 1
    )
    inside = each[..., known]
    gram = inside @ inside.swapaxes(1, 2)
    tiny = 1e-9 * np.trace(gram, axis1=1, axis2=2) + 1e-30
    gram += tiny[:, None, None] * np.eye(len(linear))
    share = np.linalg.solve(gram, (inside @ target)[..., None])[..., 0]
    bounds = (np.asarray(b, np.float64)[linear] for b in model.bounds())
    line[:, linear] = np.clip(line[:, linear] * share, *bounds)
    # What is 0 shows nothing, however often it is taken.
    share = line[:, linear] / np.where(at[linear] == 0, 1, at[linear])
    shown = rest + np.einsum("nl,nlm->nm", share, each)
    return line, shown


@cached_jit
def _costs(
    levels: Float[Array, "n m"], seen: Observation, sigma: Float[Array, ""]
) -> Float[Array, " n"]:
    """Half the deviance of each of n predictions."""

    def cost(prediction):
        residuals = deviance_residuals(prediction, seen.lo, seen.hi, sigma, seen.foreign)
        return 0.5 * (residuals**2).sum()

    return jax.lax.map(cost, levels)


def reseed(
    start: Settled,
    along: int,
    model: AbstractModel,
    picture: Picture,
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
    *,
    tries: int = 8,
    count: int = PIXELS,
) -> list[Settled]:
    """Walk along the valley of coordinate ``along`` and settle anew in its deepest dips; the best
    first, ``start`` among them. ``count`` pixels decide."""
    pixels = picture.informative(count, seed)
    seen = picture.observe(pixels)
    few = picture.observe(picture.informative(count // 4, seed))
    smooth = picture.observe(pixels, LADDER[1][0] * max(picture.size))
    scanned = picture.observe(picture.informative(SCAN_PIXELS, seed))
    lower, upper = (np.asarray(b, np.float32) for b in model.bounds())
    at = start.coordinates
    here = at[along]
    least, most = max(lower[along], 0.05), upper[along]
    near = np.linspace(max(0.94 * here, least), min(1.06 * here, most), NEAR_VALUES)
    values = np.sort(np.concatenate([near, np.linspace(least, most, FAR_VALUES)]))
    # Two lines through the start: one where all other coordinates follow along the valley's floor,
    # one where those that the image is linear in are solved for at every place, for a start that is
    # right but for this.
    switch = free.astype(np.float32)
    switch[along] = 1
    follow = _valley(at, switch, held, along, model, smooth)
    # As sharp as the start is good: a blunter likelihood cannot tell the dips apart, a sharper one
    # sees nothing of those whose bottom lies a little beside the line.
    sigma = float(np.clip(start.sigma, 0.02, 0.3))

    def following() -> tuple[np.ndarray, np.ndarray]:
        line = np.clip(at + np.outer(values - here, follow), lower, upper)
        points = on_device(line, np.float32)
        return line, np.asarray(predictions(points, held, model, scanned))

    def projected() -> tuple[np.ndarray, np.ndarray]:
        return _projected(at, values, along, free, held, model, scanned)

    def dips_on(line: Callable[[], tuple[np.ndarray, np.ndarray]]) -> list[Point]:
        points, levels = line()
        points = points.astype(np.float32)
        costs = np.asarray(_costs(jnp.asarray(levels, jnp.float32), scanned, jnp.float32(sigma)))
        return [Point(points[i], float(costs[i]), False, 0) for i in bottoms(costs)]

    dip = float(here) / model.samples
    dips = parallel_map(dips_on, [following, projected])
    begun = _apart([p for line in dips for p in line], along, dip / 4)
    points = parallel_map(
        lambda p: solve(p.coordinates, free, held, model, few, sigma), begun[:tries]
    )
    if len(points) > SETTLED:
        # What they were solved on is too little to say which of them are the deepest.
        ends = np.array([points[i % len(points)].coordinates for i in range(tries)], np.float32)
        levels = predictions(on_device(ends), held, model, seen)
        costs = np.asarray(_costs(levels, seen, jnp.float32(sigma)))
        points = [p._replace(cost=float(c)) for p, c in zip(points, costs, strict=False)]
    points = _apart(points, along, dip / 20)[:SETTLED]
    if points and start.sigma > sigma:
        # With a noise of their own, half of n values times the logarithm is what they are behind.
        far = points[0].cost * math.exp(2 * BEYOND_DOUBT / len(few.lo))
        points = [p for p in points if p.cost <= far]
    found = parallel_map(lambda p: settle(p.coordinates, model, seen, free, held)[0], points)
    return sorted([start, *found], key=lambda s: -s.log_likelihood)


def _apart(points: list[Point], along: int, near: float) -> list[Point]:
    """Points, cheapest first, none of them within ``near`` of a cheaper one in ``along``."""
    kept: list[Point] = []
    for p in sorted(points, key=lambda p: p.cost):
        if all(abs(p.coordinates[along] - k.coordinates[along]) > near for k in kept):
            kept.append(p)
    return kept

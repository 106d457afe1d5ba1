"""Along the valley of the cost, from dip to dip.

``reseed`` walks it over all densities, the other coordinates following, and settles in the deepest
dips; ``rivals`` looks at those near a point. ``dips.py`` decides between what they find.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.likelihood import deviance_residuals
from godfit.models import AbstractModel, Vector
from godfit.observation import Observation, Picture
from godfit.search import LADDER, PIXELS, Settled, settle
from godfit.side_by_side import side_by_side
from godfit.solver import Point, solve

# A dip of density is about 1/samples wide.
FAR_VALUES, NEAR_VALUES = 400, 120
# Ends of solves, apart and cheapest first, that are worth a noise of their own.
SETTLED = 4
# Pixels that are enough to see where the dips are.
SCAN_PIXELS = 1 << 9
# Dips either way that are looked into, and how many of them are tried.
RIVAL_DIPS, RIVALS = 6, 2
# Log-likelihood on some of the pixels by which a point that is ahead on all may be behind.
DOUBT = 8.0


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
    follow = np.asarray(_valley(jnp.asarray(at), switch, held, along, model, smooth))
    away = dip * np.linspace(-RIVAL_DIPS, RIVAL_DIPS, 10 * RIVAL_DIPS)
    line = np.clip(at + np.outer(away, follow), lower, upper)
    sigma = jnp.float32(start.sigma)
    halves = side_by_side(
        lambda part: np.asarray(_costs(jnp.asarray(part), held, model, seen, sigma)),
        np.array_split(line.astype(np.float32), 2),
    )
    costs = np.concatenate(halves)
    costs = np.where(np.isfinite(costs) & (np.abs(away) > dip / 2), costs, np.inf)
    dips = _bottoms(costs)
    best = dips[np.argsort(costs[dips])][:RIVALS]
    begun = line[best].astype(np.float32)
    ends = side_by_side(lambda z: solve(z, free, held, model, seen, start.sigma), begun)
    own = float(_costs(jnp.asarray(at[None], jnp.float32), held, model, seen, sigma)[0])
    return [end.coordinates for end in ends if end.cost < own + DOUBT]


@eqx.filter_jit
def _valley(
    coordinates: Vector,
    free: Vector,
    held: Vector,
    along: int,
    model: AbstractModel,
    seen: Observation,
) -> Float[Array, " p"]:
    """How the other coordinates follow coordinate ``along`` on the valley's floor."""
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
) -> np.ndarray:
    """(n, p) ``at`` with coordinate ``along`` at ``values`` and the free ones that the image is
    linear in where least squares has them (variable projection: Golub & Pereyra 1973)."""
    line = np.tile(at.astype(np.float64), (len(values), 1))
    line[:, along] = values
    linear = np.flatnonzero(free & model.linear())
    known = np.isfinite(seen.lo) & np.isfinite(seen.hi)
    if not len(linear) or seen.transfer != "none" or not known.any():
        return line

    def images(points: np.ndarray) -> np.ndarray:
        found = _predictions(jnp.asarray(points, jnp.float32), held, model, seen)
        return np.asarray(found, np.float64)[:, known]

    # The image is b + sum_i x_i s_i. Twice one x_i shows x_i s_i; only the last, the gain's,
    # changes with density.
    doubled = np.tile(at, (len(linear), 1))
    doubled[np.arange(len(linear)), linear] *= 2
    here = images(at[None])[0]
    parts = images(doubled) - here
    rest = here - parts.sum(0)
    target = ((np.asarray(seen.lo) + np.asarray(seen.hi)) / 2)[known] - rest
    gain = images(line) - rest - parts[:-1].sum(0)
    for i, own in enumerate(gain):
        columns = np.stack([*parts[:-1], own])
        gram = columns @ columns.T
        tiny = 1e-9 * np.trace(gram) * np.eye(len(linear))
        line[i, linear] *= np.linalg.solve(
            gram + tiny + 1e-30 * np.eye(len(linear)), columns @ target
        )
    return line


@eqx.filter_jit
def _predictions(points, held, model, seen):
    return jax.lax.map(lambda z: seen.predict(model.moved(z, held)), points)


@eqx.filter_jit
def _costs(
    points: Float[Array, "n p"],
    held: Vector,
    model: AbstractModel,
    seen: Observation,
    sigma: Float[Array, ""],
) -> Float[Array, " n"]:
    def cost(z):
        prediction = seen.predict(model.moved(z, held))
        residuals = deviance_residuals(prediction, seen.lo, seen.hi, sigma, seen.foreign)
        return 0.5 * (residuals**2).sum()

    return jax.lax.map(cost, points)


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
    follow = np.asarray(_valley(jnp.asarray(at), switch, held, along, model, smooth))
    lines = [
        np.clip(at + np.outer(values - here, follow), lower, upper),
        np.clip(_projected(at, values, along, free, held, model, scanned), lower, upper),
    ]
    # As sharp as the start is good: a blunter likelihood cannot tell the dips apart, a sharper one
    # sees nothing of those whose bottom lies a little beside the line.
    sigma = float(np.clip(start.sigma, 0.02, 0.3))

    def dips_on(line: np.ndarray) -> list[Point]:
        points = line.astype(np.float32)
        costs = np.asarray(_costs(jnp.asarray(points), held, model, scanned, jnp.float32(sigma)))
        return [Point(points[i], float(costs[i]), False, 0) for i in _bottoms(costs)]

    dip = float(here) / model.samples
    begun = _apart([p for line in side_by_side(dips_on, lines) for p in line], along, dip / 4)
    points = side_by_side(
        lambda p: solve(p.coordinates, free, held, model, seen, sigma), begun[:tries]
    )
    points = _apart(points, along, dip / 20)
    found = side_by_side(
        lambda p: settle(p.coordinates, model, seen, free, held)[0], points[:SETTLED]
    )
    return sorted([start, *found], key=lambda s: -s.log_likelihood)


def _bottoms(costs: np.ndarray) -> np.ndarray:
    """Indices where ``costs`` (n,) are finite and no neighbour is less."""
    costs = np.where(np.isfinite(costs), costs, np.inf)
    around = np.pad(costs, 1, constant_values=np.inf)
    return np.flatnonzero(np.isfinite(costs) & (costs <= around[:-2]) & (costs <= around[2:]))


def _apart(points: list[Point], along: int, near: float) -> list[Point]:
    """Points, cheapest first, none of them within ``near`` of a cheaper one in ``along``."""
    kept: list[Point] = []
    for p in sorted(points, key=lambda p: p.cost):
        if all(abs(p.coordinates[along] - k.coordinates[along]) > near for k in kept):
            kept.append(p)
    return kept

"""Dips of the cost in density: found, and told apart.

Density is seen where the rays end, and each of the shader's n taps leaves a band there, so that the
cost has a dip for every band, some 1/n of density apart. ``reseed`` walks along the valley, the
other coordinates following, and tries the other dips on a few thousand pixels; ``next_dips`` and
``rivals`` hold the neighbours against each other on more.
"""

from __future__ import annotations

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.inference import Evidence, evidence, misfit
from godfit.likelihood import deviance_residuals
from godfit.models import AbstractModel, Vector
from godfit.observation import Observation, Picture, blurred
from godfit.search import (
    EXPLAINED,
    LADDER,
    PIXELS,
    SIGMAS,
    WITHIN_ROUNDING,
    Settled,
    settle,
)
from godfit.side_by_side import side_by_side
from godfit.solver import Point, solve

CORRECTIONS = 3
# A dip of density is about 1/samples wide.
FAR_VALUES, NEAR_VALUES = 400, 120
# Ends of solves, apart and cheapest first, that are worth a noise of their own.
SETTLED = 4
# Pixels that are enough to see where the dips are.
SCAN_PIXELS = 1 << 9
# Dips either way that are looked into on more pixels, and how many of them are tried.
RIVAL_PIXELS, RIVAL_DIPS, RIVALS = 1 << 14, 6, 2
# Log-likelihood on the subset by which a point may fall behind and still be tried on all pixels.
DOUBT = 8.0
CANDIDATES = 3
# More levels than a wrong dip leaves: the model is another, and no density will do.
HOPELESS = 6.0
# And more than a wrong dip of the right model leaves.
FOREIGN = 20.0
MAX_DIPS = 5
# A right answer to a picture that is only rounded leaves less noise than this.
CONTENT = 1.3 * SIGMAS[0]
MAX_RESEEDS = 3
MAX_RIVALRIES = 4


def on_subset(
    picture: Picture,
    model: AbstractModel,
    coordinates: np.ndarray,
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
    say: Callable[[str], None],
) -> list[np.ndarray]:
    """Sharp images, a few thousand pixels: the best point, and where density is in doubt, those
    that all pixels must decide between."""
    seen = picture.observe(picture.informative(PIXELS, seed))
    settled, tangent = settle(coordinates, model, seen, free, held)
    along, dip, doubtful = _dips(settled, evidence(settled, tangent, seen), model, free)
    if not free[along] or (not doubtful and settled.sigma < 2 * SIGMAS[0]):
        return [settled.coordinates]
    if settled.sigma > FOREIGN:
        return [settled.coordinates]
    say("other densities")
    found = reseed(settled, along, model, picture, free, held, seed)
    for _ in range(MAX_RESEEDS):
        best = found[0]
        if best.sigma < EXPLAINED or best.sigma > HOPELESS:
            break
        if _like_noise(best, model, seen, held):
            break
        again = correct(best.coordinates, model, picture, free, held, seed)
        again, _ = settle(again, model, seen, free, held)
        if again.log_likelihood < best.log_likelihood:
            again = best
        found = reseed(again, along, model, picture, free, held, seed)
        if found[0].log_likelihood < best.log_likelihood + 1:
            break
    if found[0].sigma > HOPELESS and not _like_noise(found[0], model, seen, held):
        return [found[0].coordinates]
    close: list[Settled] = []
    for other in found:
        apart = all(abs(other.coordinates[along] - c.coordinates[along]) > dip / 20 for c in close)
        if apart and other.log_likelihood > found[0].log_likelihood - DOUBT:
            close.append(other)
    return [c.coordinates for c in close[:CANDIDATES]]


def _hopeless(settled: Settled, at: Evidence, seen: Observation) -> bool:
    return settled.sigma > HOPELESS and not misfit(at.prediction, seen).like_noise


def _like_noise(at: Settled, model: AbstractModel, seen: Observation, held: np.ndarray) -> bool:
    fitted = model.moved(jnp.asarray(at.coordinates), jnp.asarray(held))
    return misfit(np.asarray(seen.predict(fitted)), seen).like_noise


def _dips(
    settled: Settled, at: Evidence, model: AbstractModel, free: np.ndarray
) -> tuple[int, float, bool]:
    """Index of density, the distance between two dips of the cost in it (one band, a shift of the
    rays' end by one tap), and whether its error is wide enough for another dip to be the right one.
    """
    along = list(model.parameters).index("density")
    dip = float(settled.coordinates[along]) / model.samples
    variance = at.covariance(free)[along, along]
    return along, dip, bool(free[along] and variance > (dip / 20) ** 2)


def next_dips(
    settled: Settled,
    at: Evidence,
    model: AbstractModel,
    seen: Observation,
    free: np.ndarray,
    held: np.ndarray,
) -> tuple[Settled, Evidence]:
    """From dip to dip, both ways, as long as the likelihood of all pixels gains."""
    along, dip, doubtful = _dips(settled, at, model, free)
    if not doubtful or _hopeless(settled, at, seen):
        return settled, at
    covariance = at.covariance(free)
    follow = covariance[:, along] / covariance[along, along]
    for way in (-dip, dip):
        for _ in range(MAX_DIPS):
            start = (settled.coordinates + way * follow).astype(np.float32)
            other, tangent = settle(start, model, seen, free, held)
            if other.log_likelihood <= settled.log_likelihood + 0.5:
                break
            settled, at = other, evidence(other, tangent, seen)
    return settled, at


def beat_rivals(
    settled: Settled,
    at: Evidence,
    model: AbstractModel,
    picture: Picture,
    seen: Observation,
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
) -> tuple[Settled, Evidence]:
    """The likeliest of the dips around, on all pixels of ``seen``. With noise a wrong dip looks as
    good as the right one until they are held against each other."""
    for _ in range(MAX_RIVALRIES):
        along, dip, _ = _dips(settled, at, model, free)
        if not free[along] or settled.sigma < WITHIN_ROUNDING:
            break
        if _hopeless(settled, at, seen):
            break
        before = settled.log_likelihood
        count = min(RIVAL_PIXELS, len(seen.pixels) // 4)
        for z in rivals(settled, along, dip, model, picture, free, held, seed, count):
            other, tangent = settle(z, model, seen, free, held)
            if other.log_likelihood > settled.log_likelihood:
                settled, at = other, evidence(other, tangent, seen)
        if settled.log_likelihood < before + 0.5:
            break
    return settled, at


def beat_distant(
    settled: Settled,
    at: Evidence,
    model: AbstractModel,
    picture: Picture,
    seen: Observation,
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
) -> tuple[Settled, Evidence]:
    """The likeliest of dips anywhere, on all pixels of ``seen``, where what is left is less than
    rounding would hide and yet more than a right answer leaves: short rays say so little of density
    that a few thousand pixels are content with a wrong one."""
    for _ in range(MAX_RESEEDS):
        along, dip, _ = _dips(settled, at, model, free)
        if not free[along] or not CONTENT < settled.sigma < WITHIN_ROUNDING:
            break
        before = settled
        found = reseed(settled, along, model, picture, free, held, seed, count=RIVAL_PIXELS)
        tried = [before.coordinates[along]]
        for other in found:
            if min(abs(other.coordinates[along] - t) for t in tried) < dip / 2:
                continue
            tried.append(other.coordinates[along])
            here, tangent = settle(other.coordinates, model, seen, free, held)
            if here.log_likelihood > settled.log_likelihood:
                settled, at = here, evidence(here, tangent, seen)
            if len(tried) > RIVALS:
                break
        if settled.log_likelihood < before.log_likelihood + 1:
            break
    return settled, at


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
    pixels: where noise hides the bands, a few thousand cannot tell one dip from another."""
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
    around = np.pad(costs, 1, constant_values=np.inf)
    dips = np.flatnonzero(np.isfinite(costs) & (costs <= around[:-2]) & (costs <= around[2:]))
    best = dips[np.argsort(costs[dips])][:RIVALS]
    begun = line[best].astype(np.float32)
    return side_by_side(lambda z: solve(z, free, held, model, seen, start.sigma).coordinates, begun)


def correct(
    start: np.ndarray,
    model: AbstractModel,
    picture: Picture,
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
) -> np.ndarray:
    """Down the ladder again with its bias taken out.

    A picture from a blurred mask is not the blurred picture: far along the ray the mask should be
    blurred less, which draws density away from 1. The difference between the two at the present
    point is added to the blurred target, as coarse levels are corrected in multigrid (the full
    approximation scheme: Brandt, Math. Comp. 31 (1977), 333).
    """
    pixels = picture.informative(PIXELS, seed)
    lower, upper = (np.asarray(b, np.float32) for b in model.bounds())
    z = start
    for share, _, sigma in LADDER:
        blur = share * max(picture.size)
        seen = picture.observe(pixels, blur)
        for _ in range(CORRECTIONS):
            at = model.moved(jnp.asarray(z), jnp.asarray(held))
            sharp = picture.rendered(at)
            coarse = seen.predict(at)
            bias = coarse - blurred(sharp, blur).reshape(-1, picture.channels)[pixels].reshape(-1)
            shifted = eqx.tree_at(lambda s: (s.lo, s.hi), seen, (seen.lo + bias, seen.hi + bias))
            z = solve(z, free, held, model, shifted, sigma, bounded=False).coordinates
            z = np.clip(z, lower, upper)
    return z


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
        return 0.5 * (deviance_residuals(prediction, seen.lo, seen.hi, sigma) ** 2).sum()

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

    def bottoms(line: np.ndarray) -> list[Point]:
        points = line.astype(np.float32)
        costs = np.asarray(_costs(jnp.asarray(points), held, model, scanned, jnp.float32(sigma)))
        costs = np.where(np.isfinite(costs), costs, np.inf)
        around = np.pad(costs, 1, constant_values=np.inf)
        dips = np.flatnonzero((costs <= around[:-2]) & (costs <= around[2:]))
        return [Point(points[i], float(costs[i]), False, 0) for i in dips]

    dip = float(here) / model.samples
    begun = _apart([p for line in side_by_side(bottoms, lines) for p in line], along, dip / 4)
    points = side_by_side(
        lambda p: solve(p.coordinates, free, held, model, seen, sigma), begun[:tries]
    )
    points = _apart(points, along, dip / 20)
    found = side_by_side(
        lambda p: settle(p.coordinates, model, seen, free, held)[0], points[:SETTLED]
    )
    return sorted([start, *found], key=lambda s: -s.log_likelihood)


def _apart(points: list[Point], along: int, near: float) -> list[Point]:
    """Points, cheapest first, none of them within ``near`` of a cheaper one in ``along``."""
    kept: list[Point] = []
    for p in sorted(points, key=lambda p: p.cost):
        if all(abs(p.coordinates[along] - k.coordinates[along]) > near for k in kept):
            kept.append(p)
    return kept

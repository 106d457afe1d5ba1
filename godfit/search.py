"""From starting points to the neighbourhood of the best fit, on a few thousand pixels.

Coarse to fine: target and mask are blurred by the same amount, the blur is lowered in steps, and
starts that fall behind are dropped. Density needs more: it is seen where the rays end, and each of
the shader's n taps leaves a band there, so that the cost has a dip for every band. ``reseed`` walks
along the valley, the other coordinates following, and tries the other dips.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.likelihood import deviance_residuals, log_likelihood
from godfit.models import AbstractModel, Values, Vector
from godfit.observation import Observation, Picture, blurred
from godfit.solver import Point, linearise, scales, solve, solve_tangent

PIXELS = 2048
# Blur (as a share of the longer side), starts kept, sigma in levels.
LADDER = ((1 / 64, 3, 4.0), (1 / 128, 2, 2.0), (1 / 256, 1, 1.0), (1 / 512, 1, 1.0))
CORRECTIONS = 3
# A dip of density is about 1/samples wide.
FAR_VALUES = 400
# Noise below this many levels means that even the rounding of every pixel is explained.
EXPLAINED = 0.05
# Noise below this is lost in the rounding: masks that were rounded themselves leave as much.
WITHIN_ROUNDING = 0.125
# Levels, from well under the least that float32 leaves to the coarsest that means anything.
WALLS = 1 << 15
# Gain in log-likelihood for which pixels are not rendered again: kinks of the mask make it jump by
# as much between one float32 and the next.
SHORT = 4.0
SIGMA_VALUES = 1 << 14
SIGMAS = (0.005 * 3.0 ** np.arange(10)).astype(np.float32)


@jax.jit
def _log_likelihoods(
    prediction: Values,
    lo: Values,
    hi: Values,
    sigmas: Float[Array, " s"] | Float[np.ndarray, " s"],
) -> Float[Array, " s"]:
    pixels = jnp.asarray(prediction), jnp.asarray(lo), jnp.asarray(hi)

    def total(sigma):
        return log_likelihood(pixels[0], pixels[1], pixels[2], sigma).sum()

    return jax.lax.map(total, jnp.asarray(sigmas))


def best_sigma(prediction: np.ndarray, seen: Observation) -> tuple[float, float]:
    """Noise in levels that makes the pixels likeliest, and their log-likelihood.

    A grid of sigmas is refined by finer ones about its best, on a part of the pixels that is
    enough to know sigma to a percent.
    """
    values = prediction, seen.lo, seen.hi
    if prediction.shape[0] > SIGMA_VALUES:
        # Drawn at random: a regular stride would fall into step with the rows.
        part = np.random.default_rng(0).integers(0, prediction.shape[0], SIGMA_VALUES)
        values = tuple(np.asarray(z)[part] for z in values)
    sigmas, ratio = SIGMAS, SIGMAS[1] / SIGMAS[0]
    for _ in range(4):
        best = sigmas[int(np.nanargmax(_log_likelihoods(*values, sigmas)))]
        ratio **= 0.25
        sigmas = best * ratio ** np.linspace(-4.5, 4.5, len(SIGMAS))
        sigmas = np.clip(sigmas, SIGMAS[0], SIGMAS[-1]).astype(np.float32)
    return float(best), log_likelihood_at(prediction, seen, float(best))


def log_likelihood_at(prediction: np.ndarray, seen: Observation, sigma: float) -> float:
    """Log-likelihood of all pixels."""
    sigmas = np.full(1, sigma, np.float32)
    return float(_log_likelihoods(prediction, seen.lo, seen.hi, sigmas)[0])


def climb(
    picture: Picture,
    model: AbstractModel,
    starts: list[np.ndarray],
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
    report: Callable[[str], None],
) -> Point:
    """The best of ``starts`` after the ladder of blurs."""
    pixels = picture.informative(PIXELS, seed)
    points = [Point(start, np.inf, False, 0) for start in starts]
    for share, keep, sigma in LADDER:
        seen = picture.observe(pixels, share * max(picture.size))
        report(f"{len(points)} starts, blur of {share * max(picture.size):.1f} pixels")
        points = [
            solve(p.coordinates, free, held, model, seen, sigma, bounded=False) for p in points
        ]
        points.sort(key=lambda p: p.cost)
        points = _distinct(points)[:keep]
    seen = picture.observe(pixels)
    return solve(points[0].coordinates, free, held, model, seen, 0.3)


def _distinct(points: list[Point]) -> list[Point]:
    """Points, cheapest first, that have not run into a cheaper one; where the picture leaves a
    coordinate open, such points agree in cost and in the places they put the light and density."""
    kept: list[Point] = []
    for p in points:
        if not any(
            abs(p.cost - q.cost) < 0.01 * q.cost
            and np.allclose(p.coordinates[2:], q.coordinates[2:], rtol=0.02, atol=0.01)
            for q in kept
        ):
            kept.append(p)
    return kept


class Settled(NamedTuple):
    """Coordinates and noise (levels) that suit each other; ``quiet`` when neither moved."""

    coordinates: np.ndarray
    sigma: float
    log_likelihood: float
    quiet: bool


class Tangent(NamedTuple):
    """The model about a point: levels (m,), derivatives (m, p) by coordinates over ``scale``."""

    prediction: np.ndarray
    jacobian: np.ndarray
    scale: np.ndarray


def settle(
    start: np.ndarray,
    model: AbstractModel,
    seen: Observation,
    free: np.ndarray,
    held: np.ndarray,
    *,
    rounds: int = 10,
) -> tuple[Settled, Tangent]:
    """Coordinates and noise that suit each other, until the log-likelihood stands still.

    The pixels are rendered once for each round. In between, the likelihood, which is far from
    quadratic when sigma is small, is solved on the tangent, with sigma and coordinates in turn.
    """

    def render(z):
        scale = scales(z)
        prediction, jacobian = linearise(z, held, scale, model, seen)
        return Tangent(np.asarray(prediction), np.asarray(jacobian), scale)

    tangent = render(start)
    sigma, likelihood = best_sigma(tangent.prediction, seen)
    best = Settled(start, sigma, likelihood, False)
    part = 1.0
    for _ in range(rounds):
        aim, there = _aim(best, tangent, model, seen, free)
        if aim.log_likelihood < best.log_likelihood + SHORT:
            # So short a step that the tangent is as good as another rendering.
            return aim, there
        z = best.coordinates + np.float32(part) * (aim.coordinates - best.coordinates)
        there = render(z)
        sigma, likelihood = best_sigma(there.prediction, seen)
        gained = likelihood - best.log_likelihood
        if gained > 0:
            best, tangent = Settled(z, sigma, likelihood, False), there
            part = 1.0
        elif part < 1:
            # On a kink, where neither the whole step nor a part of it gains, there is no further.
            return best._replace(quiet=True), tangent
        else:
            # Over a kink of the bilinear mask the tangent promises too much.
            part = 0.25
        if abs(gained) < 0.5:
            return best._replace(quiet=True), tangent
    return best, tangent


def _aim(
    at: Settled, tangent: Tangent, model: AbstractModel, seen: Observation, free: np.ndarray
) -> tuple[Settled, Tangent]:
    """Where the tangent's likelihood is largest, with the tangent taken there."""
    z, sigma, likelihood = at.coordinates, at.sigma, at.log_likelihood
    lo, hi = np.asarray(seen.lo), np.asarray(seen.hi)
    for _ in range(5):
        rows = slice(None)
        if sigma < EXPLAINED:
            rows = _near_walls(tangent.prediction, lo, hi)
        jacobian = tangent.jacobian[rows]
        moved = tangent.prediction[rows] + jacobian @ ((z - at.coordinates) / tangent.scale)
        z = solve_tangent(
            z, free, model, tangent.scale, moved, jacobian, lo[rows], hi[rows], sigma
        ).coordinates
        moved = tangent.prediction + tangent.jacobian @ ((z - at.coordinates) / tangent.scale)
        before, (sigma, likelihood) = sigma, best_sigma(moved, seen)
        if abs(sigma - before) < 0.05 * before:
            break
    if likelihood <= at.log_likelihood:
        return at._replace(quiet=True), tangent
    return Settled(z, sigma, likelihood, True), tangent._replace(prediction=moved)


def _near_walls(prediction: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> np.ndarray | slice:
    """The values nearest to the ends of their intervals. Where rounding is all the noise there is,
    the others are far inside and have no say."""
    if prediction.shape[0] <= WALLS:
        return slice(None)
    slack = np.minimum(prediction - lo, hi - prediction)
    return np.sort(np.argpartition(slack, WALLS)[:WALLS])


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
    tries: int = 6,
) -> list[Settled]:
    """Walk along the valley of coordinate ``along`` and settle anew in its deepest dips; the best
    first, ``start`` among them."""
    pixels = picture.informative(PIXELS, seed)
    seen = picture.observe(pixels)
    smooth = picture.observe(pixels, LADDER[1][0] * max(picture.size))
    lower, upper = (np.asarray(b, np.float32) for b in model.bounds())
    at = start.coordinates
    here = at[along]
    # Two lines through the start: one where all other coordinates follow along the valley's floor,
    # one where only those that the image is linear in do, for a start that is right but for this.
    linear = free & model.linear()
    lines = []
    for moving in (free, linear):
        switch = moving.astype(np.float32)
        switch[along] = 1
        follow = np.asarray(_valley(jnp.asarray(at), switch, held, along, model, smooth))
        near = here * (1 + np.linspace(-0.06, 0.06, 121))
        far = np.linspace(max(lower[along], 0.05), upper[along], FAR_VALUES)
        values = np.sort(np.concatenate([near, far]))
        values = values[(values >= lower[along]) & (values <= upper[along])]
        lines.append(np.clip(at + np.outer(values - here, follow), lower, upper))
    # As sharp as the start is good: a blunter likelihood cannot tell the dips apart, a sharper one
    # sees nothing of those whose bottom lies a little beside the line.
    sigma = float(np.clip(start.sigma, 0.02, 0.3))
    begun: list[np.ndarray] = []
    for line in lines:
        costs = np.asarray(
            _costs(jnp.asarray(line, jnp.float32), held, model, seen, jnp.float32(sigma))
        )
        costs = np.where(np.isfinite(costs), costs, np.inf)
        around = np.pad(costs, 1, constant_values=np.inf)
        dips = np.flatnonzero((costs <= around[:-2]) & (costs <= around[2:]))
        begun += list(line[dips[np.argsort(costs[dips])][:tries]].astype(np.float32))
    found = [start]
    for z in begun:
        point = solve(z, free, held, model, seen, sigma)
        found.append(settle(point.coordinates, model, seen, free, held)[0])
    return sorted(found, key=lambda s: -s.log_likelihood)

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
from godfit.models import AbstractModel
from godfit.observation import Observation, Picture
from godfit.solver import Point, solve

PIXELS = 2048
# Blur (as a share of the longer side), starts kept, sigma in levels.
LADDER = ((1 / 64, 4, 4.0), (1 / 128, 2, 2.0), (1 / 256, 1, 1.0), (1 / 512, 1, 1.0))
# Noise below this many levels means that even the rounding of every pixel is explained.
EXPLAINED = 0.05
# Levels, from well under the least that float32 leaves to the coarsest that means anything.
SIGMAS = np.geomspace(0.005, 81.92, 15).astype(np.float32)


@eqx.filter_jit
def _log_likelihoods(
    coordinates: Float[Array, " p"],
    held: Float[Array, " p"],
    model: AbstractModel,
    seen: Observation,
    sigmas: Float[Array, " s"],
) -> Float[Array, " s"]:
    prediction = seen.predict(model.moved(coordinates, held))
    return jax.lax.map(lambda s: log_likelihood(prediction, seen.lo, seen.hi, s).sum(), sigmas)


def best_sigma(
    coordinates: np.ndarray, held: np.ndarray, model: AbstractModel, seen: Observation
) -> tuple[float, float]:
    """Noise in levels that makes the pixels likeliest at ``coordinates``, and their log-likelihood.

    The grid of sigmas is refined by a parabola in log sigma about the best, twice.
    """

    def evaluate(sigmas):
        return np.asarray(
            _log_likelihoods(
                jnp.asarray(coordinates), jnp.asarray(held), model, seen, jnp.asarray(sigmas)
            ),
            np.float64,
        )

    sigmas = SIGMAS
    values = evaluate(sigmas)
    ratio = SIGMAS[1] / SIGMAS[0]
    for _ in range(2):
        best = int(np.nanargmax(values))
        ratio **= 0.25
        sigmas = (sigmas[best] * ratio ** np.linspace(-7, 7, len(SIGMAS))).astype(np.float32)
        sigmas = np.clip(sigmas, SIGMAS[0], SIGMAS[-1])
        values = evaluate(sigmas)
    best = int(np.nanargmax(values))
    return float(sigmas[best]), float(values[best])


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
        points = [solve(p.coordinates, free, held, model, seen, sigma) for p in points]
        points.sort(key=lambda p: p.cost)
        points = _distinct(points)[:keep]
    return points[0]


def _distinct(points: list[Point]) -> list[Point]:
    """Points that have not run into a better one."""
    kept: list[Point] = []
    for p in points:
        if not any(np.allclose(p.coordinates, q.coordinates, rtol=0.02, atol=0.01) for q in kept):
            kept.append(p)
    return kept


class Settled(NamedTuple):
    """Coordinates and noise (levels) that suit each other; ``quiet`` when neither moved any more."""

    coordinates: np.ndarray
    sigma: float
    log_likelihood: float
    quiet: bool


def settle(
    start: np.ndarray,
    model: AbstractModel,
    seen: Observation,
    free: np.ndarray,
    held: np.ndarray,
    sigma: float,
    *,
    rounds: int = 8,
) -> Settled:
    """Coordinates and noise in turn, until the log-likelihood gains less than 1/2."""
    best = Settled(start, sigma, -np.inf, False)
    for _ in range(rounds):
        point = solve(best.coordinates, free, held, model, seen, best.sigma, release=True)
        sigma, likelihood = best_sigma(point.coordinates, held, model, seen)
        gained = likelihood - best.log_likelihood
        if gained > 0:
            best = Settled(point.coordinates, sigma, likelihood, False)
        if gained < 0.5:
            return best._replace(quiet=True)
    return best


@eqx.filter_jit
def _valley(
    coordinates: Float[Array, " p"],
    free: Float[Array, " p"],
    held: Float[Array, " p"],
    along: int,
    model: AbstractModel,
    seen: Observation,
) -> Float[Array, " p"]:
    """How the other coordinates follow coordinate ``along`` on the valley's floor."""
    jacobian = jax.jacfwd(lambda z: seen.predict(model.moved(z, held)))(coordinates)
    inside = jnp.isfinite(seen.lo) & jnp.isfinite(seen.hi)
    jacobian = jnp.where(inside[:, None], jacobian, 0.0) * free
    size = jnp.sqrt((jacobian**2).sum(0))
    size = jnp.where(size > 0, size, 1.0)
    others = (jacobian / size).at[:, along].set(0.0)
    follow = -jnp.linalg.lstsq(others, jacobian[:, along], rcond=1e-4)[0] / size
    return follow.at[along].set(1.0)


@eqx.filter_jit
def _costs(
    points: Float[Array, "n p"],
    held: Float[Array, " p"],
    model: AbstractModel,
    seen: Observation,
    sigma: Float[Array, ""],
) -> Float[Array, " n"]:
    def cost(z):
        prediction = seen.predict(model.moved(z, held))
        return 0.5 * (deviance_residuals(prediction, seen.lo, seen.hi, sigma) ** 2).sum()

    return jax.lax.map(cost, points)


def reseed(
    start: np.ndarray,
    along: int,
    model: AbstractModel,
    picture: Picture,
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
    *,
    tries: int = 6,
    sigma: float = 0.3,
) -> Point:
    """Walk along the valley of coordinate ``along`` and solve again from its deepest dips."""
    pixels = picture.informative(PIXELS, seed)
    seen = picture.observe(pixels)
    smooth = picture.observe(pixels, LADDER[1][0] * max(picture.size))
    lower, upper = (np.asarray(b, np.float32) for b in model.bounds())
    follow = np.asarray(
        _valley(
            jnp.asarray(start), jnp.asarray(free, jnp.float32), jnp.asarray(held), along, model, smooth
        )
    )
    here = start[along]
    # Finer near by, where the dips of single bands lie; a hundredth apart over the whole range.
    near = here * (1 + np.linspace(-0.06, 0.06, 121))
    far = np.geomspace(max(lower[along], 0.05), upper[along], 200)
    values = np.sort(np.concatenate([near, far]))
    values = values[(values >= lower[along]) & (values <= upper[along])]
    line = start + np.outer(values - here, follow).astype(np.float32)
    line = np.clip(line, lower, upper).astype(np.float32)
    costs = np.asarray(
        _costs(jnp.asarray(line), jnp.asarray(held), model, seen, jnp.float32(sigma))
    )
    order = np.argsort(np.where(np.isfinite(costs), costs, np.inf))
    chosen: list[int] = []
    for i in order:
        if all(abs(values[i] / values[j] - 1) > 0.002 for j in chosen):
            chosen.append(int(i))
        if len(chosen) == tries:
            break
    points = [solve(line[i], free, held, model, seen, sigma) for i in chosen]
    return min(points, key=lambda p: p.cost)

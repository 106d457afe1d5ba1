"""The posterior of a fit: NUTS on the likelihood of the fitted picture.

The prior is flat in the fit's coordinates inside their bounds and in the logarithm of the noise,
times the Gaussian priors of the fit.
The model is replaced by its tangent, which is rendered once. All values of the picture count, so
that the tangent is the only approximation. Draws are made with the No-U-Turn sampler (Hoffman &
Gelman, JMLR 15 (2014), 1593) of blackjax, in coordinates that the fit's covariance whitens.
Coordinates beyond a bound are mirrored at it. Where values share noise, draws are stretched until
their covariance is the fit's (Ribatet, Cooley & Davison, Statistica Sinica 22 (2012), 813).
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.errors import LIKELIHOOD_INCOMPLETE, InputError
from godfit.inference.allowances.arithmetic import with_arithmetic
from godfit.inference.information import evidence
from godfit.inference.likelihood import interval
from godfit.inference.noise import SIGMAS, noise_of
from godfit.inference.observation import Observation
from godfit.inference.problem import pixels_used
from godfit.inference.repeated_values import relieved
from godfit.inference.settle import Settled
from godfit.inference.solver import tangent_at
from godfit.models.base import AbstractModel
from godfit.report.result import FitResult
from godfit.runtime.guest import as_guest

POSTERIOR_DRAWS = 4000
"""Draws of the posterior: an end of the middle 95% then has 100 of them beyond it."""
WARM_UP_STEPS = 500
"""Steps in which the sampler adapts its step size and mass matrix: coordinates are whitened."""
CREDIBLE_QUANTILES = (0.025, 0.975)
"""Quantiles between which the middle 95% lies."""
COVARIANCE_JITTER = 1e-9
"""Added to the unit diagonal of the covariance, which rounding may make singular."""


@dataclasses.dataclass(frozen=True, eq=False)
class Posterior:
    """``draws`` (n, p) of the parameters ``names``, in their units; ``noise_levels`` (n,);
    ``divergent`` is the share of steps at which the sampler's trajectory diverged."""

    names: tuple[str, ...]
    draws: Float[np.ndarray, "n p"]
    noise_levels: Float[np.ndarray, " n"]
    divergent: float

    def interval(self, name: str) -> tuple[float, float]:
        """The middle 95% of a parameter's draws."""
        low, high = np.quantile(self.draws[:, self.names.index(name)], CREDIBLE_QUANTILES)
        return float(low), float(high)


def require() -> None:
    """Raise InputError in one line where blackjax is missing."""
    try:
        import blackjax  # noqa: F401
    except ImportError:
        raise InputError(
            "posterior: expected blackjax, got none; pip install 'godfit[posterior]'"
        ) from None


def with_posterior(result: FitResult, drawn: Posterior) -> FitResult:
    """``result`` with the middle 95% of the posterior of every parameter that is determined."""
    params = {
        name: e
        if e.fixed or e.stderr is None
        else dataclasses.replace(e, posterior=drawn.interval(name))
        for name, e in result.params.items()
    }
    return dataclasses.replace(result, params=params)


def posterior(
    result: FitResult, *, draws: int = POSTERIOR_DRAWS, warm_up: int = WARM_UP_STEPS, seed: int = 0
) -> Posterior:
    """Draws from the posterior about a fit. Raises InputError without blackjax, for a fit without
    a mask or a scene, for one with simulated errors, and for one that did not converge: its tangent
    is not a valid approximation."""
    require()
    if result.picture.foreign:
        raise InputError("posterior: expected a fit with a mask or a scene, got neither; give one")
    if result.simulated:
        raise InputError(LIKELIHOOD_INCOMPLETE.format("posterior"))
    if not result.converged:
        raise InputError(f"posterior: expected a fit that converged, got: {result.message}")
    with as_guest(), jax.numpy_rank_promotion("allow"):
        return _posterior(result, draws, warm_up, seed)


def _posterior(result: FitResult, draws: int, warm_up: int, seed: int) -> Posterior:
    model, picture, free = result.model, result.picture, np.asarray(result.free)
    problem = result.problem
    observation = picture.observe(pixels_used(picture, result.seed))
    z = np.asarray(model.coordinates(), np.float32)
    tangent = tangent_at(z, problem, observation)
    scale = tangent.scale
    observation = with_arithmetic(observation, problem, z, tangent)
    observation = relieved(observation, tangent.prediction, result.noise_levels)
    at = evidence(Settled(z, result.noise_levels, 0.0, True), tangent, observation)
    moving = np.flatnonzero(free)

    def root_of(covariance: np.ndarray) -> np.ndarray:
        block = covariance[np.ix_(moving, moving)]
        size = np.sqrt(np.diag(block))
        jitter = COVARIANCE_JITTER * np.eye(len(moving))
        return size[:, None] * np.linalg.cholesky(block / np.outer(size, size) + jitter)

    root = root_of(at.covariance(free))
    # The likelihood takes noise that values share for their own.
    alone = root_of(at.without_shared_noise().covariance(free))
    # Derivatives of the levels by whitened coordinates.
    rows = jnp.asarray((alone / scale[moving, None]).T @ tangent.jacobian[moving], jnp.float32)
    lower, upper = ((np.asarray(b) - z)[moving] for b in model.bounds())
    # The pixels of an upsampled pass share its texels.
    share = picture.independent(model)
    floor = float(SIGMAS[0])
    start = float(np.log(max(result.noise_levels, floor) / floor))
    # The standard error of the logarithm of the noise from n values.
    unit = (2 * share * len(tangent.prediction)) ** -0.5
    density = _density(jnp.asarray(tangent.prediction), rows, observation, floor, share)

    def inside(u):
        """Steps in coordinates, mirrored at the bounds."""
        step = jnp.asarray(root, jnp.float32) @ u
        step = jnp.where(step < lower, 2 * lower - step, step)
        return jnp.where(step > upper, 2 * upper - step, step)

    def log_prior(step):
        """The logarithm of the priors' density, by the parameters themselves."""
        if not result.prior:
            return 0.0
        values = _moved(result, z, moving, step).values()
        excess = [(values[n] - mean) / sigma for n, (mean, sigma) in result.prior.items()]
        return -0.5 * jnp.square(jnp.stack(excess)).sum()

    back = jnp.asarray(np.linalg.inv(root), jnp.float32)
    bounded = bool(np.isfinite(lower).any() or np.isfinite(upper).any())

    def logdensity(point):
        u = back @ inside(point[:-1]) if bounded else point[:-1]
        return density(u, jnp.abs(unit * point[-1])) + log_prior(inside(point[:-1]))

    import blackjax

    init = jnp.zeros(len(moving) + 1, jnp.float32).at[-1].set(start / unit)
    tune, run = jax.random.split(jax.random.key(seed))
    adapt = blackjax.window_adaptation(blackjax.nuts, logdensity)
    (state, found), _ = adapt.run(tune, init, num_steps=warm_up)  # pyright: ignore
    step = blackjax.nuts(logdensity, **found).step

    @jax.jit
    def chain(state, key):
        def one(state, key):
            state, info = step(key, state)
            return state, (state.position, info.is_divergent)  # pyright: ignore

        return jax.lax.scan(one, state, jax.random.split(key, draws))[1]

    points, divergent = chain(state, run)
    steps = np.asarray(jax.vmap(inside)(points[:, :-1]), np.float64)
    numbers = _parameters(result, z, moving, steps)
    noise = floor * np.exp(np.abs(unit * np.asarray(points[:, -1], np.float64)))
    return Posterior(tuple(model.parameters), numbers, noise, float(np.mean(divergent)))


def _parameters(result: FitResult, z, moving: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """(n, p) parameters at steps from ``z``, by the model itself: the map is not linear."""

    def values(step):
        return jnp.stack(list(_moved(result, z, moving, step).values().values()))

    return np.asarray(jax.lax.map(values, jnp.asarray(steps, jnp.float32)), np.float64)


def _moved(result: FitResult, z, moving: np.ndarray, step) -> AbstractModel:
    """The model at a ``step`` (q,) from ``z`` (p,) in the ``moving`` coordinates."""
    return result.model.moved(jnp.asarray(z).at[moving].add(step), jnp.asarray(result.held))


def _density(prediction, rows, observation: Observation, floor: float, share: float):
    """Log-likelihood by whitened coordinates (q,) and the logarithm of the noise over ``floor``,
    with its slopes, computed in the same pass over the values."""

    @jax.custom_vjp
    def density(u: Float[Array, " q"], s: Float[Array, ""]) -> Float[Array, ""]:
        return both(u, s)[0]

    lo, hi, own_noise = observation.lo, observation.hi, observation.own_noise

    def both(u, s):
        sigma = floor * jnp.exp(s)
        noise = noise_of(sigma, own_noise)
        levels = prediction + u @ rows
        pixel = interval((lo - levels) / noise, (hi - levels) / noise)
        # The likelihood of a point is the density: see ``likelihood.log_likelihood``.
        log = jnp.where(lo == hi, pixel.log - jnp.log(noise), pixel.log).sum()
        by_u = rows @ (pixel.slope / noise)
        # The noise grows with its logarithm by the share that the common noise has of it.
        by_s = -((pixel.curvature - pixel.slope**2) * jnp.square(sigma / noise)).sum()
        return share * log, (share * by_u, share * by_s)

    def backward(slopes, by):
        return by * slopes[0], by * slopes[1]

    density.defvjp(both, backward)
    return density

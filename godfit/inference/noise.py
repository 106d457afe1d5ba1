"""The standard deviation of the noise with the largest likelihood, and that likelihood."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from godfit.inference.likelihood import log_likelihood
from godfit.inference.observation import Observation
from godfit.runtime.program_cache import cached_jit

EXPLAINED = 0.05
"""Noise in levels below which even the rounding of every pixel is explained."""
WITHIN_ROUNDING = 0.125
"""Noise in levels below which it is lost in the rounding: masks that were rounded themselves cause
as much."""
SINGLE_PRECISION = 1e-4
"""Levels by which a prediction in single precision is off, at 255: up to .7 of it in root mean
square on real frames."""
SIGMA_VALUES = 1 << 12
"""Values that sigma is estimated from during a fit, to a share of 1 / sqrt(2 n), one percent."""
FINAL_SIGMA_VALUES = 1 << 15
"""Values that sigma is estimated from at the end of a fit, to 0.4 percent."""
SIGMA_RATIO = 3.0
"""Ratio of neighbouring sigmas of the coarsest grid; finer grids follow about the best one."""
SIGMAS = (0.005 * SIGMA_RATIO ** np.arange(10)).astype(np.float32)
"""Grid of sigmas in levels, from well under the error of float32 to a third of the whole scale."""
MIDDLE_SIGMA = float(np.sqrt(SIGMAS[0] * SIGMAS[-1]))
"""Level about which the coarsest grid is centred: the middle of SIGMAS on a logarithmic scale."""


def noise_of(sigma: Any, own_noise: Any) -> Any:
    """Noise of each value in levels, (m,): the common ``sigma`` and its own; () without that.

    The least sigma stands for an arithmetic that is not known. A value's own noise is what is known
    of it, and takes its place."""
    if own_noise is None:
        return sigma
    least = SIGMAS[0]
    return (abs(sigma * sigma - least * least) + own_noise * own_noise) ** 0.5


def _total(values, sigma, foreign):
    prediction, lo, hi, own_noise = values
    return log_likelihood(prediction, lo, hi, noise_of(sigma, own_noise), foreign).sum()


@cached_jit
def _likeliest(prediction, walls, middle, first, last, part_of: int, foreign: float):
    """Sigma, the log-likelihood of all values there, and whether the first grid had it inside."""
    values = prediction, *walls
    sample = values
    if prediction.shape[0] > part_of:
        # Drawn at random: a regular stride would fall into step with the rows.
        part = np.random.default_rng(0).integers(0, prediction.shape[0], part_of)
        sample = tuple(None if z is None else z[part] for z in values)

    def finer(k, state):
        middle, within = state
        step = math.log(SIGMA_RATIO) * 0.25 ** k.astype(middle.dtype)
        places = jnp.arange(len(SIGMAS)) - (len(SIGMAS) - 1) / 2
        sigmas = jnp.clip(middle * jnp.exp(step * places), SIGMAS[0], SIGMAS[-1])
        found = jax.lax.map(lambda sigma: _total(sample, sigma, foreign), sigmas)
        at = jnp.argmax(jnp.where(jnp.isnan(found), -jnp.inf, found))
        inside = (at > 0) & (at < len(SIGMAS) - 1)
        before, here, after = found[at - 1], found[at], found[at + 1]
        bend = before - 2 * here + after
        parabola = inside & (bend < 0) & jnp.isfinite(bend)
        shift = 0.5 * (before - after) / jnp.where(parabola, bend, 1.0)
        best = sigmas[at] * jnp.exp(jnp.where(parabola, step * shift, 0.0))
        best = jnp.clip(best, SIGMAS[0], SIGMAS[-1]).astype(middle.dtype)
        # The smallest sigma counts as inside: the grid has nothing below it.
        return best, jnp.where(k == first, inside | (sigmas[at] <= SIGMAS[0]), within)

    sigma, within = jax.lax.fori_loop(first, last + 1, finer, (middle, jnp.bool_(True)))
    return jnp.stack([sigma, _total(values, sigma, foreign), within.astype(sigma.dtype)])


def best_sigma(
    prediction: np.ndarray,
    observation: Observation,
    part_of: int = SIGMA_VALUES,
    near: float | None = None,
) -> tuple[float, float]:
    """Noise in levels with the largest likelihood of the pixels, and that log-likelihood.

    A grid of sigmas is refined by finer ones about its best and by a parabola in each, on
    ``part_of`` of the values: n of them determine sigma to a share of 1/sqrt(2 n). The values are
    the same at every call, and the parabola removes the grid, so that likelihoods can be compared:
    with n values, a sigma that is off by a share d costs n d^2. The first grid has all sigmas, or
    those ``near`` one, unless the best lies at its end.
    """
    last = 2 if part_of == SIGMA_VALUES else 3
    first, middle = (0, MIDDLE_SIGMA) if near is None else (last - 1, near)
    found = _likeliest(
        prediction, (observation.lo, observation.hi, observation.own_noise), np.float32(middle),
        np.int32(first), np.int32(last), part_of, observation.foreign,
    )  # fmt: skip
    sigma, likelihood, within = (float(z) for z in np.asarray(found))
    if near is not None and not within:
        return best_sigma(prediction, observation, part_of)
    return sigma, likelihood if math.isfinite(likelihood) else -math.inf


_total_at = cached_jit(_total)


def log_likelihood_at(prediction: np.ndarray, observation: Observation, sigma: float) -> float:
    """Log-likelihood of all pixels."""
    values = prediction, observation.lo, observation.hi, observation.own_noise
    return float(_total_at(values, np.float32(sigma), observation.foreign))

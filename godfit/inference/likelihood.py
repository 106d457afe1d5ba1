r"""The likelihood of the value behind a rounded pixel.

A stored level t means that the value before rounding lay in [t - h, t + h), with h half the
distance between two levels. The brightest level means "at least", the darkest "below". With
Gaussian noise of standard deviation sigma before the rounding, the log-likelihood of a prediction f
is

    log(Phi((hi - f)/sigma) - Phi((lo - f)/sigma))

This is the likelihood of grouped (interval-censored) data: Sheppard 1898; Heitjan, Statistical
Science 4 (1989), 164. It is log-concave in f. As sigma grows it becomes least squares with
sigma^2 + h^2/3.

Where a model has no value for some pixels (objects, panels), a share of them, ``foreign``, may have
any level with equal probability. The density is then a mixture with heavy tails (Jaynes,
Probability Theory, ch. 21; Hogg, Bovy & Lang, arXiv:1008.4686, section 3), and outliers have no
slope.

Solvers of nonlinear least squares use deviance residuals, r = sign(t - f) sqrt(2 (max
log-likelihood - log-likelihood)), whose sum of squares is the deviance. All values are in 8-bit
levels.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from numpy.polynomial import chebyshev

LOG_SQRT_2PI = 0.9189385332046727
"""log(sqrt(2 pi)), of the normal density."""
INVERSE_SQRT_2PI = 0.3989422804014327
"""1 / sqrt(2 pi), of the normal density."""
MILLS_CENTRE = 3 * math.sqrt(2)
"""Argument of Mills' ratio at which the polynomial's variable changes sign (Shepherd &
Laframboise)."""
INFINITE_SPREADS = 1e5
"""Stands for infinity in units of sigma: its normal density underflows and its square does not
overflow, so that nothing becomes inf - inf."""
POINT_WIDTH = 0.02
"""Width of an interval in units of sigma below which it is a point. Its likelihood is then the
density times the width. The error, width^2/24, is smaller than the cancellation in a difference of
two distribution functions."""
TAIL_SPREADS = 8.0
"""Units of sigma beyond an interval from which the curvature has its asymptotic form."""
SMALL_DEVIANCE = 4e-4
"""Deviance below which the ratio slope / residual has lost its digits in float32."""
ANY_LEVEL = 1 / 256
"""Probability of each level where all are equally likely."""


class Interval(NamedTuple):
    """Log-likelihood of an interval and its derivatives by the prediction, in units of sigma."""

    log: Float[Array, "..."]
    slope: Float[Array, "..."]
    curvature: Float[Array, "..."]


def interval(low: Float[Array, "..."], high: Float[Array, "..."], foreign: float = 0.0) -> Interval:
    """log(Phi(high) - Phi(low)), its slope d/df and curvature -d2/df2, for low = (lo - f)/sigma,
    high = (hi - f)/sigma, low < high or both equal (a point). Finite for every finite or infinite
    argument; curvature lies in [0, 1].

    With a share ``foreign`` the logarithm is that of the mixture, and the curvature its part that
    is never negative, the interval's own times the chance that the pixel is none of these."""
    pixel = _interval(low, high)
    if foreign == 0:
        return pixel
    own = math.log1p(-foreign) + pixel.log
    log = jnp.logaddexp(own, math.log(foreign * ANY_LEVEL))
    chance = jnp.exp(own - log)
    return Interval(log, chance * pixel.slope, chance * pixel.curvature)


def _interval(low: Float[Array, "..."], high: Float[Array, "..."]) -> Interval:
    low, high = (
        jnp.clip(low, -INFINITE_SPREADS, INFINITE_SPREADS),
        jnp.clip(high, -INFINITE_SPREADS, INFINITE_SPREADS),
    )
    middle, width = (low + high) / 2, high - low
    # Mirrored to the left tail: 0 <= |b| <= -a. Both distribution functions keep their relative
    # precision there as normal densities times Mills ratios. Where both are small, the larger
    # density is factored out of the difference.

    a, b = jnp.where(middle > 0, -high, low), jnp.where(middle > 0, -low, high)
    narrow = width < POINT_WIDTH
    # The branch that is not taken must be harmless too.
    a = jnp.where(narrow, b - 1.0, a)
    tail = b <= 0
    fall_b = jnp.exp(-b * b / 2)
    fall_a = jnp.exp(-jnp.where(tail, (b - a) * -(a + b), a * a) / 2)
    mills_a, mills_b = mills_ratio(-a), mills_ratio(jnp.abs(b))
    outside = INVERSE_SQRT_2PI * (fall_b * mills_b + fall_a * mills_a)
    inside = jnp.where(tail, mills_b - fall_a * mills_a, 1.0)
    log = jnp.where(
        tail, -b * b / 2 - LOG_SQRT_2PI + jnp.log(inside), jnp.log1p(-jnp.where(tail, 0.0, outside))
    )
    share = jnp.where(tail, 1.0, INVERSE_SQRT_2PI) / jnp.where(tail, inside, 1 - outside)
    density_a, density_b = share * fall_a, share * jnp.where(tail, 1.0, fall_b)
    slope = (density_a - density_b) * jnp.where(middle > 0, -1.0, 1.0)
    curvature = slope * slope + b * density_b - a * density_a
    # Far out the two terms are large and nearly equal; their difference tends to 1 - 1/b^2.
    curvature = jnp.where(
        b < -TAIL_SPREADS,
        1 - jnp.minimum(1 / (b * b), width * width / 12),
        jnp.clip(curvature, 0, 1),
    )
    point = -middle * middle / 2 - LOG_SQRT_2PI + jnp.log(jnp.where(width > 0, width, 1.0))
    return Interval(
        jnp.where(narrow, point, log),
        jnp.where(narrow, middle, slope),
        jnp.where(narrow, 1.0, curvature),
    )


def mills_ratio(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """(1 - Phi(x)) / phi(x) for x >= 0, to rounding: a polynomial in (x - c)/(x + c), c = 3 sqrt 2,
    as Shepherd & Laframboise (Math. Comp. 36 (1981), 249) evaluate exp(z^2) erfc(z). JAX's
    log_ndtr, in three branches, takes longer."""
    from_infinity = 1 / (x + MILLS_CENTRE)
    t = 1 - 2 * MILLS_CENTRE * from_infinity
    terms = _mills_terms(10 if x.dtype == jnp.float32 else 20)
    value = jnp.full_like(x, terms[-1])
    for term in terms[-2::-1]:
        value = value * t + term
    return value * from_infinity


@functools.cache
def _mills_terms(degree: int) -> list[float]:
    """Coefficients, lowest first, of (x + c) times the ratio at t = (x - c)/(x + c)."""
    from scipy.special import erfcx

    def scaled(t):
        x = MILLS_CENTRE * (1 + t) / (1 - t)
        return (x + MILLS_CENTRE) * math.sqrt(math.pi / 2) * erfcx(x / math.sqrt(2))

    return chebyshev.cheb2poly(chebyshev.chebinterpolate(scaled, degree)).tolist()


@functools.partial(jax.jit, static_argnames="foreign")
def log_likelihood(
    prediction: Float[Array, " n"],
    lo: Float[Array, " n"],
    hi: Float[Array, " n"],
    sigma: Float[Array, "..."],
    foreign: float = 0.0,
) -> Float[Array, " n"]:
    """(n,) log-likelihood of every value, from ``lo`` to ``hi`` (n,) in levels with noise of
    ``sigma`` levels, () or (n,); for points (lo = hi) that of the density."""
    log = interval((lo - prediction) / sigma, (hi - prediction) / sigma, foreign).log
    return jnp.where(lo == hi, log - jnp.log(sigma), log)


def _best(lo, hi, sigma, foreign):
    """Log-likelihood of the best prediction for each value: the middle of its interval."""
    half = jnp.where(jnp.isfinite(lo) & jnp.isfinite(hi), (hi - lo) / 2, jnp.inf) / sigma
    return interval(-half, half, foreign).log


@functools.partial(jax.custom_jvp, nondiff_argnums=(4,))
def deviance_residuals(
    prediction: Float[Array, " n"],
    lo: Float[Array, " n"],
    hi: Float[Array, " n"],
    sigma: Float[Array, "..."],
    foreign: float = 0.0,
) -> Float[Array, " n"]:
    """Signed roots of the deviance: half the sum of their squares is the negative log-likelihood up
    to a constant. ``sigma`` is () or (n,). Differentiable in ``prediction`` alone."""
    return _residuals(prediction, lo, hi, sigma, foreign)[0]


def _residuals(prediction, lo, hi, sigma, foreign):
    low, high = (lo - prediction) / sigma, (hi - prediction) / sigma
    pixel = interval(low, high, foreign)
    above = low + high > 0
    best = _best(lo, hi, sigma, foreign)
    deviance = 2 * (best - pixel.log)
    size = jnp.sqrt(jnp.maximum(deviance, 0.0))
    # d r/d f = -slope / r, which tends to the root of the curvature in the middle.
    # The threshold scales with the interval's own log-likelihood: inside a wide interval the
    # deviance is small everywhere.
    small = deviance <= SMALL_DEVIANCE * jnp.minimum(1.0, -best)
    ratio = jnp.abs(pixel.slope) / jnp.where(small, 1.0, size)
    slope = jnp.where(small, jnp.sqrt(pixel.curvature), ratio) / sigma
    return jnp.where(above, size, -size), -slope


@deviance_residuals.defjvp
def _deviance_residuals_jvp(foreign, primals, tangents):
    prediction, lo, hi, sigma = primals
    residuals, slope = _residuals(prediction, lo, hi, sigma, foreign)
    return residuals, slope * tangents[0]

r"""What the arithmetic of a GPU adds to a picture, as noise of each value.

A shader walks to the light by adding a step in float32, and each addition rounds to float32's grid
at the place where it is. While a coordinate stays in one binade, it is rounded by the same amount
at every step. After k steps a column has drifted by k e and its taps lie on rays to a light of its
own, off by e / step. With J the derivatives of the sum by the light, the values of the column are
off by J e / step, and likewise those of a row. A drift is a hash of the step: it is not fitted, and
enters as noise with the variance of a rounding to the grid below 1,

    (2^-24 / step)^2 / 12 sum over lights of (J_u^2 + J_v^2)

Texture units interpolate with fractions of 1/256 (Vulkan's limit subTexelPrecisionBits, 8 in common
hardware). A tap of weight c_k is then off by the mask's slope there times the rounding of the
fraction, so that a value has the variance

    (2^-8)^2 / 12 sum_k c_k^2 |grad M_k|^2

which is one more radial sum: that of the squared slopes by the squared weights. Other renderers
interpolate in float32. A picture does not say which of the two drew it, but its likelihood differs:
fractions that are rounded push far more bytes to the next level than a walk does. The likelier of
the two hypotheses is taken, and where neither is clearly so, the one with more noise.

The likelihood takes values to be independent, but those of a column drift together. What this does
to the errors is computed from the part of the noise that they share (``shared_noise.py``).

A light pass in half floats is rounded to these before it becomes bytes. All channels share one
drift: as many times the variance make them count as one.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.inference.allowances.mask_rounding import rounded_texels
from godfit.inference.criteria import CLEAR, aic
from godfit.inference.noise import SINGLE_PRECISION, best_sigma
from godfit.inference.observation import EXACT, Observation
from godfit.inference.problem import Problem
from godfit.inference.settle import Settled, aim
from godfit.inference.solver import Tangent, tangent_at
from godfit.io.image import LEVELS, decode, encode
from godfit.models.base import AbstractModel, Vector
from godfit.models.mitchell import Mitchell
from godfit.models.shaded import AbstractShaded
from godfit.models.tinted import Tinted
from godfit.runtime.program_cache import cached_jit
from godfit.scattering.parameters import is_light
from godfit.scattering.radial import radial_sum
from godfit.scattering.taps import Taps
from godfit.scattering.upsample import at_pixels

FRACTION_ROUNDING = 2.0**-8 / math.sqrt(12)
"""Standard deviation, in texels, of a rounding to 1/256 of a texel."""


def with_arithmetic(
    observation: Observation,
    problem: Problem,
    coordinates: np.ndarray,
    tangent: Tangent | None = None,
) -> Observation:
    """The observation with the noise of the target's arithmetic, from the ``tangent`` at the
    ``coordinates`` (p,), which is rendered where it is not at hand. The observation is returned as
    it is where the target is exact, or the model has no walk."""
    picture, model = problem.picture, problem.model
    if picture.arithmetic == EXACT or picture.foreign:
        return observation
    walk = problem.at(coordinates).walk
    if walk is None:
        return observation
    plain = observation.with_noise(None)
    tangent = tangent or tangent_at(coordinates, problem, plain)
    columns = [i for i, name in enumerate(problem.names) if is_light(name)]
    if columns and np.isnan(problem.held[columns]).all():
        light = np.asarray(problem.at(coordinates).light)
        slopes = tangent.jacobian[columns] / tangent.scale[columns][:, None]
    else:
        # A light that is held, or that follows a scene, has no column of its own.
        light, slopes = _by_light(coordinates, problem.held, model, plain)
    drifts = walk_variances(plain, np.asarray(light, np.float64).reshape(-1, 2), walk)
    shared = np.asarray(slopes) * np.sqrt(drifts)
    variance = np.einsum("im,im->m", shared, shared)
    if not isinstance(model, (Mitchell, AbstractShaded)):
        return _noisy(plain, variance, shared)

    def by_taps(texels: np.ndarray | None) -> np.ndarray:
        at = coordinates, problem.held, model, (plain, texels)
        return np.asarray(_by_taps(*at, tangent.prediction))

    texels = rounded_texels(picture, model)
    if texels is not None:
        variance = variance + by_taps(texels)
    if model.convention.half_floats:
        variance = variance + half_float_variance(tangent.prediction)
    fractions = variance + by_taps(None)
    narrow, wide = (_noisy(plain, z, shared) for z in (variance, fractions))

    def likelihood(noisy: Observation) -> float:
        sigma, at = best_sigma(tangent.prediction, noisy)
        here = Settled(coordinates, sigma, at + tangent.log_prior, False)
        return aim(here, tangent, problem, noisy)[0].log_likelihood

    # Neither hypothesis has a parameter that the other lacks: Akaike's criterion is the likelihood.
    apart = aic(likelihood(wide), 0) - aic(likelihood(narrow), 0)
    return narrow if apart > CLEAR else wide


def _noisy(plain: Observation, variance: np.ndarray, shared: np.ndarray) -> Observation:
    """The observation with noise of ``variance`` (m,), which the channels share, beside that of its
    prediction in single precision. Columns and rows share the part ``shared`` (lines, m) of it."""
    total = plain.channels * variance + SINGLE_PRECISION**2
    return plain.with_noise(np.sqrt(total).astype(np.float32), shared)


def walk_variances(
    observation: Observation, lights: Float[np.ndarray, "n 2"], walk: Taps
) -> Float[np.ndarray, "2*n m"]:
    """Variance of the displacement of each light (u, v) that a value of the observation has.

    The mean square of the roundings along the way bounds that of their mean. They are of the grid
    where the coordinate is, which is finer towards 0.
    """
    height, width = observation.size
    pixels = np.asarray(observation.pixels)
    count, step = int(walk.count), float(walk.step)
    shares = step * np.arange(1, count + 1)
    rows = []
    for u, v in lights:
        across, down = (np.arange(width) + 0.5) / width, 1 - (np.arange(height) + 0.5) / height
        for places, light, at in ((across, u, pixels % width), (down, v, pixels // width)):
            way = places[:, None] + shares * (light - places)[:, None]
            rounding = np.square(np.spacing(np.abs(way).astype(np.float32)).astype(np.float64))
            rows.append((rounding.mean(1) / 12 / step**2)[at])
    return np.repeat(np.array(rows, np.float32), observation.channels, axis=1)


@cached_jit
def _by_light(
    coordinates: Vector, held: Vector, model: AbstractModel, observation: Observation
) -> tuple[Float[Array, "n 2"], Float[Array, "2*n m"]]:
    """The lights, and the derivatives of the levels by their texture coordinates."""
    flat, mask = model.moved(coordinates, held).flat(observation.mask)
    there = dataclasses.replace(observation, mask=mask)
    light = flat.light.reshape(-1)

    def predict(places):
        moved = eqx.tree_at(lambda m: _sum_of(m).light, flat, places.reshape(flat.light.shape))
        return there.predict(moved)

    rows = [jax.jvp(predict, (light,), (way,))[1] for way in jnp.eye(len(light), dtype=light.dtype)]
    return flat.light, jnp.stack(rows)


def _sum_of(model: AbstractModel) -> Any:
    """What has the light as a field of its own: the sum that a model shows, or the model."""
    return model.shading if isinstance(model, AbstractShaded) else model


@cached_jit
def _by_taps(
    coordinates: Vector,
    held: Vector,
    model: AbstractModel,
    read: tuple[Observation, Float[Array, "..."] | None],
    prediction: Float[Array, " m"],
) -> Float[Array, " m"]:
    """Variances of the levels where taps err by themselves. ``read`` are the observation and the
    variances of the texels; None for those by rounded fractions of a texel."""
    observation, texels = read
    flat, mask = model.moved(coordinates, held).flat(observation.mask)
    lit = _sum_of(flat)
    assert isinstance(lit, Mitchell)
    some = None if observation.whole else observation.pixels
    image = FRACTION_ROUNDING**2 * squared_slopes(mask) if texels is None else texels
    squares = at_pixels(
        lambda image, at: squared_sum(lit, image, at), image, observation.size, some,
        observation.texels, lit.full_size,
    )  # fmt: skip
    squares = squares.reshape(observation.pixels.shape[0], -1)
    squares = jnp.broadcast_to(squares, (observation.pixels.shape[0], observation.channels))
    if isinstance(flat, Tinted):
        squares = squares * jnp.square(flat.colour)[None]
    linear = decode(jnp.asarray(prediction) / LEVELS, observation.transfer)
    _, by_light = jax.jvp(
        lambda z: LEVELS * encode(z, observation.transfer), (linear,), (jnp.ones_like(linear),)
    )
    return squares.reshape(-1) * jnp.square(by_light)


def half_float_variance(levels: np.ndarray) -> np.ndarray:
    """(m,) variance in levels of values that were stored as half floats, of 11 significant bits."""
    spacing = np.spacing(np.abs(levels / LEVELS).astype(np.float16)).astype(np.float32) * LEVELS
    return np.square(spacing) / 12


def squared_sum(
    model: Mitchell, image: Float[Array, "..."], at: Float[Array, "*points 2"] | None
) -> Float[Array, "..."]:
    """The sum of ``image`` over the taps of ``model``, each with the square of its weight, without
    the pixel's own, for all lights together. Of a whole picture it is computed at half the size:
    variances are smooth."""
    taps = model.walk
    assert taps is not None
    squared = Taps(0.0, taps.first**2, taps.ratio**2, taps.step, taps.count)
    method = "half" if at is None else "auto"
    total = 0.0
    for light in model.light:
        total += radial_sum(image, light, squared, at=at, method=method)
    return jnp.asarray(total)


def squared_slopes(mask: Float[Array, "h w"] | Float[Array, "h w c"]) -> Float[Array, "..."]:
    """The squared slope of a mask that is read bilinearly, per texel, at its texels: the mean of
    those of the cells on either side, over both axes."""
    total = jnp.zeros_like(mask)
    for axis in (0, 1):
        square = jnp.square(jnp.diff(mask, axis=axis))
        ends = [(0, 0)] * mask.ndim
        before, after = list(ends), list(ends)
        before[axis], after[axis] = (1, 0), (0, 1)
        total += (jnp.pad(square, before) + jnp.pad(square, after)) / 2
    return total

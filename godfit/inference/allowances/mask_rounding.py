"""What a mask known to bytes alone does to a fit, where the light pass read it in half floats, and
one whose texels are not known for another reason.

A texel that is neither black nor white is known to half a level. The picture is linear in the mask,
so that with slopes J of the picture by the coordinates, weights W of its values and information H
an error d of a texel shifts the coordinates by

    H^-1 (A^T W J) d

where A^T carries a picture back to the mask. One texel throws a streak over many pixels, which all
err together, and the shifts of all texels add in variance. Texels amid equal ones were rounded
alike: those of one value have one error. Black and white are exact: they are what the mask was
cleared to and drawn with. Next to a grey texel they may be the end of a blur, less than half a
level away and all to the same side. Those have one error too.
"""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.inference.fitted import Found
from godfit.inference.likelihood import interval
from godfit.inference.noise import noise_of
from godfit.inference.observation import EXACT, Observation, Picture
from godfit.inference.solver import tangent_at
from godfit.io.image import LEVELS
from godfit.models.base import AbstractModel, Vector
from godfit.models.mitchell import Mitchell
from godfit.runtime.program_cache import cached_jit

TEXEL_VARIANCE = 1 / 12 / LEVELS**2
"""Variance of a rounding to levels, in linear light."""


def rounded_texels(picture: Picture, model: AbstractModel) -> np.ndarray | None:
    """(h, w, ...) variance of each texel of the mask, in linear light; None where all are known."""
    if picture.foreign or not isinstance(model, Mitchell):
        return None
    if picture.texel_variance is not None:
        return picture.texel_variance
    if picture.arithmetic == EXACT:
        return None
    mask = picture.mask
    levels = np.rint(mask * LEVELS)
    if not model.convention.half_floats or not np.allclose(mask * LEVELS, levels, atol=1e-3):
        return None
    from scipy import ndimage

    grey = (levels > 0) & (levels < LEVELS)
    around = np.ones((3, 3, *[1] * (mask.ndim - 2)), bool)
    unsure = ndimage.binary_dilation(grey, around)
    return np.where(unsure, np.float32(TEXEL_VARIANCE), np.float32(0)) if grey.any() else None


def _ends_about(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(h, w, ...) each: the brightest and the darkest value at a texel and its neighbours."""
    from scipy import ndimage

    around = (3, 3, *[1] * (mask.ndim - 2))
    return np.asarray(ndimage.maximum_filter(mask, around)), np.asarray(
        ndimage.minimum_filter(mask, around)
    )


def edge_variance(mask: np.ndarray) -> np.ndarray:
    """(h, w, ...) variance of each texel of a mask that was resized. Its grey value is the chance
    that the texel had the brightest value about it, and not the darkest."""
    bright, dark = _ends_about(mask)
    return np.asarray((bright - mask) * (mask - dark), np.float32)


def edge_blur(mask: np.ndarray) -> np.ndarray:
    """(h, w, ...) the error that all texels of such a mask have at once: a resize is a blur, which
    draws both sides of an edge to its middle."""
    bright, dark = _ends_about(mask)
    return np.sign(2 * mask - bright - dark) * np.sqrt(edge_variance(mask))


def with_mask_shifts(found: Found) -> Found:
    """The fit with the shifts by errors of the mask's texels; as it is where these are known."""
    problem, settled, observation = found.problem, found.settled, found.observation
    variance = rounded_texels(problem.picture, problem.model)
    if variance is None or not problem.free.any():
        return found
    tangent = tangent_at(settled.coordinates, problem, observation)
    plain = observation.with_noise(None)
    own = observation.own_noise
    noise = noise_of(np.float32(settled.sigma), None if own is None else np.asarray(own))
    lo, hi = np.asarray(observation.lo), np.asarray(observation.hi)
    pixel = interval(
        jnp.asarray((lo - tangent.prediction) / noise),
        jnp.asarray((hi - tangent.prediction) / noise),
    )
    pulls = tangent.jacobian * (np.asarray(pixel.curvature) / noise**2)
    # The derivative by the mask needs a known number of taps.
    known = eqx.tree_at(lambda m: m.samples, problem.model, int(problem.model.samples))
    texels = np.asarray(
        _at_texels(settled.coordinates, problem.held, known, plain, jnp.asarray(pulls))
    )
    pulled = pull_covariance(problem.picture.mask, variance, texels)
    if problem.picture.texel_variance is not None:
        blur = texels.reshape(len(texels), -1) @ edge_blur(problem.picture.mask).reshape(-1)
        pulled += np.outer(blur, blur)
    pulled /= np.outer(tangent.scale, tangent.scale)
    covariance = found.evidence.covariance(problem.free)
    values, vectors = np.linalg.eigh(_scaled(covariance @ pulled @ covariance))
    size = np.sqrt(np.maximum(np.diag(covariance @ pulled @ covariance), 0))
    shifts = [
        size * vectors[:, i] * np.sqrt(values[i]) for i in range(len(values)) if values[i] > 0
    ]
    return found.replaced(shifts=(*found.shifts, *shifts))


def _scaled(covariance: np.ndarray) -> np.ndarray:
    """``covariance`` with a unit diagonal where it is not zero."""
    size = np.sqrt(np.maximum(np.diag(covariance), 0))
    size = np.where(size > 0, size, 1.0)
    return covariance / np.outer(size, size)


def pull_covariance(mask: np.ndarray, variance: np.ndarray, texels: np.ndarray) -> np.ndarray:
    """(p, p) covariance of the likelihood's slope by the coordinates, from its slopes ``texels``
    (p, h, w, ...) by each texel and the ``variance`` of these. Texels whose neighbours are all
    equal, or that are black or white, err together with others of their value."""
    channels = np.atleast_3d(mask)
    slopes = texels.reshape(len(texels), *channels.shape).astype(np.float64)
    spread = variance.reshape(channels.shape)
    total = np.zeros((len(texels), len(texels)))
    for c in range(channels.shape[-1]):
        values, each = channels[..., c], slopes[..., c].reshape(len(texels), -1)
        flat = np.ones(values.shape, bool)
        for axis in (0, 1):
            same = np.diff(values, axis=axis) == 0
            ends = [(0, 0), (0, 0)]
            for side in ((1, 0), (0, 1)):
                ends[axis] = side
                flat &= np.pad(same, ends, constant_values=True)
        known = spread[..., c].reshape(-1)
        ends_of_scale = (values == 0) | (values == 1)
        flat = (flat | ends_of_scale).reshape(-1) & (known > 0)
        alone = each[:, ~flat] * np.sqrt(known[~flat])
        total += alone @ alone.T
        level = np.rint(values.reshape(-1)[flat] * LEVELS).astype(int)
        together = np.stack([np.bincount(level, row[flat], minlength=1) for row in each])
        total += TEXEL_VARIANCE * (together @ together.T)
    return total


@cached_jit
def _at_texels(
    coordinates: Vector,
    held: Vector,
    model: AbstractModel,
    observation: Observation,
    pulls: Float[Array, "p m"],
) -> Float[Array, "p ..."]:
    """Each of the weighted pictures ``pulls`` carried back to the mask."""
    at = model.moved(coordinates, held)

    def predict(mask):
        return dataclasses.replace(observation, mask=mask).predict(at)

    _, back = jax.vjp(predict, observation.mask)
    return jax.lax.map(lambda pull: back(pull)[0], pulls)

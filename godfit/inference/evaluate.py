"""A model at a point, ``z`` (p,), with parameters ``held`` (p,) where not NaN: programs of their
own, each kept. Done one by one, the operations of a single ``moved`` take twenty milliseconds."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from godfit.inference.observation import Observation
from godfit.models.base import AbstractModel, Vector
from godfit.runtime.program_cache import cached_jit


@cached_jit
def model_at(z, held, model):
    """The model there."""
    return model.moved(z, held)


@cached_jit
def coordinates_at(z, held, model):
    """(p,) its coordinates, which are not ``z`` where something is held."""
    return model.moved(z, held).coordinates()


@cached_jit
def predicted(z, held, model, observation):
    """(n c,) levels at the pixels observation, every pixel's channels together."""
    return observation.predict(model.moved(z, held))


@cached_jit
def occlusion_of(model, mask):
    """(h, w) or (h, w, c) what the light pass of ``model`` reads."""
    return model.occlusion(mask)


@cached_jit
def taps_of(model):
    """Places (k + 1,) and weights (k + 1,) of the one pass of ``model``, the pixel's own first."""
    (taps,) = model.taps
    own = jnp.full(1, taps.own, taps.c.dtype)
    return jnp.append(jnp.zeros_like(own), taps.t), jnp.append(own, taps.c)


@cached_jit
def predictions(
    points: Float[Array, "n p"], held: Vector, model: AbstractModel, observation: Observation
) -> Float[Array, "n m"]:
    """Levels of the model at each of ``points``."""
    return jax.lax.map(lambda z: observation.predict(model.moved(z, held)), points)

"""A model at a point, ``z`` (p,), with parameters ``held`` (p,) where not NaN.

Each function is a compiled program in the cache: one by one, the operations of a single ``moved``
take twenty milliseconds.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from godfit.inference.observation import Observation
from godfit.models.base import AbstractModel, Vector
from godfit.runtime.program_cache import cached_jit


def model_at(z, held, model):
    """The ``model`` moved to ``z``, with parameters ``held``."""
    leaves, tree = jax.tree.flatten(model)
    moved = zip(_moved_leaves(z, held, model), leaves, strict=True)
    return jax.tree.unflatten(tree, [old if new is None else new for new, old in moved])


@cached_jit
def _moved_leaves(z, held, model):
    # Leaves that do not move stay with the caller: a traced number of samples would come back as an
    # array.
    leaves = jax.tree.leaves(model.moved(z, held))
    return tuple(leaf if eqx.is_inexact_array(leaf) else None for leaf in leaves)


@cached_jit
def coordinates_at(z, held, model):
    """(p,) coordinates of the moved model, which differ from ``z`` where parameters are held."""
    return model.moved(z, held).coordinates()


@cached_jit
def parameters_at(model, z, held):
    """Parameters (p,) at ``z``, and their derivatives (p, p) by coordinate."""

    def values(z):
        return jnp.stack(list(model.moved(z, held).values().values()))

    return values(z), jax.jacfwd(values)(z)


@cached_jit
def predicted(z, held, model, observation):
    """(n c,) levels at the pixels of ``observation``, the channels of a pixel side by side."""
    return observation.predict(model.moved(z, held))


def occlusion_of(model, mask):
    """(h, w) or (h, w, c) occlusion that the light pass of ``model`` reads, from its ``mask``."""
    if type(model).occlusion is AbstractModel.occlusion:
        # The mask itself: a program would be compiled for every size.
        return mask
    return _occlusion(model, mask)


@cached_jit
def _occlusion(model, mask):
    return model.occlusion(mask)


@cached_jit
def predictions(
    points: Float[Array, "n p"], held: Vector, model: AbstractModel, observation: Observation
) -> Float[Array, "n m"]:
    """Levels of the model at each of ``points``."""
    return jax.lax.map(lambda z: observation.predict(model.moved(z, held)), points)

"""A model at many points at once, and the local minima of a cost along a line."""

from __future__ import annotations

import jax
import numpy as np
from jaxtyping import Array, Float

from godfit.inference.observation import Observation
from godfit.models.base import AbstractModel, Vector
from godfit.runtime.program_cache import cached_jit

DOUBT = 8.0
"""Log-likelihood on some of the pixels by which a point may be behind that is ahead on all."""


@cached_jit
def predictions(
    points: Float[Array, "n p"], held: Vector, model: AbstractModel, observation: Observation
) -> Float[Array, "n m"]:
    """Levels of the model at each of ``points``."""
    return jax.lax.map(lambda z: observation.predict(model.moved(z, held)), points)


def local_minima(costs: np.ndarray) -> np.ndarray:
    """Indices at which ``costs`` (n,) are finite and not above either neighbour."""
    costs = np.where(np.isfinite(costs), costs, np.inf)
    around = np.pad(costs, 1, constant_values=np.inf)
    return np.flatnonzero(np.isfinite(costs) & (costs <= around[:-2]) & (costs <= around[2:]))

"""A model over many points at once, and the minima of what that costs."""

from __future__ import annotations

import jax
import numpy as np
from jaxtyping import Array, Float

from godfit.inference.observation import Observation
from godfit.models.base import AbstractModel, Vector
from godfit.runtime.program_cache import cached_jit

# Log-likelihood on some of the pixels by which a point that is ahead on all may be behind.
DOUBT = 8.0


@cached_jit
def predictions(
    points: Float[Array, "n p"], held: Vector, model: AbstractModel, seen: Observation
) -> Float[Array, "n m"]:
    """Levels of the model at each of ``points``."""
    return jax.lax.map(lambda z: seen.predict(model.moved(z, held)), points)


def bottoms(costs: np.ndarray) -> np.ndarray:
    """Indices where ``costs`` (n,) are finite and no neighbour is less."""
    costs = np.where(np.isfinite(costs), costs, np.inf)
    around = np.pad(costs, 1, constant_values=np.inf)
    return np.flatnonzero(np.isfinite(costs) & (costs <= around[:-2]) & (costs <= around[2:]))

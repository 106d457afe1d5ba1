"""Coordinates in which a fit is easy: zero at the start, one standard error a unit, uncorrelated.

Exposure, decay and weight trade with each other, and their sizes differ by orders of magnitude.
Most solvers and samplers take few steps once the problem has the same size in every direction.
"""

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree


def whitened(problem):
    """(start, to_params): zeros (p,), and the function from such coordinates to parameters."""
    flat, unflatten = ravel_pytree(problem.start)
    slopes = jax.jacfwd(lambda v: problem.residuals(unflatten(v)))(flat)
    information = slopes.T @ slopes
    size = jnp.sqrt(jnp.diag(information))
    factor = jnp.linalg.cholesky(information / jnp.outer(size, size))
    root = jnp.linalg.inv(factor).T / size[:, None]
    return jnp.zeros_like(flat), lambda u: unflatten(flat + root @ u)

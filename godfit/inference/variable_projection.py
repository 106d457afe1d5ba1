"""Variable projection: coordinates in which an image is linear are solved for exactly.

A search then moves the other coordinates alone (Golub & Pereyra, SIAM J. Numer. Anal. 10 (1973),
413). Amplitudes of light are never negative.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

NEARLY_PARALLEL = 1e-6
"""Squared sine of the angle between two components below which one of them stands for both."""
TINY = 1e-12
"""Added to sums of squares, in units of the target's, so that nothing is divided by zero."""


def least_squares(
    components: Float[np.ndarray, "*batch k m"], target: Float[np.ndarray, " m"], ridge: float
) -> Float[np.ndarray, "*batch k"]:
    """Amplitudes of the ``components`` whose sum is nearest to ``target``.

    ``ridge``, a share of the Gram matrix's trace, draws amplitudes to zero that nothing determines.
    """
    gram = components @ components.swapaxes(-1, -2)
    tiny = ridge * np.trace(gram, axis1=-2, axis2=-1) + 1e-30
    gram = gram + tiny[..., None, None] * np.eye(gram.shape[-1])
    return np.linalg.solve(gram, (components @ target)[..., None])[..., 0]


def nonnegative_one(product: Any, square: Any) -> Any:
    """The amplitude of one component, none below zero, from its inner ``product`` with the target
    and its ``square``; elementwise."""
    return jnp.maximum(product, 0) / jnp.maximum(square, TINY)


def nonnegative_two(
    square: Any, products: tuple[Any, Any], squares: tuple[Any, Any], both: Any
) -> tuple[Any, Any, Any]:
    """Amplitudes of two components, none below zero, and the remaining sum of squares;
    elementwise.

    ``square`` is the target's sum of squares, ``products`` are the components' inner products with
    the target, ``squares`` their own sums of squares, ``both`` their inner product.
    """
    (to, ts), (oo, ss) = products, squares
    tiny = TINY * (1 + square)
    determinant = oo * ss - both * both
    regular = determinant > NEARLY_PARALLEL * oo * ss
    e = jnp.where(regular, (to * ss - ts * both) / jnp.where(regular, determinant, 1.0), 0.0)
    g = (ts - jnp.maximum(e, 0) * both) / jnp.maximum(ss, tiny)
    e = jnp.where(g < 0, to / jnp.maximum(oo, tiny), jnp.maximum(e, 0.0))
    g = jnp.maximum(g, 0.0)
    remaining = square - 2 * (e * to + g * ts) + e * e * oo + 2 * e * g * both + g * g * ss
    return e, g, remaining

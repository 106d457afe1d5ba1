"""Arrays on the device."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


def on_device(values: Any, dtype: Any = None) -> jax.Array:
    """``jnp.asarray`` without compiling, where all ``values`` are NumPy's or Python's.

    ``jnp.asarray`` traces and compiles a program for every new shape and type, 15 ms each.
    """
    if any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(values)):
        return jnp.asarray(values, dtype)
    return jax.device_put(np.asarray(values, dtype))

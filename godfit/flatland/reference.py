"""The walk of ``godfit.flatland.rays`` in plain JAX: the definition, one step of all pixels at a
time.

Slow, differentiable both ways by JAX's own rules. What is compiled is held against this.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from godfit.flatland.rays import LITTLE, Prepared
from godfit.flatland.walk_kernel import OUTSIDE


def walk(given: Prepared, rays: int, steps: int, step: float, leap: bool) -> Float[Array, "h w 3"]:
    """See ``godfit.flatland.rays.gathered``; ``leap`` over what is free or go pixel by pixel."""
    free, cells = given.free, given.cells
    (h, w), kinds = given.turn.shape, given.sky.shape[0] // rays
    dtype, width = free.dtype, free.shape[1]
    little = LITTLE[dtype]
    y = jnp.broadcast_to(jnp.arange(h, dtype=dtype)[:, None] + 1.5, (h, w))
    x = jnp.broadcast_to(jnp.arange(w, dtype=dtype)[None] + 1.5, (h, w))
    own = y.astype(int) * width + x.astype(int)

    def ray(total, i):
        kind = i * kinds + given.turn
        dx, dy = given.directions[kind, 0], given.directions[kind, 1]
        beyond = given.sky[kind]

        def place(t):
            column = jnp.clip(x + t * dx, 0, width - 1).astype(int)
            return jnp.clip(y + t * dy, 0, free.shape[0] - 1).astype(int), column

        def onwards(t, row, column):
            if step > 0:
                return t + step
            a = (column + (dx > -1e-9) - x) / jnp.where(jnp.abs(dx) > 1e-9, dx, 1e-9)
            b = (row + (dy > -1e-9) - y) / jnp.where(jnp.abs(dy) > 1e-9, dy, 1e-9)
            edge = jnp.minimum(a, b) + little
            return jnp.maximum(t + jnp.maximum(free[row, column], 0), edge) if leap else edge

        def advance(state, _):
            t, last, left, light, passing = state
            row, column = place(t)
            value, cell = free[row, column], row * width + column
            left = left | (value == OUTSIDE)
            met = (cell != last) & ~left
            held = jnp.where(met[..., None], cells[cell], 0)
            light = light + passing[..., None] * held[..., :3]
            passing = passing * (1 - held[..., 3])
            return (onwards(t, row, column), cell, left, light, passing), None

        start = jnp.zeros((h, w), dtype)
        t = onwards(start, *place(start))
        state = (
            t,
            own,
            jnp.zeros((h, w), bool),
            jnp.zeros((h, w, 3), dtype),
            jnp.ones((h, w), dtype),
        )
        (_, _, left, light, passing), _ = jax.lax.scan(advance, state, None, steps)
        seen = light + jnp.where(left, passing, 0)[..., None] * beyond
        return total + seen, None

    total, _ = jax.lax.scan(ray, jnp.zeros((h, w, 3), dtype), jnp.arange(rays))
    return total / rays

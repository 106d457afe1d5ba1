"""The trace of ``godfit.flatland.rays`` in plain JAX: the definition, one step of all pixels at a
time.

Slow, differentiable both ways by JAX's own rules. The compiled kernels are tested against it, and
it takes their place where JAX does not run on a CPU.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from godfit.flatland.kernel_records import TraceInputs
from godfit.flatland.rays import BORDER_OVERSHOOT, TraceSettings
from godfit.flatland.walk_kernel import AXIS_PARALLEL, OUTSIDE


def reference_trace(
    inputs: TraceInputs, settings: TraceSettings, leap: bool
) -> Float[Array, "h w 3"]:
    """See ``godfit.flatland.rays.gathered``; ``leap`` over what is free or go pixel by pixel."""
    free, cells = inputs.grid
    steps, length = settings.max_steps, settings.step_length
    (h, w), jitter_bins = inputs.jitter_bin.shape, inputs.sky.shape[0] // settings.rays
    dtype, width = free.dtype, free.shape[1]
    overshoot = BORDER_OVERSHOOT[dtype]
    y = jnp.broadcast_to(jnp.arange(h, dtype=dtype)[:, None] + 1.5, (h, w))
    x = jnp.broadcast_to(jnp.arange(w, dtype=dtype)[None] + 1.5, (h, w))
    own_cell = y.astype(int) * width + x.astype(int)

    def ray(total, i):
        direction = i * jitter_bins + inputs.jitter_bin
        dx, dy = inputs.directions[direction, 0], inputs.directions[direction, 1]
        beyond = inputs.sky[direction]

        def row_and_column(t):
            column = jnp.clip(x + t * dx, 0, width - 1).astype(int)
            return jnp.clip(y + t * dy, 0, free.shape[0] - 1).astype(int), column

        def next_distance(t, row, column):
            if length > 0:
                return t + length
            right, below = dx > -AXIS_PARALLEL, dy > -AXIS_PARALLEL
            a = (column + right - x) / jnp.where(jnp.abs(dx) > AXIS_PARALLEL, dx, AXIS_PARALLEL)
            b = (row + below - y) / jnp.where(jnp.abs(dy) > AXIS_PARALLEL, dy, AXIS_PARALLEL)
            border = jnp.minimum(a, b) + overshoot
            return jnp.maximum(t + jnp.maximum(free[row, column], 0), border) if leap else border

        def advance(state, _):
            t, previous, escaped, light, transmittance = state
            row, column = row_and_column(t)
            value, cell = free[row, column], row * width + column
            escaped = escaped | (value == OUTSIDE)
            met = (cell != previous) & ~escaped
            content = jnp.where(met[..., None], cells[cell], 0)
            light = light + transmittance[..., None] * content[..., :3]
            transmittance = transmittance * (1 - content[..., 3])
            return (next_distance(t, row, column), cell, escaped, light, transmittance), None

        start = jnp.zeros((h, w), dtype)
        begin = (
            next_distance(start, *row_and_column(start)),
            own_cell,
            jnp.zeros((h, w), bool),
            jnp.zeros((h, w, 3), dtype),
            jnp.ones((h, w), dtype),
        )
        (_, _, escaped, light, transmittance), _ = jax.lax.scan(advance, begin, None, steps)
        light = light + jnp.where(escaped, transmittance, 0)[..., None] * beyond
        return total + light, None

    total, _ = jax.lax.scan(ray, jnp.zeros((h, w, 3), dtype), jnp.arange(settings.rays))
    return total / settings.rays

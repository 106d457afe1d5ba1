"""Radiance cascades in the plane.

Sannikov, "Radiance Cascades: A Novel Approach to Calculating Global Illumination" (2023, draft):
light from near needs many probes and few directions, light from far few probes and many directions.
Cascade n has probes 2^n spacing apart, each with 4^n rays directions, which see the interval of
distances from (4^n - 1) / 3 to (4^(n+1) - 1) / 3 times ``interval``; so every cascade but the last
costs the same, whatever the number of directions. From the far end on, every ray is continued by
the four directions of the next cascade that it becomes, in the four probes about it.

Continued by an interpolation of those probes' rays, which start elsewhere, light leaks past edges
and rings about lamps. Here, in the bilinear fix (same author and others, 2024), a ray is traced
four times, to where the ray of each of the four begins, and the four whole ways are interpolated.

What remains of error: within a cascade's interval only so many directions are told apart, and a
probe's light is interpolated between probes. No derivative: what is asked for one is refused.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from godfit.flatland.canvas import Canvas
from godfit.flatland.rays import LITTLE, angles, call, cells_of, free_distance, shares
from godfit.flatland.sky import Sky

CALLS = 16
BRANCH = 4
# Pixels, of the first cascade: probes apart, length of its rays.
SPACING, INTERVAL = 1.0, 1.5


def cascades(
    canvas: Canvas,
    sky: Sky,
    rays: int = 4,
    spacing: float = SPACING,
    interval: float = INTERVAL,
) -> Float[Array, "h w 3"]:
    """The mean radiance that reaches every pixel; ``rays`` are the directions of the first
    cascade."""
    h, w = canvas.size
    dtype = canvas.opacity.dtype
    free, cells = free_distance(canvas), cells_of(canvas)
    diagonal = math.hypot(h, w)
    ends = [0.0]
    while ends[-1] < diagonal:
        ends.append(interval * (BRANCH ** len(ends) - 1) / (BRANCH - 1))
    count = len(ends) - 1

    def probes(level: int) -> tuple[int, int]:
        apart = spacing * 2**level
        return max(1, math.ceil(h / apart)), max(1, math.ceil(w / apart))

    merged = jnp.zeros((1, 4), dtype)
    for level in reversed(range(count)):
        directions = rays * BRANCH**level
        at = angles(directions, 1, dtype)
        rows, columns = probes(level)
        last = level == count - 1
        up_rows, up_columns = (1, 1) if last else probes(level + 1)
        numbers = [
            spacing * 2**level, ends[level], ends[level + 1],
            0.0 if last else spacing * 2 ** (level + 1), LITTLE[dtype],
        ]  # fmt: skip
        parts = [
            call(
                "merge", (size, columns, 4 * directions), dtype, free, cells,
                jnp.stack([jnp.cos(at), -jnp.sin(at)], -1), merged, jnp.asarray(numbers, dtype),
                jnp.asarray([begin, up_rows, up_columns, BRANCH], jnp.int32),
            )
            for begin, size in shares(rows, CALLS)
        ]  # fmt: skip
        merged = jnp.concatenate(parts, 0)
        if last:
            # What passes the last cascade is the sky's.
            light = merged.reshape(rows, columns, directions, 4)
            beyond = sky.over(directions).astype(dtype)[None, None]
            light = light.at[..., :3].add(light[..., 3:] * beyond)
            merged = light
        merged = merged.reshape(rows * columns, 4 * directions)
    rows, columns = probes(0)
    mean = merged.reshape(rows, columns, rays, 4)[..., :3].mean(2)
    return _between(mean, (h, w), spacing)


def _between(probes, size, spacing):
    """Read between probes, bilinearly, at the pixels' middles."""
    if spacing == 1:
        return probes
    h, w = size

    def along(count, probes, axis):
        at = (jnp.arange(count) + 0.5) / spacing - 0.5
        low = jnp.floor(at)
        share = (at - low).astype(probes.dtype)
        top = probes.shape[axis] - 1
        first = jnp.clip(low.astype(int), 0, top)
        second = jnp.clip(low.astype(int) + 1, 0, top)
        share = jnp.expand_dims(share, tuple(i for i in range(probes.ndim) if i != axis))
        return (1 - share) * probes.take(first, axis) + share * probes.take(second, axis)

    return along(w, along(h, probes, 0), 1)

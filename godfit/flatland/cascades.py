"""Radiance cascades in the plane.

Sannikov, "Radiance Cascades: A Novel Approach to Calculating Global Illumination" (2023, draft):
light from near needs many probes and few directions, light from far few probes and many directions.
Cascade n has probes 2^n ``spacing`` apart, each with 4^n ``rays`` directions, whose rays cover the
distances from (4^n - 1) / 3 to (4^(n+1) - 1) / 3 times ``interval``; so every cascade but the last
costs the same, whatever the number of directions. From its far end on, every ray is continued by
the four directions of the next cascade that it becomes, in the four probes about it.

The next cascade's rays start elsewhere than where this one's end. Where its probes are interpolated
first and the ray is continued by the result, light leaks past edges and rings about lamps. Here is
the bilinear fix (same author and others, 2024): a ray is traced four times, to where the ray of
each of the four probes begins, and the four whole ways are interpolated.

Two errors remain: a cascade's interval resolves only so many directions, and a probe's light is
interpolated between probes. There is no derivative; ``godfit.flatland.render`` refuses it.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from godfit.flatland.canvas import Canvas
from godfit.flatland.rays import (
    BORDER_OVERSHOOT,
    ROW_BLOCKS,
    compiled_call,
    directions,
    free_distance,
    padded_cells,
    row_blocks,
)
from godfit.flatland.sky import Sky

BRANCHING = 4
"""Directions that one becomes in the next cascade: with probes twice as far apart both ways there
is a quarter of them, so every cascade has as many rays."""

PROBE_SPACING = 1.0
"""Pixels between probes of the first cascade: one a pixel, so the result is not interpolated."""

FIRST_INTERVAL = 1.5
"""Pixels, the length of the first cascade's rays: about the spacing of its probes, as the paper's
penumbra condition has it."""


def cascades(
    canvas: Canvas,
    sky: Sky,
    rays: int = 4,
    spacing: float = PROBE_SPACING,
    interval: float = FIRST_INTERVAL,
) -> Float[Array, "h w 3"]:
    """The mean radiance that reaches every pixel.

    ``rays`` are the directions of the first cascade, ``spacing`` is that of its probes and
    ``interval`` the length of its rays, in pixels.
    """
    h, w = canvas.size
    dtype = canvas.opacity.dtype
    free, cells = free_distance(canvas), padded_cells(canvas)
    diagonal = math.hypot(h, w)
    ends = [0.0]
    while ends[-1] < diagonal:
        ends.append(interval * (BRANCHING ** len(ends) - 1) / (BRANCHING - 1))
    levels = len(ends) - 1

    def probes(level: int) -> tuple[int, int]:
        apart = spacing * 2**level
        return max(1, math.ceil(h / apart)), max(1, math.ceil(w / apart))

    merged = jnp.zeros((1, 4), dtype)
    for level in reversed(range(levels)):
        count = rays * BRANCHING**level
        rows, columns = probes(level)
        last = level == levels - 1
        upper_rows, upper_columns = (1, 1) if last else probes(level + 1)
        lengths = [
            spacing * 2**level, ends[level], ends[level + 1],
            0.0 if last else spacing * 2 ** (level + 1), BORDER_OVERSHOOT[dtype],
        ]  # fmt: skip
        blocks = [
            compiled_call(
                "merge", (size, columns, 4 * count), dtype, free, cells,
                directions(count, 1, dtype), merged, jnp.asarray(lengths, dtype),
                jnp.asarray([first, upper_rows, upper_columns, BRANCHING], jnp.int32),
            )
            for first, size in row_blocks(rows, ROW_BLOCKS)
        ]  # fmt: skip
        merged = jnp.concatenate(blocks, 0)
        if last:
            # Light that passes the last cascade is the sky's.
            light = merged.reshape(rows, columns, count, 4)
            beyond = sky.over(count).astype(dtype)[None, None]
            merged = light.at[..., :3].add(light[..., 3:] * beyond)
        merged = merged.reshape(rows * columns, 4 * count)
    rows, columns = probes(0)
    mean = merged.reshape(rows, columns, rays, 4)[..., :3].mean(2)
    return _at_pixels(mean, (h, w), spacing)


def _at_pixels(probes, size, spacing):
    """The light (rows, columns, 3) of ``probes``, interpolated bilinearly at the pixels' middles:
    (h, w, 3)."""
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

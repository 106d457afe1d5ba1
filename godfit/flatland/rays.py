"""The radiance that the rays of every pixel gather: the march and the distance march, with their
derivatives.

Ray i of R leaves the pixel's middle at angle 2 pi (i + 1/2) / R, or, with jitter, anywhere in that
R-th of the circle. It gathers radiance from the pixels that it crosses until one lets nothing
through, or until the canvas ends and the sky begins. A pixel counts once, its own does not. The
step is

- ``march``: always the same; what is crossed in less than a step may be leapt over;
- ``distance``: sphere tracing (Hart, "Sphere Tracing", The Visual Computer 12 (1996)) through the
  jump-flood field, and near surfaces to the next pixel's border, so that nothing is leapt over. Two
  errors remain: that of the number of rays, and pixels whose jump-flood distance is too long.

Derivatives by radiance, opacity and sky are those of this sum, exact for the rays that there are,
at empty pixels too. The rays' paths do not depend on the canvas's values, and opacity enters as a
product, so shapes whose edges are soft on the canvas have true derivatives by their position.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int32

from godfit.flatland.canvas import Canvas
from godfit.flatland.cascade_kernel import CASCADE_FUNCTIONS
from godfit.flatland.derivative_kernel import DERIVATIVE_FUNCTIONS
from godfit.flatland.jump_flood import jump_flood
from godfit.flatland.kernel_records import Grid, TraceInputs
from godfit.flatland.render_kernel import RENDER_FUNCTIONS
from godfit.flatland.walk_kernel import FILLED, OUTSIDE
from godfit.runtime import xla_ffi

XLA_NAMES = xla_ffi.declare(
    "godfit_flatland",
    {
        key: f"{function.__module__}:{function.__name__}"
        for table in (RENDER_FUNCTIONS, DERIVATIVE_FUNCTIONS, CASCADE_FUNCTIONS)
        for key, function in table.items()
    },
)
"""Names of the compiled functions in XLA, by (function, whether in double precision)."""

TRACE_RANKS = "2222211"
"""Axes of ``trace_arguments``."""
ARGUMENT_RANKS = {
    "render": TRACE_RANKS,
    "tangent": TRACE_RANKS + "22",
    "transpose": TRACE_RANKS + "2",
    "merge": "222211",
}
"""Axes of each compiled function's arguments."""

ROW_BLOCKS = 16
"""Calls of a compiled function for one picture, which XLA shares out among its threads: more than
there are cores, so that no thread waits long for the last."""

TRANSPOSE_BLOCKS = 4
"""The same for the transpose: fewer, as each call has a result of the whole canvas's size."""

BORDER_OVERSHOOT = {jnp.dtype("float32"): 1e-3, jnp.dtype("float64"): 1e-9}
"""Pixels; the distance march takes a ray this far over a cell's border, well above the rounding
error of a position."""


class TraceSettings(NamedTuple):
    """``rays`` a pixel, ``max_steps`` steps a ray, and the ``step_length`` in pixels, 0 for the
    distance march."""

    rays: int
    max_steps: int
    step_length: float = 0.0


def angles(rays: int, jitter_bins: int, dtype) -> Float[Array, "directions"]:
    """Angles in radians, counterclockwise from the right, of ``jitter_bins`` rays in each of
    ``rays`` equal parts of the circle."""
    count = rays * jitter_bins
    return (jnp.arange(count, dtype=dtype) + 0.5) * (2 * math.pi / count)


def directions(rays: int, jitter_bins: int, dtype) -> Float[Array, "directions 2"]:
    """Unit vectors of ``angles``, right and down."""
    angle = angles(rays, jitter_bins, dtype)
    return jnp.stack([jnp.cos(angle), -jnp.sin(angle)], -1)


def steps_to_cross(h: int, w: int) -> int:
    """More steps than a ray that goes from border to border can take."""
    return h + w + 2


def free_distance(canvas: Canvas, march: bool = False) -> Float[Array, "H W"]:
    """(h + 2, w + 2) how far there is nothing from anywhere in a pixel; FILLED where there is
    something and OUTSIDE around. For a march, 0 where there is nothing."""
    filled = (canvas.opacity > 0) | (canvas.radiance > 0).any(-1)
    return _free_distance(filled, march, canvas.opacity.dtype)


@functools.partial(jax.jit, static_argnums=(1, 2))
def _free_distance(filled: Bool[Array, "h w"], march: bool, dtype) -> Float[Array, "H W"]:
    h, w = filled.shape
    if march:
        free = jnp.zeros((h, w), dtype)
    else:
        # The flood's distance is from middle to middle; both pixels have half a diagonal.
        free = jnp.clip(jump_flood(filled).distance - math.sqrt(2), 0, 2.0 * (h + w)).astype(dtype)
    return jnp.pad(jnp.where(filled, FILLED, free), 1, constant_values=OUTSIDE)


def padded_cells(canvas: Canvas) -> Float[Array, "cells 4"]:
    """Radiance and opacity of the padded canvas, pixel by pixel."""
    both = jnp.concatenate([canvas.radiance, canvas.opacity[..., None]], -1)
    return jnp.pad(both, ((1, 1), (1, 1), (0, 0))).reshape(-1, 4)


def gathered(
    canvas: Canvas,
    sky: Float[Array, "directions 3"],
    settings: TraceSettings,
    jitter_bin: Int32[Array, "h w"] | None,
    plain: bool,
) -> Float[Array, "h w 3"]:
    """The mean radiance over every pixel's rays.

    ``sky`` has the radiance outside in every direction of every ray; ``jitter_bin`` is which of its
    directions each of a pixel's rays takes, None if there is one; ``plain`` chooses XLA's own loops
    in place of the compiled ones, which are for CPUs.
    """
    inputs = trace_inputs(canvas, sky, settings, jitter_bin)
    if plain:
        from godfit.flatland.reference import reference_trace

        # Leaps only where steps are counted: in XLA's loops, which have a fixed length, leaps gain
        # nothing, and what is leapt over would have no derivative.
        return reference_trace(inputs, settings, settings.max_steps < steps_to_cross(*canvas.size))
    return _traced(inputs.grid.cells, inputs.sky, inputs, settings)


def trace_inputs(
    canvas: Canvas,
    sky: Float[Array, "directions 3"],
    settings: TraceSettings,
    jitter_bin: Int32[Array, "h w"] | None,
) -> TraceInputs:
    """The arrays of ``gathered``'s arguments; the free distance has no derivative."""
    dtype = canvas.opacity.dtype
    march = settings.step_length > 0
    return TraceInputs(
        Grid(jax.lax.stop_gradient(free_distance(canvas, march)), padded_cells(canvas)),
        directions(settings.rays, sky.shape[0] // settings.rays, dtype),
        sky.astype(dtype),
        jnp.zeros(canvas.size, jnp.int32) if jitter_bin is None else jitter_bin,
    )


def radiance_and_transmittance(
    canvas: Canvas, settings: TraceSettings
) -> Float[Array, "h w channels"]:
    """(h, w, 3 + rays) the mean radiance that the canvas itself sends to a pixel, and every ray's
    transmittance of the sky's light, divided by the number of rays. No derivative."""
    sky = jnp.zeros((settings.rays, 3), canvas.opacity.dtype)
    inputs = jax.lax.stop_gradient(trace_inputs(canvas, sky, settings, None))
    return trace(inputs, settings, 3 + settings.rays)


def row_blocks(rows: int, most: int) -> list[tuple[int, int]]:
    """(first row, number of rows) of at most ``most`` blocks."""
    length = -(-rows // most)
    return [(first, min(length, rows - first)) for first in range(0, rows, length)]


def compiled_call(function: str, shape: tuple[int, ...], dtype, *arguments):
    """The result, of this shape and dtype, of a compiled function."""
    name = XLA_NAMES[function, dtype == jnp.float64]
    ranks = ARGUMENT_RANKS[function]
    return xla_ffi.call(name, jax.ShapeDtypeStruct(shape, dtype), *arguments, ranks=ranks)


def trace_arguments(
    inputs: TraceInputs, settings: TraceSettings, *rows: int
) -> tuple[Float[Array, "..."] | Int32[Array, "..."], ...]:
    """The arguments of a compiled function, as ``kernel_records.read_trace_arguments`` takes them
    apart. The counts, which come last, end in the ``rows`` that this call computes."""
    dtype = inputs.grid.free_distance.dtype
    jitter_bins = inputs.directions.shape[0] // settings.rays
    counts = [settings.rays, jitter_bins, settings.max_steps, *rows]
    lengths = [settings.step_length, BORDER_OVERSHOOT[dtype]]
    arrays = (*inputs.grid, inputs.directions, inputs.sky, inputs.jitter_bin)
    return *arrays, jnp.asarray(lengths, dtype), jnp.asarray(counts, jnp.int32)


def trace(
    inputs: TraceInputs, settings: TraceSettings, channels: int
) -> Float[Array, "h w channels"]:
    """The mean over every pixel's rays, compiled: 3 channels, or those of
    ``radiance_and_transmittance``."""
    (h, w), dtype = inputs.jitter_bin.shape, inputs.grid.free_distance.dtype
    blocks = [
        compiled_call(
            "render", (rows, w, channels), dtype, *trace_arguments(inputs, settings, first)
        )
        for first, rows in row_blocks(h, ROW_BLOCKS)
    ]
    return jnp.concatenate(blocks, 0)


@functools.partial(jax.custom_jvp, nondiff_argnums=(3,))
def _traced(cells, sky, inputs: TraceInputs, settings):
    return trace(_replaced(inputs, cells, sky), settings, 3)


def _replaced(inputs: TraceInputs, cells, sky) -> TraceInputs:
    return inputs._replace(grid=inputs.grid._replace(cells=cells), sky=sky)


@functools.partial(_traced.defjvp, symbolic_zeros=True)
def _traced_jvp(settings, primals, tangents):
    cells, sky, inputs = primals
    inputs = _replaced(inputs, cells, sky)
    out = _traced(cells, sky, inputs, settings)
    d_out = jnp.zeros_like(out)
    # One by one: what is transposed must be linear in all of its arguments.
    for by_sky, tangent in enumerate(tangents[:2]):
        if not isinstance(tangent, jax.custom_derivatives.SymbolicZero):
            forward = functools.partial(_forward, settings, by_sky == 1)
            backward = functools.partial(_backward, settings, by_sky == 1)
            d_out += jax.custom_derivatives.linear_call(forward, backward, inputs, tangent)
    return out, d_out


def _forward(settings, by_sky: bool, inputs: TraceInputs, tangent):
    """The derivative along a tangent of the cells or of the sky."""
    (h, w), dtype = inputs.jitter_bin.shape, inputs.grid.free_distance.dtype
    if by_sky:
        tangents = jnp.zeros_like(inputs.grid.cells), tangent
    else:
        tangents = tangent, jnp.zeros_like(inputs.sky)
        # Empty pixels with a tangent count as well, though no ray stops at them yet.
        filled = ((inputs.grid.cells != 0) | (tangent != 0)).any(-1)
        filled = filled.reshape(h + 2, w + 2)[1:-1, 1:-1]
        free = _free_distance(filled, settings.step_length > 0, dtype)
        inputs = inputs._replace(grid=inputs.grid._replace(free_distance=free))
    blocks = [
        compiled_call(
            "tangent", (rows, w, 3), dtype, *trace_arguments(inputs, settings, first), *tangents
        )
        for first, rows in row_blocks(h, ROW_BLOCKS)
    ]
    return jnp.concatenate(blocks, 0)


def _backward(settings, by_sky: bool, inputs: TraceInputs, cotangent):
    """The transpose of ``_forward``. By the cells it is as slow as a march: every empty cell has a
    derivative, and which of them are needed is not known."""
    (h, w), dtype = inputs.jitter_bin.shape, inputs.grid.free_distance.dtype
    if not by_sky:
        free = _free_distance(jnp.ones((h, w), bool), True, dtype)
        inputs = inputs._replace(grid=inputs.grid._replace(free_distance=free))
    cells, sky_rows = inputs.grid.cells.shape[0], inputs.sky.shape[0]
    cotangent = cotangent.reshape(h, 3 * w)
    blocks = [
        compiled_call(
            "transpose", (1, cells + sky_rows, 4), dtype,
            *trace_arguments(inputs, settings, first, first + rows), cotangent,
        )
        for first, rows in row_blocks(h, TRANSPOSE_BLOCKS)
    ]  # fmt: skip
    both = jnp.concatenate(blocks, 0).sum(0)
    return both[cells:, :3] if by_sky else both[:cells]

"""What the rays of every pixel see: the march and the distance march, with their derivatives.

Ray i of R leaves the pixel's middle at angle 2 pi (i + 1/2) / R, or, with jitter, anywhere in that
R-th of the circle, and gathers radiance from the pixels that it crosses until one lets nothing
through or the canvas ends and the sky is seen. A pixel counts once, its own does not. The step is

- ``march``: always the same; what is crossed in less than a step may be leapt over;
- ``distance``: sphere tracing (Hart, "Sphere Tracing", The Visual Computer 12 (1996)) through the
  jump-flood field, and near surfaces to the next pixel's border, so that nothing is leapt over:
  what is left of error is the number of rays, and pixels whose jump-flood distance is too long.

Derivatives by radiance, opacity and sky are those of this sum, exact for the rays that there are,
at empty pixels too. Where rays go does not depend on the canvas's values, and opacity enters as a
product, so shapes whose edges are soft on the canvas have true derivatives by their position.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int32

from godfit.flatland import cascade_kernel, derivative_kernel, render_kernel
from godfit.flatland.canvas import Canvas
from godfit.flatland.jump_flood import jump_flood
from godfit.flatland.walk_kernel import FILLED, OUTSIDE
from godfit.runtime.xla_ffi import declare, register

NAMES = declare(
    "godfit_flatland",
    render_kernel.FUNCTIONS | derivative_kernel.FUNCTIONS | cascade_kernel.FUNCTIONS,
)
# Calls for one picture, which XLA shares out among its threads.
CALLS = 16
# A transpose has a result of the canvas's size for every call.
TRANSPOSED_CALLS = 4
# Pixels; a ray is taken this far over a border, well above what rounding leaves of a place.
LITTLE = {jnp.dtype("float32"): 1e-3, jnp.dtype("float64"): 1e-9}


class Prepared(NamedTuple):
    """See ``godfit.flatland.walk_kernel`` and ``render_kernel``."""

    free: Float[Array, "H W"]
    cells: Float[Array, "cells 4"]
    directions: Float[Array, "kinds 2"]
    sky: Float[Array, "kinds 3"]
    turn: Int32[Array, "h w"]


def angles(rays: int, kinds: int, dtype) -> Float[Array, "kinds"]:
    """Angles in radians, counterclockwise from the right, of ``kinds`` rays in each of ``rays``
    equal parts of the circle."""
    count = rays * kinds
    return (jnp.arange(count, dtype=dtype) + 0.5) * (2 * math.pi / count)


def enough(h: int, w: int) -> int:
    """More steps than a ray that goes from border to border can take."""
    return h + w + 2


def free_distance(canvas: Canvas, march: bool = False) -> Float[Array, "H W"]:
    """(h + 2, w + 2) how far there is nothing from anywhere in a pixel; FILLED where there is
    something and OUTSIDE around. For a march, 0 where there is nothing."""
    return _free((canvas.opacity > 0) | (canvas.radiance > 0).any(-1), march, canvas.opacity.dtype)


def _free(filled: Bool[Array, "h w"], march: bool, dtype) -> Float[Array, "H W"]:
    h, w = filled.shape
    if march:
        free = jnp.zeros((h, w), dtype)
    else:
        # From middle to middle; both pixels have half a diagonal.
        free = jnp.clip(jump_flood(filled).distance - math.sqrt(2), 0, 2.0 * (h + w)).astype(dtype)
    return jnp.pad(jnp.where(filled, FILLED, free), 1, constant_values=OUTSIDE)


def cells_of(canvas: Canvas) -> Float[Array, "cells 4"]:
    """Radiance and opacity of the padded canvas, pixel by pixel."""
    both = jnp.concatenate([canvas.radiance, canvas.opacity[..., None]], -1)
    return jnp.pad(both, ((1, 1), (1, 1), (0, 0))).reshape(-1, 4)


def gathered(
    canvas: Canvas,
    sky: Float[Array, "kinds 3"],
    rays: int,
    steps: int,
    step: float,
    turn: Int32[Array, "h w"] | None,
    plain: bool,
) -> Float[Array, "h w 3"]:
    """The mean over every pixel's rays of what they see.

    ``sky`` has the radiance that every ray of every kind sees outside; ``step`` is in pixels, 0 for
    the distance march; ``turn`` is each pixel's kind; ``plain`` asks for XLA's own loops in place
    of the compiled ones, which are for CPUs.
    """
    prepared = prepare(canvas, sky, rays, step, turn)
    if plain:
        from godfit.flatland.reference import walk

        h, w = canvas.size
        # Leaps only where they are counted: in XLA's loops, of a fixed length, they gain nothing,
        # and what is leapt over would have no derivative.
        return walk(prepared, rays, steps, step, leap=steps < enough(h, w))
    return _seen(prepared.cells, prepared.sky, prepared, (rays, steps, step))


def prepare(canvas: Canvas, sky, rays: int, step: float, turn) -> Prepared:
    h, w = canvas.size
    dtype = canvas.opacity.dtype
    at = angles(rays, sky.shape[0] // rays, dtype)
    return Prepared(
        jax.lax.stop_gradient(free_distance(canvas, march=step > 0)),
        cells_of(canvas),
        # Rows go down.
        jnp.stack([jnp.cos(at), -jnp.sin(at)], -1),
        sky.astype(dtype),
        jnp.zeros((h, w), jnp.int32) if turn is None else turn,
    )


def passing(
    canvas: Canvas, rays: int, steps: int, step: float = 0.0
) -> Float[Array, "h w channels"]:
    """(h, w, 3 + rays) the mean of what the canvas itself sends to a pixel, and for every ray the
    share of the sky's light that comes through, divided by the number of rays. No derivative."""
    sky = jnp.zeros((rays, 3), canvas.opacity.dtype)
    given = jax.lax.stop_gradient(prepare(canvas, sky, rays, step, None))
    return look(given, (rays, steps, step), 3 + rays)


def shares(size: int, most: int) -> list[tuple[int, int]]:
    """(begin, length) of at most ``most`` parts of ``size``."""
    length = -(-size // most)
    return [(begin, min(length, size - begin)) for begin in range(0, size, length)]


def _numbers(given: Prepared, how) -> tuple[tuple, list[int]]:
    rays, steps, step = how
    kinds = given.directions.shape[0] // rays
    dtype = given.free.dtype
    numbers = jnp.asarray([step, LITTLE[dtype]], dtype)
    return (*given, numbers), [rays, kinds, steps]


def call(kind: str, shape: tuple[int, ...], dtype, *arguments):
    """A compiled function's result."""
    name = NAMES[kind, dtype == jnp.float64]
    register(name)
    made = jax.ffi.ffi_call(name, jax.ShapeDtypeStruct(shape, dtype), vmap_method="sequential")
    return made(*arguments)


def look(
    given: Prepared, how: tuple[int, int, float], channels: int
) -> Float[Array, "h w channels"]:
    """What the rays of every pixel see, compiled: 3 channels, or those of ``passing``. ``how`` is
    rays, steps and the length of a step."""
    (h, w), dtype = given.turn.shape, given.free.dtype
    arguments, whole = _numbers(given, how)
    parts = [
        call(
            "render", (size, w, channels), dtype, *arguments,
            jnp.asarray([*whole, begin], jnp.int32),
        )
        for begin, size in shares(h, CALLS)
    ]  # fmt: skip
    return jnp.concatenate(parts, 0)


@functools.partial(jax.custom_jvp, nondiff_argnums=(3,))
def _seen(cells, sky, given: Prepared, how):
    return look(given._replace(cells=cells, sky=sky), how, 3)


@functools.partial(_seen.defjvp, symbolic_zeros=True)
def _seen_jvp(how, primals, tangents):
    cells, sky, given = primals
    given = given._replace(cells=cells, sky=sky)
    out = _seen(cells, sky, given, how)
    moved = jnp.zeros_like(out)
    # One by one: what is transposed must be linear in all that it is given.
    for which, tangent in enumerate(tangents[:2]):
        if not isinstance(tangent, jax.custom_derivatives.SymbolicZero):
            forward = functools.partial(_forward, how, which)
            backward = functools.partial(_backward, how, which)
            moved += jax.custom_derivatives.linear_call(forward, backward, given, tangent)
    return out, moved


def _forward(how, which, given: Prepared, move):
    """The derivative along a move of the cells (0) or of the sky (1)."""
    (h, w), dtype = given.turn.shape, given.free.dtype
    if which == 0:
        # Empty pixels that move count as well, though no ray stops at them yet.
        there = ((given.cells != 0) | (move != 0)).any(-1).reshape(h + 2, w + 2)[1:-1, 1:-1]
        given = given._replace(free=_free(there, how[2] > 0, dtype))
    arguments, whole = _numbers(given, how)
    moves = (move, jnp.zeros_like(given.sky)) if which == 0 else (jnp.zeros_like(given.cells), move)
    parts = [
        call(
            "tangent", (size, w, 3), dtype, *arguments,
            jnp.asarray([*whole, begin], jnp.int32), *moves,
        )
        for begin, size in shares(h, CALLS)
    ]  # fmt: skip
    return jnp.concatenate(parts, 0)


def _backward(how, which, given: Prepared, pull):
    """The transpose. By the cells it is as slow as a march: which of the empty ones anyone asks for
    is not known, and every one has a derivative."""
    (h, w), dtype = given.turn.shape, given.free.dtype
    if which == 0:
        given = given._replace(free=_free(jnp.ones((h, w), bool), True, dtype))
    arguments, whole = _numbers(given, how)
    cells, kinds = given.cells.shape[0], given.sky.shape[0]
    pull = pull.reshape(h, 3 * w)
    parts = [
        call(
            "transpose", (1, cells + kinds, 4), dtype, *arguments,
            jnp.asarray([*whole, begin, begin + size], jnp.int32), pull,
        )
        for begin, size in shares(h, TRANSPOSED_CALLS)
    ]  # fmt: skip
    both = jnp.concatenate(parts, 0).sum(0)
    return both[:cells] if which == 0 else both[cells:, :3]

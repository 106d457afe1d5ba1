"""Coarse: the light pass at half or a quarter of the resolution, as the shaders have it.

The mask is averaged over cells of 2x2 or 4x4 pixels, summed at that size and read back bilinearly
(GPU Gems 3, ch. 13; Vesper and DawnTime do it by default). Unlike there, the pixel's own value is
taken from the full mask, so that edges stay sharp. Points other than whole pictures are few, and
are summed exactly.

Cost: that of the exact sum over 4 or 16, and the reading back. Error: that of the blur at edges of
streaks, most near the light, where they are finer than a cell.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from godfit.scattering.radial.derivatives import along_the_ray
from godfit.scattering.radial.exact import exact
from godfit.scattering.taps import Taps


def shrunk(mask: Float[Array, "h w"], cell: int) -> Float[Array, "rows columns"]:
    """Means over cells of ``cell`` pixels squared; what is missing repeats the edge."""
    h, w = mask.shape
    rows, columns = -(-h // cell), -(-w // cell)
    whole = jnp.pad(mask, ((0, rows * cell - h), (0, columns * cell - w)), mode="edge")
    return whole.reshape(rows, cell, columns, cell).mean((1, 3))


def _grown(values: Float[Array, "n ..."], size: int, cell: int) -> Float[Array, "size ..."]:
    """Linear reads between cells along the first axis, clamped to its ends."""
    place = jnp.clip((jnp.arange(size) - (cell - 1) / 2) / cell, 0, values.shape[0] - 1)
    first = place.astype(jnp.int32)
    share = (place - first).astype(values.dtype).reshape((-1,) + (1,) * (values.ndim - 1))
    return values[first] * (1 - share) + share * values[jnp.minimum(first + 1, values.shape[0] - 1)]


def coarse(
    mask: Float[Array, "h w"],
    light: Float[Array, "2"],
    taps: Taps,
    at: Float[Array, "*points 2"] | None,
    *,
    cell: int,
) -> Float[Array, "*points"]:
    """See ``godfit.scattering.radial.radial_sum``; ``cell`` is the side of a cell in pixels."""
    along_the_ray(taps)
    if at is not None:
        return exact(mask, light, taps, at)
    h, w = mask.shape
    low = shrunk(mask, cell)
    # Where cells stand over the mask's edge their picture is larger: u from the left, v from the
    # top.
    wide, high = w / (low.shape[1] * cell), h / (low.shape[0] * cell)
    moved = jnp.stack([light[0] * wide, 1 - (1 - light[1]) * high])
    inner = exact(low, moved, jax.tree.map(jnp.asarray, _without_own(taps)), None)
    across = _grown(inner.T, w, cell).T
    return taps.own * mask + _grown(across, h, cell)


def _without_own(taps: Taps) -> Taps:
    return Taps(
        jnp.zeros_like(taps.own), taps.first, taps.ratio, taps.step, taps.count, taps.unit, taps.lag
    )

"""Low resolution: the light pass at half or a quarter of the resolution, as in the shaders.

The mask is averaged over cells of 2x2 or 4x4 pixels, summed at that size and enlarged bilinearly
(GPU Gems 3, ch. 13; Vesper and DawnTime do it by default). Unlike there, the pixel's own value
comes from the full mask, so that edges stay sharp. Points other than whole pictures are few, and
are summed exactly.

Cost: that of the exact sum over 4 or 16, and the enlarging. Error: that of the blur at edges of
streaks, largest near the light, where streaks are finer than a cell.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from godfit.scattering.radial.derivatives import require_ray_taps
from godfit.scattering.radial.exact import exact
from godfit.scattering.taps import Taps


def _cell_means(mask: Float[Array, "h w"], cell: int) -> Float[Array, "rows columns"]:
    """Means over cells of ``cell`` x ``cell`` pixels; beyond the mask its edge is repeated."""
    h, w = mask.shape
    rows, columns = -(-h // cell), -(-w // cell)
    padded = jnp.pad(mask, ((0, rows * cell - h), (0, columns * cell - w)), mode="edge")
    return padded.reshape(rows, cell, columns, cell).mean((1, 3))


def _enlarged(values: Float[Array, "n ..."], size: int, cell: int) -> Float[Array, "size ..."]:
    """The first axis interpolated linearly between the cells' centres, clamped at its ends."""
    place = jnp.clip((jnp.arange(size) - (cell - 1) / 2) / cell, 0, values.shape[0] - 1)
    first = place.astype(jnp.int32)
    share = (place - first).astype(values.dtype).reshape((-1,) + (1,) * (values.ndim - 1))
    return values[first] * (1 - share) + share * values[jnp.minimum(first + 1, values.shape[0] - 1)]


def low_resolution(
    mask: Float[Array, "h w"],
    light: Float[Array, "2"],
    taps: Taps,
    at: Float[Array, "*points 2"] | None,
    *,
    cell: int,
) -> Float[Array, "*points"]:
    """See ``godfit.scattering.radial.radial_sum``; ``cell`` is the side of a cell in pixels."""
    require_ray_taps(taps)
    if at is not None:
        return exact(mask, light, taps, at)
    h, w = mask.shape
    means = _cell_means(mask, cell)
    # Where cells extend beyond the mask the small picture covers more than the mask does. The light
    # keeps its distance from the left and the top edge in pixels.
    share_x, share_y = w / (means.shape[1] * cell), h / (means.shape[0] * cell)
    rescaled = jnp.stack([light[0] * share_x, 1 - (1 - light[1]) * share_y])
    sums = exact(means, rescaled, jax.tree.map(jnp.asarray, _without_own(taps)), None)
    wide = _enlarged(sums.T, w, cell).T
    return taps.own * mask + _enlarged(wide, h, cell)


def _without_own(taps: Taps) -> Taps:
    return Taps(
        jnp.zeros_like(taps.own), taps.first, taps.ratio, taps.step, taps.count, taps.unit, taps.lag
    )

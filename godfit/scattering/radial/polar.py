"""Polar: rays become rows, and the sum over taps one matrix that all rows share.

The mask is resampled about the light onto angles x radii. There a tap at t scales the radius by
1 - t at every angle, so the whole sum is a matrix from radii to radii. The matrix is computed once
from the taps, with linear interpolation between radii; the picture is resampled bilinearly from the
result. Rays as rows are the epipolar sampling of Engelhardt & Dachsbacher (I3D 2010) and Baran et
al. (SIGGRAPH 2010).

With the light in the picture the radii form a sinh grid, twice as fine near the light as on
average. With the light outside, only the angles that the picture spans are used, and most radii lie
between the picture's nearest and farthest point.

Taps beyond the light (density above 1) lie on the rays' continuation, at distances below 0. With
such taps rays and matrix have twice the columns.

Cost: angles x radii^2, one matmul, for any number of taps; it grows faster than the picture. Error:
that of two bilinear resamplings, at the picture's own resolution. Points other than whole pictures
are summed exactly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from godfit.scattering.parameters import LIGHT_DENSITY
from godfit.scattering.radial.coordinates import points, to_pixels
from godfit.scattering.radial.derivatives import require_ray_taps
from godfit.scattering.radial.exact import exact
from godfit.scattering.radial.reference import bilinear
from godfit.scattering.taps import Taps

SINH_AT_LAST_RADIUS = 2.2
"""Argument of the sinh at the last radius: 2.2 / sinh(2.2) is about a half, so that the grid is
twice as fine at the light as on average."""
MAX_APPROACH_SHARE = 0.25
"""Largest share of the radii that lie between a light outside and the picture's nearest point."""
MIN_ANGLE_SPAN = 1e-6
"""Smallest span of the angles, in radians: a picture of one pixel has none, nor has a row whose
light lies in its direction, and a division by it must be finite."""


class PolarGrid(NamedTuple):
    """Rays and radii about the light, in pixels. ``angles`` rays cover ``span`` radians from
    ``low`` on, counted from the direction ``middle`` (x, y); ``radii`` end at the picture's
    ``farthest`` point, and ``nearest`` is the distance of its nearest, 0 with the light inside."""

    middle: Float[Array, "2"]
    low: Float[Array, ""]
    span: Float[Array, ""]
    nearest: Float[Array, ""]
    farthest: Float[Array, ""]
    angles: int
    radii: int

    def radius(self, s: Float[Array, "..."]) -> Float[Array, "..."]:
        """Distance from the light, in pixels, of the position ``s`` in the grid, from 0 to 1."""
        inside = self.farthest * jnp.sinh(SINH_AT_LAST_RADIUS * s) / math.sinh(SINH_AT_LAST_RADIUS)
        q = self._approach_share()
        near = self.nearest * s / jnp.where(q > 0, q, 1)
        far = self.nearest + (self.farthest - self.nearest) * (s - q) / (1 - q)
        return jnp.where(self.nearest > 0, jnp.where(s < q, near, far), inside)

    def position(self, radius: Float[Array, "..."]) -> Float[Array, "..."]:
        """The inverse of ``radius``."""
        inside = jnp.arcsinh(radius / self.farthest * math.sinh(SINH_AT_LAST_RADIUS))
        inside = inside / SINH_AT_LAST_RADIUS
        q = self._approach_share()
        near = q * radius / jnp.where(self.nearest > 0, self.nearest, 1)
        far = q + (1 - q) * (radius - self.nearest) / (self.farthest - self.nearest)
        return jnp.where(self.nearest > 0, jnp.where(radius < self.nearest, near, far), inside)

    def _approach_share(self) -> Float[Array, ""]:
        return jnp.minimum(MAX_APPROACH_SHARE, self.nearest / self.farthest)


def _grid(h: int, w: int, light_x, light_y) -> PolarGrid:
    size = max(16, round(math.hypot(h, w) / math.sqrt(2)))
    x = jnp.array([0, w - 1, 0, w - 1], light_x.dtype) - light_x
    y = jnp.array([0, 0, h - 1, h - 1], light_y.dtype) - light_y
    nearest = _length(light_x - jnp.clip(light_x, 0, w - 1), light_y - jnp.clip(light_y, 0, h - 1))
    outside = nearest > 0
    # At least a pixel more, because a picture of one pixel has no extent.
    farthest = jnp.maximum(_length(x, y).max(), nearest + 1)
    x, y = jnp.where(outside, x, 1), jnp.where(outside, y, 0)
    middle = jnp.stack([x.mean(), y.mean()])
    corners = jnp.arctan2(middle[0] * y - middle[1] * x, middle[0] * x + middle[1] * y)
    low = jnp.where(outside, corners.min(), -jnp.pi)
    high = jnp.where(outside, corners.max(), jnp.pi)
    span = jnp.maximum(high - low, MIN_ANGLE_SPAN)
    return PolarGrid(middle, low, span, nearest, farthest, 2 * size, size)


def _length(x, y):
    """``jnp.hypot`` with a finite derivative at 0."""
    squared = x * x + y * y
    return jnp.where(squared > 0, jnp.sqrt(jnp.where(squared > 0, squared, 1)), 0)


def radial_matrix(
    taps: Taps, radius: Float[Array, " n"], place: Float[Array, " m"], dtype
) -> Float[Array, "n m"]:
    """Entry (i, j) is the weight of the value at ``place`` j in the sum at ``radius`` i.

    Both are distances from the light, and ``place`` is below 0 on the other side of it. It is
    increasing, and values are linear in between.

    A run of consecutive taps falls between two radii. The weights that it gives to both depend only
    on the sums of its c and of its c t, which are differences of running totals. So the cost does
    not depend on the number of taps.
    """
    c, t = taps.c.astype(dtype), taps.t.astype(dtype)
    zero = jnp.zeros(1, dtype)
    running = jnp.concatenate([zero, jnp.cumsum(c)])
    running_t = jnp.concatenate([zero, jnp.cumsum(c * t)])
    own = radius[:, None]
    # On the way from radius i past the light, taps up to this t have not passed place j. At the
    # light itself all taps stay there.
    at_light = jnp.where(place < 0, jnp.inf, -1).astype(dtype)
    last_t = jnp.where(own > 0, 1 - place[None] / jnp.where(own > 0, own, 1), at_light[None])
    step = jnp.where(jnp.asarray(taps.step) > 0, taps.step, 1e-6)
    beyond = lax.stop_gradient(jnp.floor(last_t / step + taps.lag))
    beyond = jnp.clip(beyond, 0, taps.count).astype(jnp.int32)
    total, total_t = running[beyond], running_t[beyond]
    run, run_t = total[:, :-1] - total[:, 1:], total_t[:, :-1] - total_t[:, 1:]
    upper = (own * (run - run_t) - place[None, :-1] * run) / jnp.diff(place)[None]
    matrix = jnp.pad(upper, ((0, 0), (1, 0))) + jnp.pad(run - upper, ((0, 0), (0, 1)))
    # Taps beyond the first place read the value there.
    return matrix.at[:, 0].add(running[-1] - total[:, 0])


def polar(
    mask: Float[Array, "h w"],
    light: Float[Array, "2"],
    taps: Taps,
    at: Float[Array, "*points 2"] | None,
) -> Float[Array, "*points"]:
    """See ``godfit.scattering.radial.radial_sum``."""
    require_ray_taps(taps)
    if at is not None:
        return exact(mask, light, taps, at)
    h, w = mask.shape
    light_x, light_y = to_pixels(light, h, w)
    grid = _grid(h, w, light_x, light_y)
    radius = grid.radius(jnp.arange(grid.radii, dtype=mask.dtype) / (grid.radii - 1))
    share_of_span = jnp.arange(grid.angles, dtype=mask.dtype) / (grid.angles - 1)
    angle = jnp.arctan2(grid.middle[1], grid.middle[0]) + grid.low + grid.span * share_of_span

    def sums_over(place):
        rays = bilinear(
            mask,
            light_x + jnp.cos(angle)[:, None] * place[None],
            light_y + jnp.sin(angle)[:, None] * place[None],
        )
        matrix = radial_matrix(taps, radius, place, mask.dtype)
        return jnp.matmul(rays, matrix.T, precision=lax.Precision.HIGHEST)

    both_sides = jnp.concatenate([-radius[:0:-1], radius])
    sums = lax.cond(
        taps.end > LIGHT_DENSITY, lambda: sums_over(both_sides), lambda: sums_over(radius)
    )
    x, y = points(h, w, None, mask.dtype)
    x, y = x - light_x, y - light_y
    distance = _length(x, y)
    # A pixel at the light has no angle: any gives the same value.
    x = jnp.where(distance > 0, x, 1)
    m_x, m_y = grid.middle
    row = (jnp.arctan2(m_x * y - m_y * x, m_x * x + m_y * y) - grid.low) / grid.span
    of_rays = bilinear(sums, grid.position(distance) * (grid.radii - 1), row * (grid.angles - 1))
    return taps.own * mask + of_rays

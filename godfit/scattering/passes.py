"""Sums that are no sequence of geometric taps: Blender's, Godot 4's and jMonkeyEngine's.

Each is written from its formula with the reads of the reference method, whose derivatives are JAX's
own. All take a mask (h, w) and give values at every pixel, or at columns and rows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.scattering.conventions.convention import Convention
from godfit.scattering.radial.coordinates import points, to_pixels
from godfit.scattering.radial.reference import WeightedTaps, bilinear, weighted_sum
from godfit.scattering.taps import Scalar

GAUSS_TAPS = 16
"""Taps of Godot 4's Gauss on either side of a pixel (gaussian_blur.glsl, M)."""
GAUSS_SIGMA = 10.0
"""Its standard deviation, in taps (gaussian_blur.glsl, coeffs)."""
AT_LIGHT = 1e-6
"""Distance in pixels below which a pixel is the light's own: the ray has no direction there."""


class Pass(NamedTuple):
    """A pass's numbers: the ``light`` (u, v), ``density``, ``samples`` and the further numbers of
    its convention, and ``at`` (..., 2), columns and rows, or None for every pixel."""

    light: Float[Array, "2"]
    density: Scalar
    samples: int
    options: dict[str, float]
    at: Float[Array, "*points 2"] | None


def composed_sum(
    shader: Convention,
    mask: Float[Array, "h w"] | Float[Array, "h w c"],
    numbers: Pass,
) -> Float[Array, "..."]:
    """The sum of a convention with ``passes``, without its exposure, channel by channel."""
    light = jnp.asarray(numbers.light, mask.dtype)
    given = numbers._replace(light=light, density=jnp.asarray(numbers.density, mask.dtype))
    one = PASSES[shader.passes]
    if mask.ndim == 2:
        return one(mask, given)
    return jnp.stack([one(mask[..., c], given) for c in range(mask.shape[-1])], -1)


def sun_beams(mask: Float[Array, "h w"], given: Pass) -> Float[Array, "*points"]:
    """Blender's Sun Beams: sum_{i=0..m} (1 - i/m)^2 M_i / sum (1 - i/m)^2 in steps of a pixel.

    m, in pixels, is the smaller of ``density`` times the diagonal and the distance to the light. It
    is no whole number here, whereas Blender cuts its fraction off; the last weight vanishes, so
    that the sum is continuous in it. ``samples`` is the most steps that are summed.
    """
    h, w = mask.shape
    x, y = points(h, w, given.at, mask.dtype)
    light_x, light_y = to_pixels(given.light, h, w)
    ray_x, ray_y = light_x - x, light_y - y
    squared = ray_x**2 + ray_y**2
    away = squared > AT_LIGHT**2
    distance = jnp.sqrt(jnp.where(away, squared, 1.0))
    m = jnp.minimum(given.density * float(np.hypot(h, w)), distance)

    def step(sums, i):
        weight = jnp.where(i < m, jnp.maximum(1 - i / m, 0), 0.0) ** 2
        value = bilinear(mask, x + i * ray_x / distance, y + i * ray_y / distance)
        return (sums[0] + weight * value, sums[1] + weight), None

    zero = jnp.zeros_like(x)
    steps = jnp.arange(given.samples + 1, dtype=mask.dtype)
    (total, weights), _ = jax.lax.scan(step, (zero, zero), steps)
    return jnp.where(away, total / jnp.maximum(weights, AT_LIGHT), bilinear(mask, x, y))


def godot4(mask: Float[Array, "h w"], given: Pass) -> Float[Array, "*points"]:
    """RERadialSunRays: the mean of ``samples`` nearest texels at a (k/n) min(|x - l|/R, 1), blurred
    by a Gauss; a is ``density``, R the option ``radius`` in pixels of the pass, and ``gaussian``
    the reach of the Gauss in pixels, 1.6 standard deviations. Reads are clamped to the edge.

    The derivative by light and density is that of ``nearest``."""
    h, w = mask.shape
    x, y = points(h, w, None, mask.dtype)
    light_x, light_y = to_pixels(given.light, h, w)
    ray_x, ray_y = light_x - x, light_y - y
    squared = ray_x**2 + ray_y**2
    away = squared > AT_LIGHT**2
    distance = jnp.where(away, jnp.sqrt(jnp.where(away, squared, 1.0)), 0.0)
    reach = given.density * jnp.minimum(distance / given.options["radius"], 1)

    def tap(total, t):
        return total + nearest(mask, x + t * reach * ray_x, y + t * reach * ray_y), None

    shares = jnp.arange(given.samples, dtype=mask.dtype) / given.samples
    total, _ = jax.lax.scan(tap, jnp.zeros_like(x), shares)
    blurred = _gauss(total / given.samples, given.options["gaussian"])
    if given.at is None:
        return blurred
    return bilinear(blurred, given.at[..., 0], given.at[..., 1])


@jax.custom_jvp
def nearest(
    mask: Float[Array, "h w"], x: Float[Array, "*points"], y: Float[Array, "*points"]
) -> Float[Array, "*points"]:
    """The mask's texels nearest to columns ``x`` and rows ``y`` (pixels), clamped to its edge.

    Its derivative by the place, which vanishes wherever there is one, is that of its mean over
    places within half a texel. This mean is the bilinear read.
    """
    h, w = mask.shape
    column = jnp.clip(jnp.round(x), 0, w - 1).astype(jnp.int32)
    row = jnp.clip(jnp.round(y), 0, h - 1).astype(jnp.int32)
    return mask[row, column]


@nearest.defjvp
def _nearest_and_slope(at, moved):
    (mask, x, y), (mask_moved, x_moved, y_moved) = at, moved
    _, slope = jax.jvp(lambda x, y: bilinear(mask, x, y), (x, y), (x_moved, y_moved))
    return nearest(mask, x, y), nearest(mask_moved, x, y) + slope


def _gauss(image: Float[Array, "h w"], reach: float) -> Float[Array, "h w"]:
    """The image blurred by Godot 4's Gauss, whose last taps are ``reach`` pixels away."""
    steps = np.arange(-GAUSS_TAPS, GAUSS_TAPS + 1)
    offsets = np.floor(reach * steps / GAUSS_TAPS).astype(int)
    weights = np.exp(-0.5 * (steps / GAUSS_SIGMA) ** 2)
    weights = jnp.asarray(weights / weights.sum(), image.dtype)
    for axis in (0, 1):
        size = image.shape[axis]
        taken = np.clip(np.arange(size)[:, None] + offsets, 0, size - 1)
        image = jnp.tensordot(jnp.take(image, taken, axis), weights, ((axis + 1,), (0,)))
    return image


def jmonkey(mask: Float[Array, "h w"], given: Pass) -> Float[Array, "*points"]:
    """jMonkeyEngine's mean of ``samples`` taps at 1 - b - W k/(n-1): W is ``density``, b the option
    ``start``, the distance of the first tap from the light."""
    n = given.samples
    t = 1 - given.options["start"] - given.density * jnp.arange(n, dtype=mask.dtype) / (n - 1)
    share = jnp.full(n, 1 / n, mask.dtype)
    return weighted_sum(mask, given.light, WeightedTaps(0.0, share, t), given.at)


Sum = Callable[[Any, Pass], Any]
PASSES: dict[str, Sum] = {"sun-beams": sun_beams, "godot4": godot4, "jmonkey": jmonkey}
"""The sums by the names that a convention's ``passes`` has."""

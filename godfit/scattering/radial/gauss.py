"""Quadrature: Gauss-Legendre nodes along the ray instead of taps.

The taps are a midpoint rule for the integral of first ratio^(t/step + lag - 1) M(x + t (l - x))
over t/step. A Gauss rule of a few nodes integrates the same function, and its weights are scaled to
the taps' total. A Gauss rule gains from an integrand with derivatives. On soft masks it needs fewer
nodes than there are merged taps (``godfit.scattering.radial.merged_taps``) for the same error; on
hard edges it gains nothing.

Cost: nodes x points x 4 texel reads. Error: falls as 1/nodes on hard masks, much faster on soft
ones.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.scattering.radial.derivatives import require_ray_taps
from godfit.scattering.radial.exact import exact
from godfit.scattering.radial.reference import WeightedTaps, weighted_sum
from godfit.scattering.taps import Taps

MIN_QUADRATURE_RATIO = 1e-3
"""Smaller ratios are raised to this one: theirs have all weight in the first taps, and the
derivative of a power below 1 has no bound at 0."""


def gauss(
    mask: Float[Array, "h w"],
    light: Float[Array, "2"],
    taps: Taps,
    at: Float[Array, "*points 2"] | None,
    *,
    nodes: int,
) -> Float[Array, "*points"]:
    """See ``godfit.scattering.radial.radial_sum``; exact where there are at most ``nodes`` taps."""
    require_ray_taps(taps)
    if taps.count <= nodes:
        return exact(mask, light, taps, at)
    x, width = np.polynomial.legendre.leggauss(nodes)
    # The interval is from half a tap before the first to half a tap behind the last, in taps.
    k = jnp.asarray(0.5 + taps.count * (x + 1) / 2, mask.dtype)
    width = jnp.asarray(width, mask.dtype)
    weight = width * jnp.maximum(taps.ratio, MIN_QUADRATURE_RATIO) ** (k - k[0])
    c = taps.c.sum() * weight / weight.sum()
    t = (k - taps.lag) * taps.step
    return weighted_sum(mask, light, WeightedTaps(taps.own, c, t), at)

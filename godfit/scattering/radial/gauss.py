"""Quadrature: Gauss-Legendre nodes along the ray instead of taps.

The taps are a midpoint rule for the integral of first ratio^(t/step + lag - 1) M(x + t (l - x))
over t/step; a Gauss rule of a few nodes integrates the same, and its weights are scaled to the
taps' own total. The gain of a Gauss rule needs an integrand with derivatives: on soft masks it
needs fewer nodes than there are merged taps (``godfit.scattering.radial.merged_taps``) for the same error, on hard
edges it has none.

Cost: nodes x points x 4 reads. Error: falls as 1/nodes on hard masks, much faster on soft ones.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.scattering.radial.derivatives import along_the_ray
from godfit.scattering.radial.exact import exact
from godfit.scattering.radial.reference import weighted_sum
from godfit.scattering.taps import Taps

# Ratios below this have all their weight in the first taps, and powers below 1 of them have
# derivatives without bound.
LEAST_RATIO = 1e-3


def gauss(
    mask: Float[Array, "h w"],
    light: Float[Array, "2"],
    taps: Taps,
    at: Float[Array, "*points 2"] | None,
    *,
    nodes: int,
) -> Float[Array, "*points"]:
    """See ``godfit.scattering.radial.radial_sum``; the sum itself where it has no more taps than ``nodes``."""
    along_the_ray(taps)
    if taps.count <= nodes:
        return exact(mask, light, taps, at)
    x, width = np.polynomial.legendre.leggauss(nodes)
    # From half a tap before the first to half a tap after the last, in taps.
    k = jnp.asarray(0.5 + taps.count * (x + 1) / 2, mask.dtype)
    weight = jnp.asarray(width, mask.dtype) * jnp.maximum(taps.ratio, LEAST_RATIO) ** (k - k[0])
    c = taps.c.sum() * weight / weight.sum()
    t = (k - taps.lag) * taps.step
    return weighted_sum(mask, light, taps.own, c, t, at)

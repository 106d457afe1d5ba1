"""All methods by name, and ``radial_sum``, which evaluates a sum by one of them."""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from godfit.errors import InputError
from godfit.io.arrays import as_light
from godfit.runtime.device import on_device
from godfit.runtime.program_cache import cached_jit
from godfit.scattering.radial.exact import EXACT, Method, fastest
from godfit.scattering.radial.gauss import gauss
from godfit.scattering.radial.low_resolution import low_resolution
from godfit.scattering.radial.merged_taps import merged
from godfit.scattering.radial.polar import polar
from godfit.scattering.taps import Taps, TracedCount

METHODS: dict[str, Method] = EXACT | {
    **{f"merged/{m}": functools.partial(merged, m=m) for m in (2, 4, 8)},
    "half": functools.partial(low_resolution, cell=2),
    "quarter": functools.partial(low_resolution, cell=4),
    "polar": polar,
    **{f"gauss/{nodes}": functools.partial(gauss, nodes=nodes) for nodes in (16, 32)},
}
"""Exact methods, and approximations with the number of taps merged into one, the reduction of the
resolution, or the number of quadrature nodes."""


def radial_sum(
    mask: Any,
    light: Any,
    taps: Taps,
    *,
    at: Float[Array, "*points 2"] | None = None,
    method: str = "auto",
) -> Float[Array, "..."]:
    """Evaluate the radial sum of ``mask``.

    **Arguments:**

    - `mask`: occlusion mask, (h, w) or (h, w, channels), row 0 at the top; interpolated bilinearly
      and clamped to its edge. Integers are levels, see `godfit.io.arrays`.
    - `light`: (u, v) of the light in texture coordinates, on or off the image.
    - `taps`: positions and weights of the taps.
    - `at`: (..., 2) columns and rows to evaluate at, in pixels of the mask (whole numbers are pixel
      centres, at which nothing is interpolated); by default every pixel.
    - `method`: a key of `METHODS`, or `"auto"`: the fastest exact one that serves these taps.

    **Returns:** values shaped like `at` without its last axis ((h, w) by default), then channels.

    Differentiable in `mask`, `light` and `taps`, forward and reverse. Raises ValueError for an
    unknown method or one that cannot serve these taps, and InputError, which is one, for a mask
    that holds no light.

    >>> import numpy as np, godfit
    >>> taps = godfit.Taps(own=1.0, first=0.5, ratio=0.9, step=0.1, count=8)
    >>> godfit.radial_sum(np.ones((4, 6)), (0.5, 0.5), taps).shape
    (4, 6)
    """
    if method == "auto":
        method = fastest(taps)
    if method not in METHODS:
        raise ValueError(f"method: expected auto or one of {', '.join(METHODS)}, got '{method}'")
    mask = as_light(mask, "mask")
    if mask.ndim not in (2, 3) or 0 in mask.shape:
        raise InputError(f"mask: expected shape (h, w) or (h, w, channels), got {mask.shape}")
    light = on_device(light, mask.dtype)
    taps = jax.tree.map(lambda z: on_device(z, mask.dtype), taps)
    traced = isinstance(taps.count, TracedCount) or any(
        isinstance(leaf, Tracer) for leaf in jax.tree.leaves((mask, light, taps, at))
    )
    return (_by_channel if traced else _compiled)(method, mask, light, taps, at)


def _by_channel(method, mask, light, taps, at):
    evaluate = METHODS[method]
    if mask.ndim == 2:
        return evaluate(mask, light, taps, at)
    channels = [evaluate(mask[..., c], light, taps, at) for c in range(mask.shape[-1])]
    return jnp.stack(channels, axis=-1)


_compiled = cached_jit(_by_channel)
"""As one program: outside of one, each of its operations would be compiled by itself."""

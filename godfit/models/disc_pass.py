"""The light pass of a disc light at points of its mask, with its derivatives, as one XLA call.

The call runs the kernel of ``disc_kernel.py``, on CPUs. No mask but the open one is computed.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from godfit.models.disc_kernel import SLOPE_ROWS, VALUE_ROWS
from godfit.runtime import xla_ffi
from godfit.scattering.radial.derivatives import RayParameters
from godfit.scattering.taps import Count

DISC_TARGETS = xla_ffi.declare(
    "godfit_disc",
    {False: "godfit.models.disc_kernel:_single", True: "godfit.models.disc_kernel:_double"},
)
"""Names of the compiled functions in XLA, by whether in double precision."""
POINTS_OF_ONE_CALL = 4096
"""Points up to which one call is made: XLA's threads are not worth their start for fewer."""
PARALLEL_CALLS = 8
"""Calls that more points are shared out to, for XLA's threads."""


class DiscShape(NamedTuple):
    """A disc light: ``shape`` (3,) is its radius and edge width, in heights of the mask, and the
    veil; texels are ``cut`` into that many parts a side; in derivatives the edge is at least
    ``soft`` texels wide."""

    shape: Float[Array, " 3"]
    cut: int
    soft: float


class Lit(NamedTuple):
    """The light pass at n points.

    ``itself`` is the mask there; ``sums`` are its four sums over taps (see
    ``godfit.scattering.radial.derivatives``), the first alone without slopes. ``itself_by`` and
    ``sum_by`` are the derivatives of the mask and of the first sum by the light's place (u, v),
    radius, edge and veil, through the mask; without slopes they are empty.
    """

    itself: Float[Array, " n"]
    sums: Float[Array, "sums n"]
    itself_by: Float[Array, "5 n"]
    sum_by: Float[Array, "5 n"]


def disc_pass(
    open_: Float[Array, "h w"],
    at: Float[Array, "2 n"],
    numbers: RayParameters,
    count: Count,
    disc: DiscShape,
    slopes: bool,
) -> Lit:
    """The light pass at columns and rows ``at``, under ``count`` taps along the ray, in the
    precision of the open mask, which has at least two rows and columns. NaN where a number is not
    finite."""
    dtype, double = open_.dtype, open_.dtype == jnp.float64
    packed = jnp.concatenate([jnp.stack([jnp.asarray(z, dtype) for z in numbers]), disc.shape])
    packed = jnp.append(packed.astype(dtype), jnp.asarray(disc.soft, dtype))
    whole = jnp.asarray([count, disc.cut], jnp.int32)
    rows = SLOPE_ROWS if slopes else VALUE_ROWS

    def call(part):
        shaped = jax.ShapeDtypeStruct((rows, 1, part.shape[1]), dtype)
        name = DISC_TARGETS[double]
        return xla_ffi.call(name, shaped, open_, part, packed, whole, ranks="2211")[:, 0]

    n = at.shape[1]
    size = n if n <= POINTS_OF_ONE_CALL else -(-n // PARALLEL_CALLS)
    parts = [call(at[:, begin : begin + size]) for begin in range(0, n, size)]
    out = jnp.concatenate(parts, -1) if len(parts) > 1 else parts[0]
    return Lit(out[0], out[1 : 5 if slopes else 2], out[5:10], out[10:])

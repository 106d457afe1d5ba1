"""Taps: where a radial sum evaluates the mask on the way to the light, and with what weights.

    out(x) = c_0 M(x) + sum_{k=1..K} c_k M(x + t_k (l - x))

In every god-ray shader in use c_k is a geometric and t_k an arithmetic sequence, so that five
numbers determine all taps, and four sums every derivative (see
``godfit.scattering.radial.derivatives``). How a shader's parameters become taps is its convention,
see ``godfit.scattering.conventions``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import equinox as eqx
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float, Int

Scalar = Float[Array, ""] | float


@dataclass(frozen=True, eq=False)
class TracedCount:
    """A number of taps that a compiled program takes at run time.

    Only methods that do not unroll the taps serve it.
    """

    value: Int[Array, ""]


# Pyright treats a count as an int: only the methods that serve a TracedCount distinguish it.
if TYPE_CHECKING:
    Count = int
else:
    Count = int | Int[Array, ""] | TracedCount


def as_count(number: Any) -> Any:
    """The ``count`` of ``Taps`` for a number that may be traced."""
    return TracedCount(number) if isinstance(number, Tracer) else number


def number_of(taps: Taps) -> Any:
    """The number of taps, traced or not, for kernels that take it at run time."""
    return taps.count.value if isinstance(taps.count, TracedCount) else taps.count


class Taps(eqx.Module):
    """Taps c_k = first * ratio**(k-1) at t_k = (k - lag) * step for k = 1..count, and c_0 = own at
    t_0 = 0. The lag of most shaders is 0; that of merged taps, each in place of several, is not.

    ``count`` is a Python number or, inside a program that serves every number, a ``TracedCount``.
    ``unit`` is that of ``step``: ``"ray"``, a fraction of the way from the pixel to the light (0 at
    the pixel, 1 at the light), or ``"uv"``, a distance in texture coordinates. With ``"uv"`` taps
    beyond the light have no weight.

    >>> import godfit
    >>> (taps,) = godfit.CONVENTIONS["dawntime"].taps(0.1, 0.5, 0.8, 1.0, 4)
    >>> [round(float(t), 3) for t in taps.t], [round(float(c), 4) for c in taps.c]
    ([0.2, 0.4, 0.6], [0.05, 0.025, 0.0125])
    """

    own: Scalar
    first: Scalar
    ratio: Scalar
    step: Scalar
    count: Count = eqx.field(static=True)
    unit: Literal["ray", "uv"] = eqx.field(static=True, default="ray")
    lag: Scalar = 0.0

    @property
    def c(self) -> Float[Array, " count"]:
        """Weights c_1..c_K."""
        return self.first * jnp.asarray(self.ratio) ** jnp.arange(self.count)

    @property
    def t(self) -> Float[Array, " count"]:
        """Positions t_1..t_K in ``unit``."""
        return jnp.asarray(self.step) * (jnp.arange(1, self.count + 1) - self.lag)

    @property
    def end(self) -> Scalar:
        """Position of the last tap in ``unit``."""
        return self.step * (self.count - self.lag)

    @property
    def total(self) -> Float[Array, ""]:
        """c_0 + sum c_k: the sum over a mask that is 1 everywhere."""
        return self.own + self.c.sum()


def averaging_taps(samples: Count) -> Taps:
    """Taps whose sum is the mean of the mask over ``samples`` equal steps from pixel to light.

    For a mask that is 1 where the sky is visible this mean is 1 - D, the unoccluded share of the
    ray (Mitchell, GPU Gems 3, ch. 13, equation 3).
    """
    return Taps(0.0, 1 / samples, 1.0, 1 / samples, as_count(samples))

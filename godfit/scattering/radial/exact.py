"""The fastest exact method on this machine, which approximations also build on."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from importlib.util import find_spec

import jax
from jaxtyping import Array, Float

from godfit.runtime.program_cache import RunTime
from godfit.scattering.radial.packed import packed
from godfit.scattering.radial.pairs import pairs
from godfit.scattering.radial.reference import reference
from godfit.scattering.radial.strips import strips
from godfit.scattering.taps import Count, Taps

Method = Callable[
    [Float[Array, "h w"], Float[Array, "2"], Taps, Float[Array, "*points 2"] | None],
    Float[Array, "*points"],
]

EXACT: dict[str, Method] = {"reference": reference, "pairs": pairs, "packed": packed}
"""Methods whose only error is rounding: packed for 8-bit masks, the others for every mask.
Reference serves all taps, the others those whose unit is the ray."""

if find_spec("numba") is None:
    warnings.warn("without numba sums take some ten times as long", stacklevel=2)
else:
    EXACT["strips"] = strips


def fastest(taps: Taps) -> str:
    """Name of the fastest exact method that serves ``taps``."""
    if taps.unit != "ray":
        return "reference"
    return "strips" if jax.default_backend() == "cpu" and "strips" in EXACT else "pairs"


def at_run_time(samples: Count) -> Count:
    """``samples``, as a number that compiled programs take at run time if the fastest method can:
    a program compiled for one number then serves every other."""
    strips_serve = jax.default_backend() == "cpu" and "strips" in EXACT
    return RunTime(samples) if strips_serve and isinstance(samples, int) else samples


def compile_fastest() -> None:
    """Compile the numba functions of the fastest method, or load them from numba's cache.

    Does nothing where the fastest method has none.
    """
    if jax.default_backend() == "cpu" and "strips" in EXACT:
        from godfit.runtime.xla_ffi import register
        from godfit.scattering.radial.strips import STRIP_CALLS

        register(STRIP_CALLS[False])


def exact(
    mask: Float[Array, "h w"],
    light: Float[Array, "2"],
    taps: Taps,
    at: Float[Array, "*points 2"] | None,
) -> Float[Array, "*points"]:
    """The radial sum by the fastest exact method; see ``godfit.scattering.radial.radial_sum``."""
    return EXACT[fastest(taps)](mask, light, taps, at)

"""The fastest exact method on this machine, which approximations also build on."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import jax
from jaxtyping import Array, Float

from godfit.runtime.program_cache import RunTime
from godfit.scattering.radial.packed import packed
from godfit.scattering.radial.pairs import pairs
from godfit.scattering.radial.reference import reference
from godfit.scattering.taps import Count, Taps

Method = Callable[
    [Float[Array, "h w"], Float[Array, "2"], Taps, Float[Array, "*points 2"] | None],
    Float[Array, "*points"],
]

# Exact: reference for every mask and taps, packed for 8-bit masks.
EXACT: dict[str, Method] = {"reference": reference, "pairs": pairs, "packed": packed}

try:
    from godfit.scattering.radial.strips import strips
except ImportError as error:
    warnings.warn(f"without numba sums take some ten times as long: {error}", stacklevel=2)
else:
    EXACT["strips"] = strips


def fastest(taps: Taps) -> str:
    """Name of the fastest exact method that serves ``taps``."""
    if taps.unit != "ray":
        return "reference"
    return "strips" if jax.default_backend() == "cpu" and "strips" in EXACT else "pairs"


def at_run_time(samples: Count) -> Count:
    """``samples`` so that a program compiled for one number serves every other, where the fastest
    method takes the number of taps at run time."""
    strips_serve = jax.default_backend() == "cpu" and "strips" in EXACT
    return RunTime(samples) if strips_serve and isinstance(samples, int) else samples


def load_fastest() -> None:
    """Compile or load what this method is made of, if it is not made by XLA."""
    if jax.default_backend() == "cpu" and "strips" in EXACT:
        from godfit.scattering.radial.strips_kernel import target

        # In the order in which a fit needs them.
        target("points", double=False)
        target("picture", double=False)


def exact(
    mask: Float[Array, "h w"],
    light: Float[Array, "2"],
    taps: Taps,
    at: Float[Array, "*points 2"] | None,
) -> Float[Array, "*points"]:
    """See ``godfit.scattering.radial.radial_sum``."""
    return EXACT[fastest(taps)](mask, light, taps, at)

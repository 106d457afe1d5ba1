"""Compiled programs of a test's own, which run a few times on small pictures."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax

UNOPTIMISED = {"xla_backend_optimization_level": 0}
"""Options of XLA: what LLVM optimises takes up to three times as long to compile. The programs of
fits and commands are optimised in the tests as they are elsewhere. A float64 sum that XLA's older
emitter of fusions compiles without optimisation may gain a tap at a pixel (jaxlib 0.10): where the
reference sum is read beyond the light, it is optimised."""

quick_jit = functools.partial(jax.jit, compiler_options=UNOPTIMISED)
"""``jax.jit`` without LLVM's optimisation."""


def quick_filter_jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """``equinox.filter_jit`` without LLVM's optimisation."""
    jit: Any = eqx.filter_jit
    return jit(function, compiler_options=UNOPTIMISED)

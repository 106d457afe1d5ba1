"""The radial sum: out(x) = c_0 M(x) + sum_k c_k M(x + t_k (l - x)).

``radial_sum`` evaluates it by one of several methods. A method is an algorithm: its inputs are taps
and not shaders, and all methods compute the same values up to their stated error. To add one, write
a function ``f(mask, light, taps, at) -> values`` in a file of its own and name it in ``METHODS``.
``error`` measures a method's error on a mask, and ``cheapest`` selects the cheapest method whose
error is within a tolerance.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from godfit.scattering.radial.error_estimate import cheapest, error
    from godfit.scattering.radial.exact import EXACT, Method
    from godfit.scattering.radial.methods import METHODS, radial_sum

__all__ = ["EXACT", "METHODS", "Method", "cheapest", "error", "radial_sum"]

# Imported where they are used: the process that compiles the kernel does without JAX.
_HOMES = {
    "EXACT": "exact", "METHODS": "methods", "Method": "exact", "cheapest": "error_estimate",
    "error": "error_estimate", "radial_sum": "methods",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)

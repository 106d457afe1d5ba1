"""The radial sum: out(x) = c_0 M(x) + sum_k c_k M(x + t_k (l - x)).

``radial_sum`` evaluates it by one of several methods. A method is an algorithm: its inputs are taps
and not shaders, and all methods compute the same values up to their stated error. To add one, write
a function ``f(mask, light, taps, at) -> values`` in a file of its own and name it in ``METHODS``.
``error`` measures a method's error on a mask, and ``cheapest`` selects the cheapest method whose
error is within a tolerance.
"""

from __future__ import annotations

from godfit.scattering.radial.error_estimate import cheapest, error
from godfit.scattering.radial.exact import EXACT, Method
from godfit.scattering.radial.methods import METHODS, radial_sum

__all__ = ["EXACT", "METHODS", "Method", "cheapest", "error", "radial_sum"]

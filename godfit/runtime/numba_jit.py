"""How functions are compiled: kept between runs, and free of the interpreter's lock."""

from __future__ import annotations

from numba import njit

from godfit.runtime.cache import numba_keeps

jit = njit(cache=numba_keeps(), nogil=True, error_model="numpy")
# Of sums in which terms may be fused and divisions multiplied out.
fast_jit = njit(
    cache=numba_keeps(), nogil=True, error_model="numpy", fastmath={"contract", "nsz", "arcp"}
)
# What is compiled for its caller is optimised once more with it.
inlined_jit = njit(inline="always")

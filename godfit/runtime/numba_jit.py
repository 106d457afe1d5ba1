"""How numba compiles the package's functions: cached on disk, without the interpreter's lock."""

from __future__ import annotations

from numba import njit

from godfit.runtime.cache import enable_numba_cache

jit = njit(cache=enable_numba_cache(), nogil=True, error_model="numpy")
# For sums in which a multiplication and an addition may be fused, the sign of zero ignored and a
# division replaced by a multiplication with the reciprocal.
fast_jit = njit(
    cache=enable_numba_cache(),
    nogil=True,
    error_model="numpy",
    fastmath={"contract", "nsz", "arcp"},
)
# For small functions, which are inlined before the caller is compiled and optimised with it.
inlined_jit = njit(inline="always")

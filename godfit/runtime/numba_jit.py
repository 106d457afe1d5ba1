"""How numba compiles the package's functions: cached on disk, without the interpreter's lock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit

from godfit.runtime.numba_cache import store_compiled


def _stored_jit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """``njit`` whose machine code is stored in the cache folder."""

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher = njit(nogil=True, error_model="numpy", **options)(function)
        store_compiled(dispatcher, function)
        return dispatcher

    return compiled


jit = _stored_jit()
# For sums in which a multiplication and an addition may be fused, the sign of zero ignored and a
# division replaced by a multiplication with the reciprocal.
fast_jit = _stored_jit(fastmath={"contract", "nsz", "arcp"})
# For small functions, which are inlined before the caller is compiled and optimised with it.
inlined_jit = njit(inline="always")

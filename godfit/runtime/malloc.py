"""Freed memory goes back from the C library to the system.

glibc maps large blocks one by one and unmaps them when they are freed. But it raises the size from
which it does so to that of the last freed block, up to 32 MiB. Arrays of a 1920x1080 picture then
lie in the heap, between blocks that the compiler still uses. glibc also gives every few threads an
arena of their own, and returns only the free memory at an arena's top (mallopt(3),
malloc_trim(3)). Together that is a hundred megabytes and more of a fit's peak.
"""

from __future__ import annotations

import ctypes
import functools
import sys
from typing import Any

# The parameters' numbers in malloc.h.
M_TRIM_THRESHOLD = -1
M_MMAP_THRESHOLD = -3
M_ARENA_MAX = -8

MMAP_BYTES = 16 << 20
"""Size from which a block is mapped by itself, in bytes. At 16 MiB mapping costs nothing that can
be measured; at 4 MiB it costs a fifth of a whole command, most of it zeroing pages."""
MAX_ARENAS = 2
"""Number of arenas: free memory below an arena's top stays with the process."""
FREE_TOP_BYTES = 64 << 20
"""Free memory at the top that is not returned, in bytes. Returning and taking it again caused a
third of the page faults of a 1920x1080 picture, half a second."""
TRIM_AFTER_SECONDS = 0.1
"""Compilations at least this long, in seconds, free enough memory to be worth a trim."""


@functools.cache
def return_freed_memory() -> None:
    """Set glibc's thresholds for the whole process, and trim the heap after long compilations.

    Nothing changes where the C library is another one.
    """
    libc: Any = ctypes.CDLL(None) if sys.platform == "linux" else None
    if not hasattr(libc, "mallopt"):
        return
    libc.mallopt(M_MMAP_THRESHOLD, MMAP_BYTES)
    libc.mallopt(M_ARENA_MAX, MAX_ARENAS)
    libc.mallopt(M_TRIM_THRESHOLD, FREE_TOP_BYTES)

    # Imported late, because it loads JAX: the thresholds must hold from JAX's first block on.
    import jax.monitoring

    from godfit.runtime.compile_time import BACKEND_COMPILE_EVENT

    def trim(event: str, duration_secs: float, **_: str | int) -> None:
        if event == BACKEND_COMPILE_EVENT and duration_secs > TRIM_AFTER_SECONDS:
            libc.malloc_trim(0)

    jax.monitoring.register_event_duration_secs_listener(trim)

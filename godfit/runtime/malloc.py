"""How much memory the C library keeps that nobody uses any more.

glibc maps large blocks one by one and gives them back, but raises the size from which it does so to
that of whatever was freed last, up to 32 MiB: arrays of a 1920x1080 picture then lie between what
the compiler has left. It gives every few threads an arena of their own, and of what is freed only
the top goes back (mallopt(3), malloc_trim(3)). Together that is a hundred megabytes and more of a
fit's peak.
"""

from __future__ import annotations

import ctypes
import functools
import sys
from typing import Any

# Numbers of the parameters in malloc.h. From 16 MiB on, mapping costs nothing that can be measured;
# from 4 on a fifth of a whole command, most of it zeroing pages.
M_MMAP_THRESHOLD, LARGE = -3, 16 << 20
M_ARENA_MAX, ARENAS = -8, 2
# Free memory at the top that is kept: given back at every turn and taken again, it was a third of
# the page faults of a picture of 1920x1080, half a second.
M_TRIM_THRESHOLD, FREE = -1, 64 << 20
COMPILED = "/jax/core/compile/backend_compile_duration"
# Seconds of compiling that leave something worth giving back.
LONG = 0.1


@functools.cache
def keep_little() -> None:
    """For the whole process, where the C library is glibc; nothing changes elsewhere."""
    libc: Any = ctypes.CDLL(None) if sys.platform == "linux" else None
    if not hasattr(libc, "mallopt"):
        return
    libc.mallopt(M_MMAP_THRESHOLD, LARGE)
    libc.mallopt(M_ARENA_MAX, ARENAS)
    libc.mallopt(M_TRIM_THRESHOLD, FREE)

    import jax.monitoring

    def trim(event: str, duration_secs: float, **_: str | int) -> None:
        if event == COMPILED and duration_secs > LONG:
            libc.malloc_trim(0)

    jax.monitoring.register_event_duration_secs_listener(trim)

"""Seconds in which this process compiled, which a second run reads from the cache."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Iterator

import jax.monitoring

BACKEND_COMPILE_EVENT = "/jax/core/compile/backend_compile_duration"
"""Name under which JAX reports how long XLA compiled one program, in seconds."""
LOWERING_EVENT = "/jax/core/compile/jaxpr_to_mlir_module_duration"
"""Name under which JAX reports how long it lowered one program, in seconds."""

_spans: list[tuple[float, float]] = []
"""When something was compiled, by ``time.perf_counter``: spans apart from each other, in order."""
_lock = threading.Lock()
_beside = threading.local()


def _add_duration(event: str, duration_secs: float, **_: str | int) -> None:
    if event in (LOWERING_EVENT, BACKEND_COMPILE_EVENT) and not hasattr(_beside, "others"):
        with _lock:
            end = time.perf_counter()
            begin = end - duration_secs
            # Threads compile at once: what two of them share counts once.
            while _spans and _spans[-1][1] >= begin:
                begin = min(begin, _spans.pop()[0])
            _spans.append((begin, end))


jax.monitoring.register_event_duration_secs_listener(_add_duration)


@contextlib.contextmanager
def beside_others() -> Iterator[None]:
    """What this thread compiles takes no time of those that go on meanwhile."""
    _beside.others = True
    try:
        yield
    finally:
        del _beside.others


def compile_seconds(since: float) -> float:
    """Seconds after ``since`` (``time.perf_counter``) in which at least one thread compiled."""
    with _lock:
        return math.fsum(end - max(begin, since) for begin, end in _spans if end > since)

"""Seconds that this process has spent compiling, which a second run reads from the cache."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

import jax.monitoring

BACKEND_COMPILE_EVENT = "/jax/core/compile/backend_compile_duration"
"""Name under which JAX reports how long XLA compiled one program, in seconds."""
LOWERING_EVENT = "/jax/core/compile/jaxpr_to_mlir_module_duration"
"""Name under which JAX reports how long it lowered one program, in seconds."""

_seconds = 0.0
_beside = threading.local()


def _add_duration(event: str, duration_secs: float, **_: str | int) -> None:
    global _seconds
    if event in (LOWERING_EVENT, BACKEND_COMPILE_EVENT) and not hasattr(_beside, "others"):
        _seconds += duration_secs


jax.monitoring.register_event_duration_secs_listener(_add_duration)


@contextlib.contextmanager
def beside_others() -> Iterator[None]:
    """What this thread compiles takes no time of those that go on meanwhile."""
    _beside.others = True
    try:
        yield
    finally:
        del _beside.others


def compile_seconds() -> float:
    """Seconds of compilation since this module was imported."""
    return _seconds

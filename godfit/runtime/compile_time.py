"""How long this process has spent compiling: what a first run pays and a second one need not."""

from __future__ import annotations

import jax.monitoring

_seconds = 0.0
_EVENTS = (
    "/jax/core/compile/jaxpr_to_mlir_module_duration",
    "/jax/core/compile/backend_compile_duration",
)


def _listen(event: str, duration_secs: float, **_: str | int) -> None:
    global _seconds
    if event in _EVENTS:
        _seconds += duration_secs


jax.monitoring.register_event_duration_secs_listener(_listen)


def compile_seconds() -> float:
    """Seconds of compilation since this module was imported."""
    return _seconds

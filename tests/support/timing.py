"""How long a call takes."""

from __future__ import annotations

import time

import jax


def timed(function) -> float:
    """Seconds of one call, to the end of what it computes."""
    began = time.perf_counter()
    jax.block_until_ready(function())
    return time.perf_counter() - began

"""What a computation of this package leaves as it was in the program that called it.

Settings of JAX and NumPy belong to a thread, and those of the caller may be stricter than a fit
allows. So a computation has its own, in the caller's thread and in each thread that it starts.
What belongs to the process is in ``host_state.py``.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from typing import Any

import jax
import numpy as np

from godfit.errors import InputError
from godfit.runtime.host_state import warnings_kept

JAX_SETTINGS: dict[str, Any] = {
    "enable_x64": False,
    "numpy_dtype_promotion": "standard",
    "disable_jit": False,
    "transfer_guard": "allow",
    "check_tracer_leaks": False,
    "debug_nans": False,
    "debug_infs": False,
    "debug_key_reuse": False,
    "default_prng_impl": "threefry2x32",
    "default_matmul_precision": None,
}
"""JAX's settings in a computation, by the name of their context manager: single precision, and what
JAX has by default. Its checks for NaN are off, because a search passes through places that have
none of its finite values."""
NUMPY_ERRORS: dict[str, Any] = {
    "divide": "warn", "over": "warn", "under": "ignore", "invalid": "warn",
}  # fmt: skip
"""NumPy's reports of errors in a computation: its defaults."""
# Whether a computation has run in this process, and whether JAX ran in the one it was forked from.
_started = False
_forked = False


def _after_fork() -> None:
    global _forked
    bridge = sys.modules.get("jax._src.xla_bridge")
    # Not a public function: without it, any computation counts.
    runs = getattr(bridge, "backends_are_initialized", lambda: _started)
    _forked = _forked or runs()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


@contextmanager
def as_guest(*, any_precision: bool = False) -> Generator[None]:
    """A computation inside has settings of its own, and the caller's are back afterwards. Any
    number of threads may enter at a time. With ``any_precision`` the caller's precision stays.

    Raises InputError in a process that was forked after JAX had started: JAX's threads do not
    survive a fork, and the first computation would wait for them forever.
    """
    global _started
    if _forked:
        raise InputError(
            "fork: expected a new process, got one forked after JAX had started its threads; "
            "start it by spawn, as in multiprocessing.get_context('spawn')"
        )
    _started = True
    with warnings_kept(), own_settings(any_precision=any_precision):
        yield


@contextmanager
def own_settings(*, any_precision: bool = False) -> Generator[None]:
    """JAX's and NumPy's settings of this thread are those of a computation inside. With
    ``any_precision`` that of the caller stays."""
    with ExitStack() as stack:
        for name, value in JAX_SETTINGS.items():
            setting = getattr(jax, name, None)
            if setting is not None and not (any_precision and name == "enable_x64"):
                stack.enter_context(setting(value))
        stack.enter_context(np.errstate(**NUMPY_ERRORS))
        yield

"""Linear algebra on one thread.

A fit's matrices are tall and thin: OpenBLAS needs longer to distribute one over its threads than to
factor it on one. BLAS threads also wait for each other where another program, or another thread of
this one, occupies a core. A QR of 9,216 x 12 values took 112 ms on two threads and 1.6 ms on one.
Seventeen shadow searches, started by two threads, took 1.9 s, and 0.8 s with one BLAS thread.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Generator
from contextlib import contextmanager

from threadpoolctl import ThreadpoolController

# The thread count belongs to the process, not to a thread. So entries are counted, and only the
# last exit restores it: an earlier one would change the count for those still inside, and a
# restore of a count that was saved inside would leave the process with one thread.
_lock = threading.Lock()
_entered = 0
_limit = None


@contextmanager
def one_thread() -> Generator[None]:
    """LAPACK and BLAS use one thread inside; any number of threads may enter at a time."""
    global _entered, _limit
    with _lock:
        if _entered == 0:
            _limit = _libraries().limit(limits=1, user_api="blas")
        _entered += 1
    try:
        yield
    finally:
        with _lock:
            _entered -= 1
            if _entered == 0 and _limit is not None:
                _limit.restore_original_limits()


@functools.cache
def _libraries() -> ThreadpoolController:
    # JAX loads scipy's LAPACK only at its first decomposition; the controller lists only libraries
    # that are loaded.
    import scipy.linalg  # noqa: F401

    return ThreadpoolController()

"""Linear algebra on one thread.

A fit's matrices are tall and thin, and OpenBLAS's threads take longer to share one than it takes.
Where another program, or another thread of this one, has one of the cores they wait for each other
on top of that: 112 ms for a QR of 9,216 x 12 values on two threads, 1.6 on one; 1.9 s for seventeen
of a search's questions about shadows, asked by two threads, and .8 where BLAS has one.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Generator
from contextlib import contextmanager

from threadpoolctl import ThreadpoolController

# How many are inside, and what restores the threads when the last has left: the number is the
# process's, and whoever left first would leave the others with many, or everybody with one.
_lock = threading.Lock()
_inside = 0
_limited = None


@contextmanager
def one_thread() -> Generator[None]:
    """LAPACK and BLAS use one thread within; from any number of threads at a time."""
    global _inside, _limited
    with _lock:
        if _inside == 0:
            _limited = _libraries().limit(limits=1, user_api="blas")
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0 and _limited is not None:
                _limited.restore_original_limits()


@functools.cache
def _libraries() -> ThreadpoolController:
    # JAX loads it, for its LAPACK, only when something is decomposed.
    import scipy.linalg  # noqa: F401

    return ThreadpoolController()

"""State of the whole process that packages change, and that is the host program's afterwards."""

from __future__ import annotations

import os
import threading
import warnings
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

WARNING_STATE = ("filters", "showwarning", "_showwarnmsg_impl")
"""Attributes of ``warnings`` that ``warnings.catch_warnings`` restores."""

# As in ``blas.one_thread``, the process's state is saved at the first entry and restored at the
# last exit.
_lock = threading.Lock()
_entered = 0
_saved: dict[str, Any] = {}


@contextmanager
def imports_kept() -> Generator[None]:
    """What packages set in the environment and in the filters of warnings as they are imported is
    undone: scipy adds filters, and threadpoolctl a variable for OpenMP."""
    environment, filters = dict(os.environ), list(warnings.filters)
    try:
        yield
    finally:
        for name in set(os.environ) - set(environment):
            del os.environ[name]
        os.environ.update({n: v for n, v in environment.items() if os.environ.get(n) != v})
        if list(warnings.filters) != filters:
            # The same list: whoever holds it has it as it was.
            warnings.filters[:] = filters  # pyright: ignore[reportIndexIssue]
            _filters_changed()


@contextmanager
def warnings_kept() -> Generator[None]:
    """The filters of warnings, and what shows them, are the same objects afterwards as before, and
    what packages that are imported meanwhile add to the filters is taken out again."""
    global _entered
    with _lock:
        if _entered == 0:
            _saved.update({name: getattr(warnings, name, None) for name in WARNING_STATE})
            _saved["entries"] = list(warnings.filters)
        _entered += 1
    try:
        yield
    finally:
        with _lock:
            _entered -= 1
            if _entered == 0:
                _restore_warnings()


def _restore_warnings() -> None:
    changed = [n for n in WARNING_STATE if getattr(warnings, n, None) is not _saved[n]]
    for name in changed:
        setattr(warnings, name, _saved[name])
    added = list(warnings.filters) != _saved["entries"]
    if added:
        warnings.filters[:] = _saved["entries"]  # pyright: ignore[reportIndexIssue]
    if changed or added:
        _filters_changed()
    _saved.clear()


def _filters_changed() -> None:
    # Python keeps what it has decided of each line until its filters have changed.
    mutated = getattr(warnings, "_filters_mutated", None)
    if mutated is not None:
        mutated()


def _after_fork() -> None:
    global _lock, _entered
    # Another thread may have held it.
    _lock, _entered = threading.Lock(), 0


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)

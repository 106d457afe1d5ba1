"""An interrupt ends the program at once, with one line and without an exception.

An exception that arises while a native library is being loaded, or while its threads run, leaves
that library half set up: the process then ends in a segmentation fault. So SIGINT has a handler
from the start, which ends the process itself. This file imports nothing that takes time.
"""

from __future__ import annotations

import _imp
import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType

from godfit.runtime.files import remove_temporaries, written_files

SIGNALLED = 128
"""Exit status after a signal, less its number, as shells have it: 130 for SIGINT, 143 for
SIGTERM."""
INTERRUPTED = SIGNALLED + signal.SIGINT
"""Exit status after an interrupt."""
# What a command says of its state instead of the files written; None for the files.
_state: Callable[[], str] | None = None
SHOW_CURSOR = "\r\x1b[2K\x1b[?25h"
"""What a terminal needs where a spinner was: an empty line, and its cursor."""


def end_on_interrupt() -> None:
    """Let SIGINT end the process, and SIGTERM, by which a queue of jobs takes a machine back.
    Nothing changes where the parent has one ignored, and the system calls of native code go on
    after it."""
    if _imp.lock_held():
        # Python dropped an interrupt of its own start, and kept the lock of its imports: the first
        # import of another thread would wait for ever.
        _end(signal.SIGINT, None)
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _end)
            if hasattr(signal, "siginterrupt"):
                signal.siginterrupt(number, False)


def report_on_interrupt(state: Callable[[], str] | None) -> None:
    """After an interrupt ``state`` is printed in place of the files written; None ends that."""
    global _state
    _state = state


_requests: list[int] = []


def requested() -> bool:
    """Whether an interrupt asks a search that is under way for its best answer so far."""
    return bool(_requests)


@contextlib.contextmanager
def kept_for_later() -> Iterator[None]:
    """Within, the first interrupt only makes ``requested`` true; the next one ends the process."""

    def first(number: int, frame: FrameType | None) -> None:
        if _requests:
            _end(number, frame)
        _requests.append(number)

    _requests.clear()
    own = threading.current_thread() is threading.main_thread()
    if not own or signal.getsignal(signal.SIGINT) is not _end:
        # Another program's handler is left as it is, and only the main thread may set one.
        yield
        return
    signal.signal(signal.SIGINT, first)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, _end)


def interrupt_message() -> str:
    """What is printed after an interrupt."""
    return f"interrupted; {written_files() if _state is None else _state()}"


def _end(number: int, frame: FrameType | None) -> None:
    remove_temporaries()
    line = f"godfit: error: {interrupt_message()}\n"
    try:
        # Not ``print``: the interrupt may have come while the stream was in use.
        os.write(2, ((SHOW_CURSOR if os.isatty(2) else "") + line).encode(errors="replace"))
    except OSError:
        pass
    finally:
        os._exit(SIGNALLED + number)

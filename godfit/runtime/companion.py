"""A process that works beside a command and ends with it.

Python runs one thread at a time: what another thread imports or compiles delays the command. A
companion is another process of the same interpreter. It serves one function, ``request -> answer``,
which may do what needs no request before it asks for it.

Its input stays open as long as the command lives. When that ends, however it ends, the companion
reads the end of its input and ends as well.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable

from godfit.runtime.one_core import cores

TIMEOUT = 60.0
"""Seconds after which a companion is given up: each does the work of a few seconds."""
LENGTH_BYTES = 8
"""Bytes of the length that precedes a request."""

Served = Callable[[Callable[[], bytes]], bytes]
"""What a companion serves: from a function that waits for the request to the answer."""


class Companion:
    """A companion process."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self.process = process

    @staticmethod
    def start(place: str) -> Companion | None:
        """A companion that serves the function at ``place``, "module:name"; None where it would
        have no core of its own."""
        if cores() < 2 or not sys.executable:
            return None
        # A short process makes no garbage worth looking for: that takes a tenth of its time.
        program = f"import gc; gc.disable(); from {__name__} import serve; serve({place!r})"
        try:
            # In a session of its own: an interrupt is the command's to answer. -P: the current
            # folder may hold a file with the name of any module.
            process = subprocess.Popen(
                [sys.executable, "-P", "-c", program],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
        except OSError:
            return None
        return Companion(process)

    def send(self, request: bytes) -> None:
        """Send the request. A companion that has ended gets none, and gives no answer."""
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):
            self.process.stdin.write(len(request).to_bytes(LENGTH_BYTES, "little") + request)
            self.process.stdin.flush()

    def answer(self) -> bytes | None:
        """The answer to the request, once there is one; None where the companion fails."""
        process = self.process
        assert process.stdin is not None
        assert process.stdout is not None
        end = threading.Timer(TIMEOUT, process.kill)
        end.daemon = True
        end.start()
        with process:
            content = process.stdout.read()
            with contextlib.suppress(OSError):
                # One that has ended leaves a part of the request unread.
                process.stdin.close()
        end.cancel()
        return content if process.returncode == 0 else None


def serve(place: str) -> None:
    """What a companion does: it serves one request and ends."""
    requests: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(requests,), daemon=True).start()
    module, _, name = place.partition(":")
    served: Served = getattr(importlib.import_module(module), name)
    sys.stdout.buffer.write(served(requests.get))
    sys.stdout.buffer.flush()
    # Without the end of an interpreter, which takes a tenth of a second.
    os._exit(0)


def _read(requests: queue.SimpleQueue[bytes]) -> None:
    while len(length := sys.stdin.buffer.read(LENGTH_BYTES)) == LENGTH_BYTES:
        requests.put(sys.stdin.buffer.read(int.from_bytes(length, "little")))
    os._exit(1)

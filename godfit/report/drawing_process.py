"""A process that draws a command's figure, beside the one that fits.

To import matplotlib and to draw take a quarter of a short command. Both hold the interpreter's
lock, so that on a thread of its own they would delay the fit. The process starts with the command
and imports matplotlib while JAX is imported. It gets the sheet once there is one, and it ends with
its input: when the command is over, however that ends.
"""

from __future__ import annotations

import contextlib
import pickle
import subprocess
import sys

from godfit.report.sheet import Sheet
from godfit.report.style import own_style
from godfit.runtime.one_core import cores

TIMEOUT = 60.0
"""Seconds after which a figure is drawn without the process: drawing takes a fraction of one."""
PROGRAM = "from godfit.report.drawing_process import serve; serve()"

_process: subprocess.Popen[bytes] | None = None


def start() -> None:
    """Start the process, where it has a core of its own and matplotlib is still to be imported."""
    global _process
    if cores() < 2 or not sys.executable or "matplotlib.figure" in sys.modules:
        return
    with contextlib.suppress(OSError):
        # In a session of its own: an interrupt is the command's to answer. -P: the current folder
        # may hold a file with the name of any module.
        _process = subprocess.Popen(
            [sys.executable, "-P", "-c", PROGRAM],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )


def is_running() -> bool:
    """Whether a process was started that has drawn nothing yet."""
    return _process is not None


def png(sheet: Sheet) -> bytes:
    """The sheet as a PNG file: from the process, or drawn here where there is none, or where it
    fails."""
    global _process
    process, _process = _process, None
    if process is not None:
        # pickle raises three kinds of errors for what it cannot send.
        unsent = pickle.PicklingError, AttributeError, TypeError
        with process, contextlib.suppress(OSError, subprocess.TimeoutExpired, *unsent):
            try:
                drawn, _ = process.communicate(pickle.dumps(sheet), TIMEOUT)
            finally:
                process.kill()
            if process.returncode == 0:
                return drawn
    with own_style():
        return sheet.png()


def serve() -> None:
    """What the process does: it draws one sheet from its input to its output."""
    import matplotlib.backends.backend_agg
    import matplotlib.figure  # noqa: F401

    sheet = pickle.load(sys.stdin.buffer)
    with own_style():
        sys.stdout.buffer.write(sheet.png())

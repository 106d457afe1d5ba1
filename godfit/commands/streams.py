"""The output of the command line: it outlives a reader that goes away, and any name of a file."""

from __future__ import annotations

import codecs
import errno
import io
import logging
import os
import sys

LOGGERS = ("imagecodecs", "tifffile", "trimesh")
"""Loggers of packages whose readers report what a fit's own checks and messages cover."""


class Output(io.TextIOWrapper):
    """Text to a descriptor that may fail. After a failure, further text is dropped.

    Names of files that are not UTF-8 are written with their bytes escaped. ``failure`` is the
    error, or None: a reader that has closed its pipe had all that it wanted.
    """

    failure: OSError | None = None

    def write(self, text: str) -> int:
        try:
            return super().write(text)
        except OSError as error:
            self._drop(error)
            return len(text)

    def flush(self) -> None:
        try:
            super().flush()
        except OSError as error:
            self._drop(error)

    def _drop(self, error: OSError) -> None:
        if error.errno != errno.EPIPE:
            self.failure = error
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, self.fileno())
        os.close(null)


def open_streams() -> None:
    """Make stdout an ``Output``, and keep the loggers of readers quiet. Descriptors 0 to 2 that
    were closed are opened on the null device, so that no other file gets their numbers."""
    for reader in LOGGERS:
        logging.getLogger(reader).setLevel(logging.CRITICAL)
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    if sys.stdout is None:
        sys.stdout = os.fdopen(1, "w", closefd=False)
    elif isinstance(sys.stdout, io.TextIOWrapper):
        lines, encoding = sys.stdout.line_buffering, sys.stdout.encoding
        if codecs.lookup(encoding).name == "ascii":
            # click would wrap it into another stream: Python has ASCII where no locale is set.
            encoding = "utf-8"
        sys.stdout = Output(
            sys.stdout.detach(),
            encoding=encoding,
            errors="backslashreplace",
            line_buffering=lines,
        )
    if sys.stderr is None:
        sys.stderr = os.fdopen(2, "w", closefd=False)


def close_streams(status: int) -> int:
    """Flush stdout and stderr; returns the exit status: 1 where stdout could not be written."""
    sys.stdout.flush()
    failure = getattr(sys.stdout, "failure", None)
    if failure is not None:
        print(
            f"godfit: error: stdout: {failure.strerror}; the printed result is not whole",
            file=sys.stderr,
        )
        status = status or 1
    sys.stderr.flush()
    return status

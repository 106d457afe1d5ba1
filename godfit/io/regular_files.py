"""Files of the user, opened with care: a name may belong to a device, a pipe or a huge file."""

from __future__ import annotations

import os
import stat

from godfit.errors import InputError

MAX_TEXT_BYTES = 64 << 20
"""Largest file of TOML or JSON, in bytes: such files are written by hand or hold a few numbers."""
MAX_BINARY_BYTES = 8 << 30
"""Largest file of a picture or a mesh, in bytes: twice a whole image of floats."""


def read_regular(
    path: str | os.PathLike[str], expected: str, most: int = MAX_BINARY_BYTES
) -> bytes:
    """The bytes of a regular file of at most ``most`` bytes.

    Raises InputError, naming the path and what was ``expected``, for anything else: reading from a
    device may never end, and opening a pipe may wait for ever.
    """
    name = os.fsdecode(path)
    try:
        found = os.stat(name)
        if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
            raise InputError(
                f"{name!r}: expected {expected}, got a device or a pipe; copy it to a file"
            )
        if found.st_size > most:
            raise InputError(
                f"{name!r}: expected {expected} of at most {most >> 20:,} MiB, got "
                f"{found.st_size >> 20:,} MiB"
            )
        with open(name, "rb") as file:
            return file.read()
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        if isinstance(error, InputError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{name!r}: cannot be read ({reason}); expected {expected}") from error

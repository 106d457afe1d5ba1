"""Files that are written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import secrets


def atomic_write(path: str | os.PathLike[str], data: bytes) -> None:
    """Write all of ``data`` to ``path``, or leave ``path`` unchanged. Raises OSError.

    The file is a new one with the umask's permissions, even where it replaces an old one.
    """
    name = os.fsdecode(path)
    temporary = os.path.join(os.path.dirname(name), f".{secrets.token_hex(8)}.tmp")
    try:
        with open(temporary, "xb") as file:  # not tempfile, which ignores the umask
            file.write(data)
            file.flush()
            os.fsync(file.fileno())  # the name must not reach the disk before the bytes
        os.replace(temporary, name)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        raise

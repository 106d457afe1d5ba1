"""Files of the cache: written whole, and read only where their checksum holds.

A file begins with ``MAGIC`` and the SHA-256 of its name and content; the content follows. The
checksum finds damage: a flipped bit, a cut or empty file, a file under another's name. It does not
stop a person who can write the folder and compute a checksum, so ``godfit.runtime.cache`` uses no
folder that anyone else can write. A secret key would add nothing: it would lie beside the files.
"""

from __future__ import annotations

import contextlib
import hashlib
from pathlib import Path

from godfit.runtime.files import atomic_write

MAGIC = b"godfit cache 1\n"
"""First bytes of a file of the cache."""
CHECKSUM_BYTES = hashlib.sha256().digest_size
"""Size of a checksum."""


def read_checked(path: Path) -> bytes | None:
    """The content of the file; None if there is none. A damaged file is removed, so that it is
    made again."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    start = len(MAGIC) + CHECKSUM_BYTES
    content = data[start:]
    if data[:start] == MAGIC + _checksum(path, content):
        return content
    discard(path)
    return None


def write_checked(path: Path, content: bytes) -> None:
    """Write the file whole, or not at all: a full or read-only disk costs the next run time."""
    with contextlib.suppress(OSError):
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        atomic_write(path, MAGIC + _checksum(path, content) + content, reported=False)


def discard(path: Path) -> None:
    """Remove a file of the cache, where that is possible."""
    with contextlib.suppress(OSError):
        path.unlink()


def _checksum(path: Path, content: bytes) -> bytes:
    checksum = hashlib.sha256(path.name.encode() + b"\0")
    checksum.update(content)
    return checksum.digest()

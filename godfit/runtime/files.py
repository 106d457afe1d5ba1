"""Files that are written whole or not at all, and which of them a command has written."""

from __future__ import annotations

import contextlib
import os

# Temporary files in use, each with the reported name that it may have got already; "" before that,
# and where the file is not reported.
_temporaries: dict[str, str] = {}
# Files that ``atomic_write`` has written since ``forget_written``.
_written: list[str] = []


def atomic_write(path: str | os.PathLike[str], data: bytes, *, reported: bool = True) -> None:
    """Write all of ``data`` to ``path``, or leave ``path`` unchanged. Raises OSError.

    The file is a new one with the umask's permissions, even where it replaces an old one. A file
    that the user did not request, as one of the cache, is not ``reported``.
    """
    name = os.fsdecode(path)
    temporary = os.path.join(os.path.dirname(name), f".{os.urandom(8).hex()}.tmp")
    _temporaries[temporary] = ""
    try:
        with open(temporary, "xb") as file:  # not tempfile, which ignores the umask
            file.write(data)
            file.flush()
            os.fsync(file.fileno())  # the name must not reach the disk before the bytes
        if reported:
            _temporaries[temporary] = name
        os.replace(temporary, name)
        if reported:
            _written.append(name)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        raise
    finally:
        del _temporaries[temporary]


def forget_written() -> None:
    """Begin the list of written files anew: another command starts."""
    _written.clear()


def written_files() -> str:
    """The files written since ``forget_written``, as errors name them."""
    return f"written: {', '.join(dict.fromkeys(_written))}" if _written else "nothing was written"


def remove_temporaries() -> None:
    """Remove the files that threads are still writing, before the process ends."""
    for temporary, name in list(_temporaries.items()):
        try:
            os.unlink(temporary)
        except OSError:
            if name and name not in _written:
                _written.append(name)

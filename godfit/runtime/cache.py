"""The cache folder of compiled programs: most of a first run is compilation.

What lies in the folder is run, so the folder belongs to the user alone: it has mode 0700, and one
that others may write is not used. Its files are read by ``godfit.runtime.checked_files``. Each kind
of program has a folder in it whose name ends with the time of the package's newest source file.
Folders of other times are removed when a new one is made.
"""

from __future__ import annotations

import functools
import os
import re
import shutil
import stat
import warnings
from pathlib import Path
from typing import Any

from godfit.runtime.checked_files import read_checked, write_checked

CACHE_VARIABLE = "GODFIT_CACHE"
"""Environment variable that names the cache folder; "off" disables every cache."""
JAX_MIN_COMPILE_SECONDS = 0.05
"""Programs that compile faster are not stored by JAX: reading a file takes as long."""
STORED_ELSEWHERE = "stored_"
"""How the name of a function begins whose program ``program_cache`` stores: JAX does not."""
_PRIVATE = 0o700
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_OLD = re.compile(r"(numba|jax|machine|programs)-[0-9a-f]+(-[0-9a-f]+)?|jit_.*-(cache|atime)")
"""Names that this version or an earlier one gives to what it stores."""

_warned: set[Path] = set()


def cache_folder() -> Path | None:
    """``$GODFIT_CACHE``, or "godfit" in the user's cache folder, created if it does not exist.

    None if the variable is "off", and if there is no such folder or it is not the user's alone.
    The folder may be read-only: what it holds is then used, and nothing is added. A relative path
    in ``$XDG_CACHE_HOME`` is ignored, as the XDG Base Directory Specification requires. A folder
    of ``$GODFIT_CACHE`` that is refused is warned of once.
    """
    chosen = os.environ.get(CACHE_VARIABLE)
    if chosen == "off":
        return None
    folder = Path(chosen) if chosen else _default_folder()
    if folder is None:
        return None
    if not folder.is_absolute():
        return _refused(
            folder, f"expected an absolute path in {CACHE_VARIABLE}, got '{folder}'; give one"
        )
    try:
        for missing in reversed([folder, *folder.parents]):
            if not missing.exists():
                missing.mkdir(_PRIVATE, exist_ok=True)
        found, link = folder.stat(), folder.lstat()
    except OSError:
        return None
    if not stat.S_ISDIR(found.st_mode):
        return None
    if not hasattr(os, "geteuid"):
        # Windows gives a user's folders to that user alone.
        return folder
    if {found.st_uid, link.st_uid} != {os.geteuid()}:
        return _refused(
            folder, f"'{folder}': expected a folder of your own, got another user's; remove it"
        )
    mode = stat.S_IMODE(found.st_mode)
    if not chosen and mode & ~_PRIVATE and not mode & _OTHERS_WRITE:
        # Earlier versions made it readable for others. No one else can have written to it.
        try:
            folder.chmod(mode & _PRIVATE)
        except OSError:
            return folder
        mode &= _PRIVATE
    if mode & ~_PRIVATE:
        return _refused(folder, f"'{folder}': expected mode 700, got {mode:o}; chmod 700 it")
    return folder


def _default_folder() -> Path | None:
    """ "godfit" in the user's cache folder; None for a user who has no home."""
    for variable in ("XDG_CACHE_HOME", "LOCALAPPDATA"):
        home = Path(os.environ.get(variable, ""))
        if home.is_absolute():
            return home / "godfit"
    try:
        home = Path.home()
    except RuntimeError:
        return None
    return home / ".cache" / "godfit" if home.is_absolute() else None


def _refused(folder: Path, reason: str) -> None:
    if folder not in _warned:
        _warned.add(folder)
        warnings.warn(
            f"cache: {reason}, or name another folder by {CACHE_VARIABLE}; until then programs are "
            "compiled in every run",
            RuntimeWarning,
            stacklevel=3,
        )


def version_folder(kind: str, environment: str = "") -> Path | None:
    """The folder of programs of a ``kind``, for this version and ``environment``; those of other
    versions are removed when it is made. None without a cache folder."""
    folder = cache_folder()
    if folder is None:
        return None
    version = f"{newest_source_time():x}"
    place = folder / f"{kind}-{version}{environment and '-'}{environment}"
    if not place.exists():
        try:
            place.mkdir(_PRIVATE, exist_ok=True)
            old = [
                path
                for path in folder.iterdir()
                if _OLD.fullmatch(path.name) and path.name.split("-")[1] != version
            ]
        except OSError:
            return place
        for path in old:
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
    return place


def enable_jax_cache() -> None:
    """Let JAX store compiled programs in the cache folder, if there is one.

    JAX's own store of files has no checksums, and a damaged executable ends the process. So JAX
    gets another, by an interface that is not public: where a version of JAX lacks it, its programs
    are compiled in every run.
    """
    place = version_folder("jax")
    if place is None:
        return
    import jax

    try:
        from jax._src import compilation_cache
        from jax._src.compilation_cache_interface import CacheInterface
    except ImportError:
        return

    class CheckedCache(CacheInterface):
        """Executables, compressed by JAX, as files of the cache."""

        _path = place

        def get(self, key: str) -> bytes | None:
            return None if _is_stored_elsewhere(key) else read_checked(place / key)

        def put(self, key: str, value: bytes) -> None:
            if not _is_stored_elsewhere(key):
                write_checked(place / key, value)

    if hasattr(compilation_cache, "_cache") and hasattr(compilation_cache, "_cache_initialized"):
        jax.config.update("jax_persistent_cache_min_compile_time_secs", JAX_MIN_COMPILE_SECONDS)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
        store: Any = compilation_cache
        store._cache, store._cache_initialized = CheckedCache(), True


def _is_stored_elsewhere(key: str) -> bool:
    return key.startswith(f"jit_{STORED_ELSEWHERE}")


@functools.cache
def newest_source_time() -> int:
    """Time of the last change to a source file of the package, in nanoseconds.

    It names the cache folders, because machine code depends on functions of other files that were
    inlined.
    """
    return max(file.stat().st_mtime_ns for file in Path(__file__).parents[1].rglob("*.py"))

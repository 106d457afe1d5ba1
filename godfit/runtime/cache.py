"""The cache folder of compiled programs: most of a first run is compilation."""

from __future__ import annotations

import functools
import os
import warnings
from pathlib import Path
from typing import Any

CACHE_VARIABLE = "GODFIT_CACHE"
"""Environment variable that names the cache folder; "off" disables every cache."""
JAX_MIN_COMPILE_SECONDS = 0.05
"""Programs that compile faster are not stored by JAX: reading a file takes as long."""


def cache_folder() -> Path | None:
    """``$GODFIT_CACHE``, or "godfit" in the user's cache folder, created if it does not exist.

    None if the variable is "off" or the folder cannot be written.
    """
    chosen = os.environ.get(CACHE_VARIABLE)
    if chosen == "off":
        return None
    home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    folder = Path(chosen) if chosen else Path(home or Path.home() / ".cache") / "godfit"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


def enable_jax_cache() -> None:
    """Let JAX store compiled programs in the cache folder, if there is one."""
    folder = cache_folder()
    if folder is None:
        return
    import jax

    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", JAX_MIN_COMPILE_SECONDS)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
    # JAX warns of an entry that another process has not finished writing, and of a full disk. It
    # compiles the program as if there were no cache, so the user need not act.
    warnings.filterwarnings("ignore", message=".*persistent compilation cache.*")


@functools.cache
def newest_source_time() -> int:
    """Time of the last change to a source file of the package, in nanoseconds.

    It names the cache folders, because numba checks only the file of a cached function: it would
    reuse machine code that inlined an old version of a function from another file.
    """
    return max(file.stat().st_mtime_ns for file in Path(__file__).parents[1].rglob("*.py"))


@functools.cache
def enable_numba_cache() -> bool:
    """Let numba store machine code beside JAX's programs; returns whether there is a folder."""
    folder = cache_folder()
    if folder is None:
        return False
    import numba.core.config

    config: Any = numba.core.config
    # A folder that the user has set by NUMBA_CACHE_DIR stays.
    if not config.CACHE_DIR:
        config.CACHE_DIR = str(folder / f"numba-{newest_source_time():x}")
    return True

"""Compiled programs are kept in the user's cache folder: most of a first run is compilation."""

from __future__ import annotations

import functools
import os
import warnings
from pathlib import Path
from typing import Any

SWITCH = "GODFIT_CACHE"


def cache_folder() -> Path | None:
    """``$GODFIT_CACHE``, or godfit's place in the user's cache folder, made if need be; None if it
    is "off" or cannot be written."""
    chosen = os.environ.get(SWITCH)
    if chosen == "off":
        return None
    home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    folder = Path(chosen) if chosen else Path(home or Path.home() / ".cache") / "godfit"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


def keep_compiled() -> None:
    """Have JAX keep compiled programs. Without a folder that can be written, nothing is kept."""
    folder = cache_folder()
    if folder is None:
        return
    import jax

    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.05)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
    # An entry that another process has not finished writing, or no room to write one: the program
    # is compiled as if there were no cache, which is no news to the user.
    warnings.filterwarnings("ignore", message=".*persistent compilation cache.*")


@functools.cache
def newest_source() -> int:
    """When a file of the program was last changed (ns): numba looks at a function's own file alone,
    and would keep using what it has taken in from others."""
    return max(file.stat().st_mtime_ns for file in Path(__file__).parents[1].rglob("*.py"))


@functools.cache
def numba_keeps() -> bool:
    """Have numba keep what it compiles, beside JAX's; whether it may."""
    folder = cache_folder()
    if folder is None:
        return False
    import numba.core.config

    config: Any = numba.core.config
    # Someone who has told numba where to keep things is right.
    if not config.CACHE_DIR:
        config.CACHE_DIR = str(folder / f"numba-{newest_source():x}")
    return True

"""Compiled programs are kept in the user's cache folder: most of a first run is compilation."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

SWITCH = "GODFIT_CACHE"


def cache_folder() -> Path | None:
    """``$GODFIT_CACHE``, or godfit's place in the user's cache folder; None if it is "off"."""
    chosen = os.environ.get(SWITCH)
    if chosen == "off":
        return None
    if chosen:
        return Path(chosen)
    home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return Path(home or Path.home() / ".cache") / "godfit"


def keep_compiled() -> None:
    """Have JAX keep compiled programs. Without a folder that can be written, nothing is kept."""
    folder = cache_folder()
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    if not os.access(folder, os.W_OK):
        return
    import jax

    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.05)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
    # An entry that another process has not finished writing, or no room to write one: the program
    # is compiled as if there were no cache, which is no news to the user.
    warnings.filterwarnings("ignore", message=".*persistent compilation cache.*")

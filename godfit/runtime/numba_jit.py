"""How numba compiles the package's functions: without the interpreter's lock, and stored as files
of the cache.

numba's own store keeps an index and machine code as plain pickles, in a folder that a file in the
current one may name, and two processes that write one index can exchange their functions. Here each
function and signature has one file, whose name says both. What this uses of numba is not public:
where a version of numba lacks it, functions are compiled in every run.
"""

from __future__ import annotations

import functools
import hashlib
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba import njit

from godfit.runtime.cache import version_folder
from godfit.runtime.checked_files import discard, read_checked, write_checked


def store_compiled(compiled: Any, function: Callable[..., Any]) -> None:
    """Let numba store and load the machine code of ``compiled``, a dispatcher or a C function that
    it made of ``function`` and has not compiled yet."""
    folder = _folder()
    if folder is not None and hasattr(compiled, "_cache"):
        compiled._cache = _FunctionCache(folder, function)


@functools.cache
def _folder() -> Path | None:
    """The folder of this version of numba, for the whole process."""
    return version_folder("numba", hashlib.sha256(numba.__version__.encode()).hexdigest()[:8])


class _FunctionCache:
    """What numba expects of a function's cache (numba.core.caching._Cache)."""

    def __init__(self, folder: Path, function: Callable[..., Any]) -> None:
        self.folder, self.function = folder, function
        self.cache_path = str(folder)

    def enable(self) -> None: ...

    def disable(self) -> None: ...

    def flush(self) -> None: ...

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function, or None where it has to be compiled."""
        path = None
        try:
            from numba.core.compiler import CompileResult

            target_context.refresh()
            path = self._path(sig, target_context.codegen())
            content = None if path is None else read_checked(path)
            if content is None:
                return None
            return CompileResult._rebuild(target_context, *pickle.loads(content))
        except Exception:
            if path is not None:
                discard(path)
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store a compiled function, where numba can load it again."""
        try:
            from numba.core.serialize import dumps

            path = self._path(sig, data.codegen)
            if path is None or any(not lifted.can_cache for lifted in data.lifted):
                return
            if not data.library.has_dynamic_globals:
                write_checked(path, dumps(data._reduce()))
        except Exception:
            # A version of numba that differs.
            return

    def _path(self, sig: Any, codegen: Any) -> Path | None:
        """The file of a signature; None where its text differs from run to run."""
        from numba.core.serialize import dumps

        function = self.function
        cells = tuple(cell.cell_contents for cell in function.__closure__ or ())
        key = repr((
            function.__module__, function.__qualname__, function.__code__.co_firstlineno,
            sig, codegen.magic_tuple(), function.__code__.co_code, dumps(cells),
        ))  # fmt: skip
        if " at 0x" in key:
            return None
        digest = hashlib.sha256(key.encode()).hexdigest()
        return self.folder / f"{function.__name__.strip('<>')}-{digest[:32]}.nbi"


def _stored_jit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """``njit`` whose machine code is stored in the cache folder."""

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher = njit(nogil=True, error_model="numpy", **options)(function)
        store_compiled(dispatcher, function)
        return dispatcher

    return compiled


jit = _stored_jit()
# For sums in which a multiplication and an addition may be fused, the sign of zero ignored and a
# division replaced by a multiplication with the reciprocal.
fast_jit = _stored_jit(fastmath={"contract", "nsz", "arcp"})
# For small functions, which are inlined before the caller is compiled and optimised with it.
inlined_jit = njit(inline="always")

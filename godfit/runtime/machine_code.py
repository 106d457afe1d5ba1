"""Machine code of custom calls on disk, which LLVM links without numba.

To import numba and to set up its compiler takes a sixth of a short command. A function that calls
nothing of numba's own is therefore stored once more, as the object file that LLVM made of it, with
the names that the file refers to. A later run hands the file to LLVM's linker, which looks these
names up among the functions of the process: those of the C library and of Python.

numba compiles into every function what it does with an exception: helpers of its own print it.
Functions that raise none never call these. Where numba is not there to provide them, ``abort`` of
the C library stands in their place.

A damaged file is removed, and numba's own store serves until the sources change.
"""

from __future__ import annotations

import functools
import hashlib
import json
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from godfit.runtime.cache import version_folder
from godfit.runtime.checked_files import discard, read_checked, write_checked

LIBRARY = {"free", "malloc", "memcpy", "memmove", "memset"}
"""Functions of the C library that stored code may call."""
PYTHON = "Py"
"""How the names of Python's functions begin."""
NEVER_CALLED = {
    "NRT_Free",
    "NRT_MemInfo_call_dtor",
    "numba_do_raise",
    "numba_gil_ensure",
    "numba_gil_release",
    "numba_runtime_build_excinfo_struct",
    "numba_unpickle",
}
"""Functions of numba's that code without exceptions and without arrays of its own never calls."""

_engines: list[Any] = []
"""What holds the linked code in memory, for as long as the process lives."""


@functools.cache
def processor() -> tuple[str, ...]:
    """numba's version and the processor that it compiles for, or what Python knows of it."""
    try:
        import llvmlite.binding as llvm

        features = llvm.get_host_cpu_features().flatten()
        return version("numba"), llvm.get_host_cpu_name(), features
    except (ImportError, PackageNotFoundError):
        return platform.machine(), platform.processor()


@functools.cache
def _folder() -> Path | None:
    key = repr((processor(), platform.python_version()))
    return version_folder("machine", hashlib.sha256(key.encode()).hexdigest()[:16])


def load_code(name: str) -> int | None:
    """The address of the custom call ``name`` in this process; None where an earlier run has stored
    none, or it refers to what is not there."""
    folder = _folder()
    content = None if folder is None else read_checked(folder / name)
    if folder is None or content is None:
        return None
    try:
        import llvmlite.binding as llvm

        head, _, code = content.partition(b"\n")
        symbol, names = json.loads(head)
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        machine = llvm.Target.from_default_triple().create_target_machine(jit=True)
        # With the first engine LLVM learns the names of the process.
        engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        abort = llvm.address_of_symbol("abort")
        for other in names:
            if llvm.address_of_symbol(other) is None and other in NEVER_CALLED:
                llvm.add_symbol(other, abort)
        # LLVM ends the process where a name is unknown.
        if not all(map(llvm.address_of_symbol, names)):
            return None
        engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        engine.finalize_object()
        address = engine.get_function_address(symbol)
    except Exception:
        discard(folder / name)
        return None
    _engines.append(engine)
    return address or None


def store_code(name: str, compiled: Any) -> None:
    """Store the machine code of ``compiled``, numba's C function, where it needs nothing of numba.
    What this uses of numba is not public: another version may lack it, and then nothing is
    stored."""
    folder = _folder()
    if folder is None:
        return
    try:
        library = compiled._library
        module = library._final_module
        declared = [*module.functions, *module.global_variables]
        names = {z.name for z in declared if z.is_declaration and not z.name.startswith("llvm.")}
        known = LIBRARY | NEVER_CALLED | {z for z in names if z.startswith(PYTHON)}
        if names - known:
            return
        head = json.dumps([compiled._wrapper_name, sorted(names)])
        code = library._get_compiled_object()
    except Exception:
        return
    write_checked(folder / name, head.encode() + b"\n" + code)

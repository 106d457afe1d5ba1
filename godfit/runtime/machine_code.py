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
import importlib
import json
import platform
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from godfit.runtime.cache import version_folder
from godfit.runtime.checked_files import discard, read_checked, write_checked
from godfit.runtime.companion import Companion

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
    """The address of the custom call ``name`` in this process: of what an earlier run has stored,
    or a companion of ``compile_ahead`` has compiled. None where neither is, or it refers to what is
    not there."""
    folder = _folder()
    content = None if folder is None else read_checked(folder / name)
    if content is not None and folder is not None:
        address = _linked(content)
        if address is None:
            discard(folder / name)
        return address
    content = _from_companion(name)
    address = None if content is None else _linked(content)
    if content is not None and address is not None and folder is not None:
        write_checked(folder / name, content)
    return address


def _linked(content: bytes) -> int | None:
    """The address of a stored function, linked into this process; None where that cannot be."""
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
        return None
    _engines.append(engine)
    return address or None


def compiled(name: str, place: str) -> Any:
    """numba's C function of the custom call ``name`` at ``place`` "module:name". Its machine code
    is stored for ``load_code``."""
    function = _compiled(place)
    content, folder = _content(function), _folder()
    if content is not None and folder is not None:
        write_checked(folder / name, content)
    return function


def _compiled(place: str) -> Any:
    from numba import cfunc

    from godfit.runtime.call_frame import FRAME_SIGNATURE
    from godfit.runtime.numba_jit import store_compiled

    module, _, own_name = place.partition(":")
    function = getattr(importlib.import_module(module), own_name)
    try:
        from numba.core.ccallback import CFunc
        from numba.core.sigutils import normalize_signature

        # ``cfunc`` compiles at once, before its cache could be replaced.
        made = CFunc(function, normalize_signature(FRAME_SIGNATURE), locals={}, options={})
        store_compiled(made, function)
    except Exception:
        return cfunc(FRAME_SIGNATURE)(function)
    made.compile()
    return made


def _content(function: Any) -> bytes | None:
    """What is stored of a C function of numba's; None where it needs more than there is without
    numba. What this uses of numba is not public: another version may lack it."""
    try:
        library = function._library
        module = library._final_module
        declared = [*module.functions, *module.global_variables]
        names = {z.name for z in declared if z.is_declaration and not z.name.startswith("llvm.")}
        known = LIBRARY | NEVER_CALLED | {z for z in names if z.startswith(PYTHON)}
        if names - known:
            return None
        head = json.dumps([function._wrapper_name, sorted(names)])
        return head.encode() + b"\n" + library._get_compiled_object()
    except Exception:
        return None


def compile_ahead(name: str, place: str) -> None:
    """Compile the custom call ``name`` at ``place`` in a companion process, for ``load_code``,
    where no earlier run has stored it."""
    folder = _folder()
    if folder is None or (folder / name).exists() or name in _companions:
        return
    # numba works under the interpreter's lock: on a thread, both it and the command would take half
    # as long again.
    companion = Companion.start(f"{__name__}:_content_for")
    if companion is not None:
        _companions[name] = companion
        companion.send(place.encode())


_companions: dict[str, Companion] = {}


def _from_companion(name: str) -> bytes | None:
    """What a companion process has compiled, once it has; None where there is none or it failed."""
    companion = _companions.pop(name, None)
    return None if companion is None else companion.answer() or None


def _content_for(request: Callable[[], bytes]) -> bytes:
    """What the companion does: it compiles the function at the place that it is asked for."""
    return _content(_compiled(request().decode())) or b""

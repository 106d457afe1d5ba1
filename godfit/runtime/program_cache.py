"""Compiled programs on disk, which a later run loads without tracing, lowering or compiling them.

JAX's own cache saves a second run the compilation, but not tracing the Python function and lowering
it to StableHLO, which is then a third of a short command. This cache stores the executable itself
(``jax.experimental.serialize_executable``).

**What is stored.** The folder ``programs-<time>-<hash>`` holds one file per program. The time is
that of this package's newest source file. The hash is that of everything else that all programs
depend on: the versions of JAX, numba and Python, the processor, the flags of XLA. A file's name is
a hash of what distinguishes one program from another: the function, the shapes and types of its
arrays, its settings. Its content is a pickle of three things: the names of the custom calls in the
program, the structure of its result, and the serialised executable. It is unpickled only where the
file's checksum holds (``godfit.runtime.checked_files``). A program that cannot be stored, or whose
file cannot be loaded, is compiled.

**What is read ahead.** Loading a program takes a twentieth of a second, on a thread that waits for
nothing but the file. Each command therefore saves a list of the program files it has used, under
its workload: the command's name, the image size and the settings, which determine the programs it
needs. The next command with this workload loads the files of the list on a thread of its own,
in the list's order, while the main thread reads images and meshes.

**Custom calls.** An executable refers to the functions that it calls by name, and XLA must have a
function registered under each name before the executable is loaded. JAX registers LAPACK's, and
``godfit.runtime.xla_ffi`` the package's own, only when a program that calls them is lowered. A
loaded program is never lowered, so the names that were stored with it are registered first.
"""

from __future__ import annotations

import functools
import hashlib
import os
import pickle
import re
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from godfit.runtime import xla_ffi
from godfit.runtime.cache import STORED_ELSEWHERE, version_folder
from godfit.runtime.checked_files import discard, read_checked, write_checked
from godfit.runtime.machine_code import processor

Program = Callable[..., Any]

CUSTOM_CALL = re.compile(r"custom_call @(\w+)")
"""A custom call in the text of a lowered program, with the name of its target."""
PROGRAM_NAME = re.compile("[0-9a-f]{64}")
"""The name of a program's file."""
LAPACK_PREFIX = "lapack_"
"""How the names of the custom calls begin that JAX registers for LAPACK."""
COMPILER_OPTIONS = {"xla_cpu_use_fusion_emitters": False}
"""XLA's newer emitter of fusions takes nearly twice as long to compile, and the programs that it
makes of this package's functions run no faster."""

# The folder of the program files; None while the cache is disabled.
_folder: Path | None = None
# The programs of this process, by function, settings and shapes, and a lock for each, so that two
# threads do not compile the same one.
_programs: dict[Any, Program] = {}
_locks: dict[Any, threading.Lock] = {}
# Programs that are being read ahead, by the name of their file; None is the result for a file that
# cannot be loaded.
_preloads: dict[str, Future[Program | None]] = {}
# Names of the files that this process has used, in order: a set, as dicts keep their order.
_used_files: dict[str, None] = {}
# The command, image size and settings of this process; empty before ``preload_programs``.
_workload = ""
_must_compile = False


def enable_program_cache() -> None:
    """Store and load programs from now on, if there is a cache folder and the device is a CPU."""
    global _folder
    if jax.default_backend() == "cpu":
        _folder = version_folder("programs", _environment_hash())


def disable_program_cache() -> None:
    """Store and load none from now on, and release the programs that are in memory."""
    global _folder, _workload, _must_compile
    _folder, _workload, _must_compile = None, "", False
    _programs.clear()
    _locks.clear()
    _preloads.clear()
    _used_files.clear()
    _jit.cache_clear()


def expect_programs(workload: str) -> None:
    """Note whether an earlier command had this ``workload``, for ``must_compile``."""
    global _must_compile
    _must_compile = _folder is not None and read_checked(_preload_list(_folder, workload)) is None


def must_compile() -> bool:
    """Whether this process is the first with its workload, and stores what it compiles."""
    return _must_compile


def preload_programs(workload: str) -> None:
    """Load the programs that the last command with this ``workload`` used, in its order.

    Returns when all are loaded, so call it in a thread of its own, after the modules are imported
    that define the custom calls.
    """
    global _workload
    folder, _workload = _folder, workload
    if folder is None:
        return
    # Nothing where no earlier command had this workload.
    names = (read_checked(_preload_list(folder, workload)) or b"").decode().split()
    futures = {name: Future() for name in names if PROGRAM_NAME.fullmatch(name)}
    _preloads.update(futures)
    for name, future in futures.items():
        # False where ``_stored_program`` has cancelled it to load the file itself.
        if future.set_running_or_notify_cancel():
            future.set_result(_load(folder / name))


def save_preload_list() -> None:
    """Save the names of the files used so far, for the next command with this workload.

    Cancels what has not been read ahead yet, and waits for the file that is being read.
    """
    wait([future for future in _preloads.values() if not future.cancel()])
    if _workload and _folder is not None and _used_files:
        file, names = _preload_list(_folder, _workload), "\n".join(_used_files).encode()
        if read_checked(file) != names:
            write_checked(file, names)


def _preload_list(folder: Path, workload: str) -> Path:
    return folder / ("needed-" + hashlib.sha256(workload.encode()).hexdigest()[:16])


class RunTime(int):
    """A whole number that compiled programs take at run time: one program serves every number.

    For Python it is an ``int``; inside a program of ``cached_jit`` it is traced.
    """


def _traceable(leaf: Any) -> Any:
    """A RunTime number as an array; any other leaf as it is."""
    return np.int32(leaf) if isinstance(leaf, RunTime) else leaf


def cached_jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """``jax.jit`` whose programs are stored on disk after ``enable_program_cache``.

    Arguments are arrays, pytrees of arrays, and settings. Every leaf that is neither an array nor a
    RunTime number is a setting, and static. Results are arrays, or pytrees of them. Inside another
    traced function it is a plain ``jax.jit``.
    """

    @functools.wraps(function)
    def call(*args: Any) -> Any:
        leaves, tree = jax.tree.flatten(args)
        leaves = [_traceable(leaf) for leaf in leaves]
        is_array = tuple(eqx.is_array(leaf) for leaf in leaves)
        arrays = [leaf for leaf, array in zip(leaves, is_array, strict=True) if array]
        # With their types: 1 equals True, and is another setting.
        settings = tuple(
            (type(leaf), leaf) for leaf, array in zip(leaves, is_array, strict=True) if not array
        )
        key = (function, tree, is_array, settings)
        if _folder is None or any(isinstance(leaf, Tracer) for leaf in arrays):
            return _jit(key)(*arrays)
        shapes = tuple((leaf.shape, leaf.dtype.str) for leaf in arrays)
        key = (*key, shapes, jax.dtypes.canonicalize_dtype(float).str)
        program = _programs.get(key)
        if program is None:
            with _locks.setdefault(key, threading.Lock()):
                program = _programs.get(key)
                if program is None:
                    _programs[key], result = _load_or_compile(_folder, key, arrays)
                    return result
        return program(*arrays)

    return call


def _function_of_arrays(key: tuple) -> Callable[..., Any]:
    """The function of ``key`` with its settings filled in, so that arrays are its arguments."""
    function, tree, is_array, settings, *_ = key

    def of_arrays(*arrays):
        next_array, next_setting = iter(arrays), (leaf for _, leaf in settings)
        leaves = [next(next_array) if array else next(next_setting) for array in is_array]
        return function(*jax.tree.unflatten(tree, leaves))

    of_arrays.__name__ = function.__name__
    return of_arrays


@functools.cache
def _jit(key: tuple) -> Callable[..., Any]:
    """The function of ``key`` as ``jax.jit`` compiles it, which is stored only in memory."""
    return jax.jit(_function_of_arrays(key))


def _load_or_compile(folder: Path, key: tuple, arrays: list[Any]) -> tuple[Program, Any]:
    """The program of ``key`` and its result for ``arrays``: from its file, or else compiled and
    stored there."""
    function, *rest = key
    name = repr((function.__module__, function.__qualname__, *rest))
    if " at 0x" in name:
        # A setting whose text holds its address has another name in every run.
        program = _jit(key)
        return program, program(*arrays)
    file = folder / hashlib.sha256(name.encode()).hexdigest()
    _used_files[file.name] = None
    stored = _stored_program(file, arrays)
    if stored is not None:
        return stored
    of_arrays, structures = _function_of_arrays(key), []

    def leaves(*arrays):
        result = of_arrays(*arrays)
        structures[:] = [jax.tree.map(lambda _: 0, result)]
        return jax.tree.leaves(result)

    # An executable that JAX has loaded from its own cache is serialised without some of its parts.
    # By this name JAX finds and stores none there.
    leaves.__name__ = STORED_ELSEWHERE + of_arrays.__name__
    with xla_ffi.registered_later():
        lowered = jax.jit(leaves).lower(*arrays)
    custom_calls = sorted(set(CUSTOM_CALL.findall(lowered.as_text())))
    # Every one, whether known or not: XLA compiles no call without its function.
    unknown = [name for name in custom_calls if not _register_custom_call(name)]
    executable = _compile(lowered)
    (structure,) = structures
    if not unknown:
        _store(file, executable, structure, custom_calls)
    program = _with_structure(executable, structure)
    return program, program(*arrays)


def _with_structure(executable: Program, structure: Any) -> Program:
    """``executable``, which returns leaves, with these leaves arranged as in ``structure``."""
    tree = jax.tree.structure(structure)
    return lambda *arrays: jax.tree.unflatten(tree, executable(*arrays))


def _compile(lowered: Any) -> Any:
    try:
        return lowered.compile(COMPILER_OPTIONS)
    except jax.errors.JaxRuntimeError:
        # A version of XLA without this option.
        return lowered.compile()


def _stored_program(file: Path, arrays: list[Any]) -> tuple[Program, Any] | None:
    """The program of ``file``, read ahead or loaded now, and its result for ``arrays``; None if
    there is none or it fails."""
    preload = _preloads.pop(file.name, None)
    # Waiting for the files before it in the list would take longer than loading this one now.
    program = _load(file) if preload is None or preload.cancel() else preload.result()
    try:
        # XLA reports some missing parts only when the program runs.
        return program and (program, jax.block_until_ready(program(*arrays)))
    except Exception:
        return None


def _load(file: Path) -> Program | None:
    """The program of ``file``; None if there is no such file, or it is damaged or incomplete, or
    one of its custom calls is unknown."""
    from jax.experimental.serialize_executable import deserialize_and_load

    content = read_checked(file)
    if content is None:
        return None
    try:
        custom_calls, structure, *executable = pickle.loads(content)
        if not all(map(_register_custom_call, custom_calls)):
            return None
        return _with_structure(deserialize_and_load(*executable), structure)
    except Exception:
        discard(file)
        return None


def _store(file: Path, executable: Any, structure: Any, custom_calls: list[str]) -> None:
    """Write the program's file whole, or no file where the program cannot be loaded again."""
    from jax.experimental.serialize_executable import serialize

    try:
        content = pickle.dumps((custom_calls, structure, *serialize(executable)))
    except Exception:
        # An executable that cannot be serialised: a later run compiles it again.
        return
    write_checked(file, content)


def _register_custom_call(name: str) -> bool:
    """Have the custom call of this name registered with XLA; False if no such one is known."""
    if name.startswith(LAPACK_PREFIX):
        _register_lapack()
        return True
    return xla_ffi.register(name)


@functools.cache
def _register_lapack() -> None:
    # JAX looks up LAPACK's functions in scipy when it lowers a program that calls one.
    try:
        from jaxlib.lapack import prepare_lapack_call

        prepare_lapack_call("geqrf_ffi", np.dtype(np.float32))
    except (ImportError, AttributeError):
        jax.jit(jnp.linalg.qr).lower(jax.ShapeDtypeStruct((1, 1), jnp.float32))


def _environment_hash() -> str:
    """A hash of everything but the package's sources that every program depends on."""
    flags = os.environ.get("XLA_FLAGS", "")
    versions = jax.__version__, version("jaxlib"), sys.version
    parts = (*versions, processor(), flags, jax.device_count())
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]

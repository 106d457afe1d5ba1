"""Programs kept whole from one run to the next: neither traced nor lowered nor compiled again.

JAX's own cache spares a second run the compiling. What it does not spare, tracing Python and
lowering what comes of it, is then a third of a short command. Here the executable itself is kept
(``jax.experimental.serialize_executable``), under a name that says all that it depends on: the
function, the shapes and settings that it was made for, this program's sources, the versions of JAX
and numba, the processor and the flags of XLA. Whatever cannot be kept, or read again, is compiled.

To read one takes a twentieth of a second, with nothing to wait for but the file: those that were
needed last time on a like occasion can be read before anybody asks for them.

An executable finds the functions that it calls by their names. Those of ``radial/foreign.py`` are
known to XLA, and LAPACK's to JAX, only when something that needs them has been lowered: here they
are made known first.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import pickle
import platform
import re
import secrets
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

from godfit.runtime.cache import cache_folder, newest_source
from godfit.runtime.files import atomic_write

CALLED = re.compile(r"custom_call @(\w+)")
LAPACK = "lapack_"
# XLA's newer emitter of fusions takes nearly twice as long to compile, and what it makes is no
# faster here.
QUICK = {"xla_cpu_use_fusion_emitters": False}

_folder: Path | None = None
_programs: dict[Any, Callable[..., Any]] = {}
_locks: dict[Any, threading.Lock] = {}
# By the names of their files: those that are read ahead, and those that were needed, in order.
_coming: dict[str, Future[Callable[..., Any] | None]] = {}
_needed: dict[str, None] = {}
_occasion = ""


def keep_programs() -> None:
    """From now on, where there is a cache folder and the device is a CPU."""
    global _folder
    folder = cache_folder()
    if folder is not None and jax.default_backend() == "cpu":
        _folder = folder / f"programs-{_surroundings()}"


def forget_programs() -> None:
    """Keep none from now on; those in memory are let go of."""
    global _folder, _occasion
    _folder, _occasion = None, ""
    _programs.clear()
    _locks.clear()
    _coming.clear()
    _needed.clear()
    _in_memory.cache_clear()


def read_ahead(occasion: str) -> None:
    """Read the programs that were needed on the last such occasion, in their order. For a thread of
    its own, once all is imported that programs call."""
    global _occasion
    folder, _occasion = _folder, occasion
    if folder is None:
        return
    try:
        names = _notes(folder).read_text().split()
    except OSError:
        # The first of its kind.
        return
    each = {name: Future() for name in names}
    _coming.update(each)
    for name, coming in each.items():
        if coming.set_running_or_notify_cancel():
            coming.set_result(_loaded(folder / name))


def remember() -> None:
    """Note what was needed so far for the next such occasion; nothing is read ahead any more."""
    wait([coming for coming in _coming.values() if not coming.cancel()])
    with contextlib.suppress(OSError):
        if _occasion and _folder is not None and _folder.is_dir():
            atomic_write(_notes(_folder), "\n".join(_needed).encode())


def _notes(folder: Path) -> Path:
    return folder / ("needed-" + hashlib.sha256(_occasion.encode()).hexdigest()[:16])


class RunTime(int):
    """A whole number that compiled programs take at run time: another one needs no other program.
    To Python it is an ``int``; inside a program it is traced."""


def _dynamic(leaf: Any) -> Any:
    """The array of what is taken at run time; anything else as it is."""
    return np.int32(leaf) if isinstance(leaf, RunTime) else leaf


def cached_jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """``jax.jit`` of a function of arrays, modules of them, and settings, which are all else; its
    results are arrays, in tuples and modules or not. Once ``keep_programs`` was called the program
    is kept."""

    @functools.wraps(function)
    def call(*args: Any) -> Any:
        leaves, tree = jax.tree.flatten(args)
        leaves = [_dynamic(leaf) for leaf in leaves]
        arrays = tuple(eqx.is_array(leaf) for leaf in leaves)
        dynamic = [leaf for leaf, is_one in zip(leaves, arrays, strict=True) if is_one]
        # With their types: 1 is True, and yet another setting.
        static = tuple(
            (type(leaf), leaf) for leaf, is_one in zip(leaves, arrays, strict=True) if not is_one
        )
        key = (function, tree, arrays, static)
        if _folder is None or any(isinstance(leaf, Tracer) for leaf in dynamic):
            return _in_memory(key)(*dynamic)
        shapes = tuple((leaf.shape, leaf.dtype.str) for leaf in dynamic)
        key = (*key, shapes, jax.dtypes.canonicalize_dtype(float).str)
        program = _programs.get(key)
        if program is None:
            with _locks.setdefault(key, threading.Lock()):
                program = _programs.get(key)
                if program is None:
                    _programs[key], result = _on_disk(_folder, key, dynamic)
                    return result
        return program(*dynamic)

    return call


def _flat(key: tuple) -> Callable[..., Any]:
    """The function of its arrays alone."""
    function, tree, arrays, static, *_ = key

    def flat(*dynamic):
        each, others = iter(dynamic), (leaf for _, leaf in static)
        leaves = [next(each) if is_one else next(others) for is_one in arrays]
        return function(*jax.tree.unflatten(tree, leaves))

    flat.__name__ = function.__name__
    return flat


@functools.cache
def _in_memory(key: tuple) -> Callable[..., Any]:
    """As JAX has it."""
    return jax.jit(_flat(key))


def _on_disk(folder: Path, key: tuple, dynamic: list[Any]) -> tuple[Callable[..., Any], Any]:
    """Read from its file, or compiled and written to it; and its result."""
    function, *rest = key
    name = repr((function.__module__, function.__qualname__, *rest))
    if " at 0x" in name:
        # Something that is called otherwise in every run.
        program = _in_memory(key)
        return program, program(*dynamic)
    file = folder / hashlib.sha256(name.encode()).hexdigest()
    _needed[file.name] = None
    found = _read(file, dynamic)
    if found is None:
        flat, made = _flat(key), []

        def leaves(*dynamic):
            result = flat(*dynamic)
            made[:] = [jax.tree.map(lambda _: 0, result)]
            return jax.tree.leaves(result)

        # An executable that JAX takes from its own cache is not whole when it is written once more:
        # by this name it has none.
        leaves.__name__ = flat.__name__ + secrets.token_hex(8)
        lowered = jax.jit(leaves).lower(*dynamic)
        program = _compiled(lowered)
        _write(file, program, made[0], sorted(set(CALLED.findall(lowered.as_text()))))
        program = _whole(program, made[0])
        found = program, program(*dynamic)
    return found


def _whole(program: Callable[..., Any], like: Any) -> Callable[..., Any]:
    """``program``, which gives leaves, with its results put together as they are in ``like``."""
    structure = jax.tree.structure(like)
    return lambda *dynamic: jax.tree.unflatten(structure, program(*dynamic))


def _compiled(lowered: Any) -> Any:
    try:
        return lowered.compile(QUICK)
    except jax.errors.JaxRuntimeError:
        # An XLA that knows no such option.
        return lowered.compile()


def _read(file: Path, dynamic: list[Any]) -> tuple[Callable[..., Any], Any] | None:
    coming = _coming.pop(file.name, None)
    program = _loaded(file) if coming is None or coming.cancel() else coming.result()
    try:
        # What is missing in it is missed when it runs.
        return program and (program, jax.block_until_ready(program(*dynamic)))
    except Exception:
        return None


def _loaded(file: Path) -> Callable[..., Any] | None:
    """The program of a file; None if there is none, or it is of another version, or half of one: it
    is made anew."""
    from jax.experimental.serialize_executable import deserialize_and_load

    try:
        called, like, *parts = pickle.loads(file.read_bytes())
        return _whole(deserialize_and_load(*parts), like) if all(map(_made_known, called)) else None
    except Exception:
        return None


def _write(file: Path, program: Any, like: Any, called: list[str]) -> None:
    """All of it or nothing, and nothing where it could not be used again."""
    from jax.experimental.serialize_executable import serialize

    try:
        if not all(map(_made_known, called)):
            return
        content = pickle.dumps((called, like, *serialize(program)))
        file.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(file, content)
    except Exception:
        # No room, or a program that cannot be taken out of memory: there will be none to read.
        return


def _made_known(name: str) -> bool:
    """Whether XLA knows the function of this name now."""
    if name.startswith(LAPACK):
        _find_lapack()
        return True
    foreign = sys.modules.get("godfit.runtime.xla_ffi")
    return foreign is not None and foreign.made_known(name)


@functools.cache
def _find_lapack() -> None:
    jax.jit(jnp.linalg.qr).lower(jax.ShapeDtypeStruct((1, 1), jnp.float32))


def _surroundings() -> str:
    """What every program depends on, in a word."""
    try:
        import llvmlite.binding as llvm
        import numba

        features = llvm.get_host_cpu_features().flatten()
        processor = numba.__version__, llvm.get_host_cpu_name(), features
    except ImportError:
        processor = platform.machine(), platform.processor()
    flags = os.environ.get("XLA_FLAGS", "")
    versions = jax.__version__, version("jaxlib"), sys.version
    parts = (*versions, processor, flags, jax.device_count(), newest_source())
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]

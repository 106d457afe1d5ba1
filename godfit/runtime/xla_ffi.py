"""Functions compiled by numba as XLA custom calls, so that they run inside ``jit`` without Python.

XLA calls a C function with one pointer, to a frame that lists buffers (the typed foreign function
interface, jaxlib/include/xla/ffi/api/c_api.h). ``numba.cfunc`` makes such functions, and what is
here reads the frame. Unlike with ``jax.pure_callback``, the interpreter's lock is not needed, calls
that do not depend on each other run at the same time on XLA's threads, and programs can be kept in
the compilation cache.

Offsets are in words of eight bytes. They are those of the interface's first version; fields are
only ever added at the ends of its structures.
"""

from __future__ import annotations

import threading
from typing import Any, NamedTuple

import jax
from numba import (
    carray,  # pyright: ignore[reportPrivateImportUsage]
    cfunc,
    types,
)
from numba.extending import intrinsic

from godfit.runtime.cache import numba_keeps
from godfit.runtime.numba_jit import inlined_jit

_WORDS = types.CPointer(types.int64)
_METADATA = 1
_EXTENSION, _API, _ARGUMENTS, _RESULTS = 1, 2, 9, 14
_DATA, _DIMENSIONS = 3, 5


def _cast(context, builder, signature, arguments):
    return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))


# Any: intrinsics are called without their first argument.
# An address (int64) and a kind of number, as in np.float32, -> a pointer to such numbers.
_pointer: Any = intrinsic(
    lambda _, address, kind: (types.CPointer(kind.dtype)(address, kind), _cast)
)
_words: Any = intrinsic(lambda _, address: (_WORDS(address), _cast))


@inlined_jit
def asks_version(frame):
    """Whether this is no call but a question for the version of the interface. The answer is the
    caller's own: nothing is used here that a version changes."""
    if frame[_EXTENSION] == 0:
        return False
    extension = _words(frame[_EXTENSION])
    if extension[1] & 0xFFFFFFFF != _METADATA:
        return False
    _words(extension[3])[3] = _words(frame[_API])[4]
    return True


@inlined_jit
def vector(frame, index, kind):
    """Argument ``index``, of rank 1, numbers of ``kind``."""
    buffer = _words(_words(frame[_ARGUMENTS])[index])
    size = _words(buffer[_DIMENSIONS])
    return carray(_pointer(buffer[_DATA], kind), (size[0],))


@inlined_jit
def matrix(frame, index, kind):
    """Argument ``index``, of rank 2."""
    buffer = _words(_words(frame[_ARGUMENTS])[index])
    size = _words(buffer[_DIMENSIONS])
    return carray(_pointer(buffer[_DATA], kind), (size[0], size[1]))


@inlined_jit
def result(frame, kind):
    """The first result, of rank 3."""
    buffer = _words(_words(frame[_RESULTS])[0])
    size = _words(buffer[_DIMENSIONS])
    return carray(_pointer(buffer[_DATA], kind), (size[0], size[1], size[2]))


class _Named(NamedTuple):
    """What was declared under a name, and whether XLA knows it."""

    function: Any
    lock: threading.Lock
    known: threading.Event


_declared: dict[str, _Named] = {}


def declare(prefix: str, functions: dict[Any, Any]) -> dict[Any, str]:
    """The names, each after the ``prefix``, under which XLA will know ``functions`` (frame -> 0).
    A name is the same in every run: a program that was kept asks for it."""
    names = {key: prefix + function.__name__ for key, function in functions.items()}
    for key, name in names.items():
        _declared[name] = _Named(functions[key], threading.Lock(), threading.Event())
    return names


def made_known(name: str) -> bool:
    """Whether something of this name was declared; it is compiled, or loaded, and made known to XLA
    on the CPU when it is first asked for. Nobody waits for others than that."""
    named = _declared.get(name)
    if named is None:
        return False
    with named.lock:
        if not named.known.is_set():
            _register(name, named.function)
            named.known.set()
    return True


def _register(name: str, function) -> None:
    compiled = cfunc(types.int64(_WORDS), cache=numba_keeps())(function)
    jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(compiled.ctypes), platform="cpu")

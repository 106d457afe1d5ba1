"""Functions compiled by numba as XLA custom calls, which run inside ``jit`` without Python.

XLA calls a C function with one pointer, to a call frame that lists buffers (the typed foreign
function interface, jaxlib/include/xla/ffi/api/c_api.h). ``numba.cfunc`` compiles such functions,
and this module reads the frame. Unlike ``jax.pure_callback``, a custom call does not need the
interpreter's lock, independent calls run at the same time on XLA's threads, and a program with
custom calls can be stored in the compilation cache.

Offsets are in words of eight bytes. They are those of the interface's first version; later versions
add fields only at the ends of its structures.
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

from godfit.runtime.numba_cache import store_compiled
from godfit.runtime.numba_jit import inlined_jit

_WORDS = types.CPointer(types.int64)
"""Type of a pointer to words of eight bytes."""

# Words of XLA_FFI_CallFrame. Arguments and results are arrays of pointers to buffers, which are the
# last words of the XLA_FFI_Args and XLA_FFI_Rets that the frame contains.
_FRAME_EXTENSION = 1
_FRAME_API = 2
_FRAME_ARGUMENTS = 9
_FRAME_RESULTS = 14

# Words of XLA_FFI_Buffer.
_BUFFER_DATA = 3
_BUFFER_DIMENSIONS = 5

# XLA queries the version by an extension of the type XLA_FFI_Extension_Metadata. These are its
# words, that of the version in XLA_FFI_Metadata, and that of XLA's own version in XLA_FFI_Api.
_METADATA_TYPE = 1
_EXTENSION_TYPE = 1
_EXTENSION_METADATA = 3
_METADATA_VERSION = 3
_API_VERSION = 4


def _cast(context, builder, signature, arguments):
    return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))


# Any: intrinsics are called without their first argument.
# From an address (int64) and a kind of number, as in np.float32, to a pointer to such numbers.
_pointer: Any = intrinsic(
    lambda _, address, kind: (types.CPointer(kind.dtype)(address, kind), _cast)
)
# From an address to a pointer to words.
_words: Any = intrinsic(lambda _, address: (_WORDS(address), _cast))


@inlined_jit
def answers_version_query(frame):
    """Whether ``frame`` is XLA's query for the interface's version, which this answers, and not a
    call.

    The answer is XLA's own version: this module uses nothing that differs between versions.
    """
    if frame[_FRAME_EXTENSION] == 0:
        return False
    extension = _words(frame[_FRAME_EXTENSION])
    # The type is an enum of four bytes.
    if extension[_EXTENSION_TYPE] & 0xFFFFFFFF != _METADATA_TYPE:
        return False
    version = _words(frame[_FRAME_API])[_API_VERSION]
    _words(extension[_EXTENSION_METADATA])[_METADATA_VERSION] = version
    return True


@inlined_jit
def vector(frame, index, kind):
    """Argument ``index`` of the call, an array (n,) of ``kind``, as in np.float32."""
    buffer = _words(_words(frame[_FRAME_ARGUMENTS])[index])
    size = _words(buffer[_BUFFER_DIMENSIONS])
    return carray(_pointer(buffer[_BUFFER_DATA], kind), (size[0],))


@inlined_jit
def matrix(frame, index, kind):
    """Argument ``index`` of the call, an array (m, n) of ``kind``."""
    buffer = _words(_words(frame[_FRAME_ARGUMENTS])[index])
    size = _words(buffer[_BUFFER_DIMENSIONS])
    return carray(_pointer(buffer[_BUFFER_DATA], kind), (size[0], size[1]))


@inlined_jit
def result(frame, kind):
    """The call's first result, an array (k, m, n) of ``kind`` to write to."""
    buffer = _words(_words(frame[_FRAME_RESULTS])[0])
    size = _words(buffer[_BUFFER_DIMENSIONS])
    return carray(_pointer(buffer[_BUFFER_DATA], kind), (size[0], size[1], size[2]))


class _Target(NamedTuple):
    """A declared custom call: its function, and whether it is registered with XLA."""

    function: Any
    lock: threading.Lock
    registered: threading.Event


_declared: dict[str, _Target] = {}


def declare(prefix: str, functions: dict[Any, Any]) -> dict[Any, str]:
    """Declare ``functions`` (frame -> 0) as custom calls, without compiling them; returns their
    names, ``prefix`` + function's name, by the same keys.

    A name is the same in every run, because stored programs refer to their custom calls by it.
    """
    names = {key: prefix + function.__name__ for key, function in functions.items()}
    for key, name in names.items():
        _declared[name] = _Target(functions[key], threading.Lock(), threading.Event())
    return names


def _compiled(function: Any) -> Any:
    """The C function of ``function``, compiled, or loaded from the cache where numba allows it."""
    signature = types.int64(_WORDS)
    try:
        from numba.core.ccallback import CFunc
        from numba.core.sigutils import normalize_signature

        # ``cfunc`` compiles at once, before its cache could be replaced.
        compiled = CFunc(function, normalize_signature(signature), locals={}, options={})
        store_compiled(compiled, function)
    except Exception:
        return cfunc(signature)(function)
    compiled.compile()
    return compiled


def register(name: str) -> bool:
    """Register the custom call of this name with XLA on the CPU; False if none was declared.

    The function is compiled, or loaded from the cache, at the first registration. The lock is
    one per name, so that no thread waits for a function other than its own.
    """
    target = _declared.get(name)
    if target is None:
        return False
    with target.lock:
        if not target.registered.is_set():
            compiled = _compiled(target.function)
            jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(compiled.ctypes), platform="cpu")
            target.registered.set()
    return True


def call(name: str, result: jax.ShapeDtypeStruct, *arguments: jax.Array, ranks: str) -> jax.Array:
    """The result of the custom call ``name``, whose float arrays are all of the result's type.

    A compiled function reads its buffers as what it was written for, whatever they are. An array of
    another type or rank would be read beyond its end: ``ranks`` has a digit for each argument.
    Raises TypeError. The lengths are the caller's to match.
    """
    if result.dtype not in (jax.numpy.float32, jax.numpy.float64):
        raise TypeError(
            f"{name}: expected float32 or float64, got {result.dtype}; convert the mask"
        )
    kinds = (result.dtype, jax.numpy.dtype("int32"))
    for place, (argument, rank) in enumerate(zip(arguments, ranks, strict=True)):
        if argument.dtype not in kinds or argument.ndim != int(rank):
            raise TypeError(
                f"{name}: expected argument {place} of {rank} axes in {result.dtype} or int32, got "
                f"{argument.ndim} in {argument.dtype}"
            )
    register(name)
    return _without_derivative(name, result)(*arguments)


def _without_derivative(name: str, result: jax.ShapeDtypeStruct) -> Any:
    """The custom call, which says what to do where its derivative is needed."""

    @jax.custom_jvp
    def compiled(*arguments):
        return jax.ffi.ffi_call(name, result, vmap_method="sequential")(*arguments)

    @compiled.defjvp
    def refuse(primals, tangents):
        raise TypeError(
            f"{name}: expected a value or a first derivative, got a second one (jax.hessian, or "
            "jax.grad of a gradient); give method='reference' to the model or to radial_sum"
        )

    return compiled

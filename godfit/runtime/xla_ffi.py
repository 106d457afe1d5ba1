"""Functions compiled by numba as XLA custom calls, which run inside ``jit`` without Python.

Unlike ``jax.pure_callback``, a custom call does not need the interpreter's lock, independent calls
run at the same time on XLA's threads, and a program with custom calls can be stored in the
compilation cache. ``call_frame.py`` has what these functions are written with.

The module of a function, and numba, are imported where it has to be compiled. What an earlier run
has compiled is loaded without them where ``machine_code.py`` can.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, NamedTuple

import jax

from godfit.runtime import machine_code

_CALL = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)
"""Type of a function that XLA calls."""


class _Target(NamedTuple):
    """A declared custom call: where its function is, as "module:name", and whether it is registered
    with XLA."""

    place: str
    lock: threading.Lock
    registered: threading.Event


_declared: dict[str, _Target] = {}


def declare(prefix: str, places: Mapping[Any, str]) -> dict[Any, str]:
    """Declare functions (frame -> 0), at ``places`` "module:name", as custom calls, without
    importing them; returns their names, ``prefix`` + function's name, by the same keys.

    A name is the same in every run, because stored programs refer to their custom calls by it.
    """
    names = {key: prefix + place.partition(":")[2] for key, place in places.items()}
    for key, name in names.items():
        _declared[name] = _Target(places[key], threading.Lock(), threading.Event())
    return names


_later: ContextVar[bool] = ContextVar("later", default=False)


@contextmanager
def registered_later() -> Iterator[None]:
    """Programs can be lowered in here while another thread compiles the functions that they call.
    Whoever compiles such a program registers these before."""
    token = _later.set(True)
    try:
        yield
    finally:
        _later.reset(token)


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
            address = machine_code.load_code(name)
            if address is None:
                function = machine_code.compiled(name, target.place).ctypes
            else:
                function = _CALL(address)
            jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(function), platform="cpu")
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
    if not _later.get():
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

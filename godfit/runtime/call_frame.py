"""The call frame of XLA's foreign function interface, read in functions that numba compiles.

XLA calls a C function with one pointer, to a call frame that lists buffers (the typed foreign
function interface, jaxlib/include/xla/ffi/api/c_api.h). ``numba.cfunc`` compiles such functions,
and this module reads the frame.

Offsets are in words of eight bytes. They are those of the interface's first version; later versions
add fields only at the ends of its structures.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import (
    carray,  # pyright: ignore[reportPrivateImportUsage]
    types,
)
from numba.extending import intrinsic

from godfit.runtime.numba_jit import inlined_jit

FRAME_SIGNATURE = types.int64(types.int64)
"""Type of a function that XLA calls: from the address of a frame to 0."""

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


def _read_word(context, builder, signature, arguments):
    words = builder.inttoptr(arguments[0], context.get_value_type(_WORDS))
    return builder.load(builder.gep(words, [arguments[1]]))


def _write_word(context, builder, signature, arguments):
    words = builder.inttoptr(arguments[0], context.get_value_type(_WORDS))
    builder.store(arguments[2], builder.gep(words, [arguments[1]]))
    return context.get_dummy_value()


_WORDS = types.CPointer(types.int64)
"""Type of a pointer to words of eight bytes."""
# Any: intrinsics are called without their first argument.
pointer: Any = intrinsic(
    lambda _, address, kind: (types.CPointer(kind.dtype)(address, kind), _cast)
)
"""From an address (int64) and a kind of number, as in np.float32, to a pointer to such numbers.
Reads and writes through it take numba a fraction of the time that an array takes to compile."""
# From an address and an index to the word there.
_word: Any = intrinsic(
    lambda _, address, index: (types.int64(types.int64, types.int64), _read_word)
)
# The same, and a word that is written there.
_set_word: Any = intrinsic(
    lambda _, address, index, word: (types.void(types.int64, types.int64, types.int64), _write_word)
)

# From the C library and not numba's: code that needs nothing of numba is loaded without it, see
# ``machine_code.py``.
_malloc = types.ExternalFunction("malloc", types.int64(types.uint64))
_free = types.ExternalFunction("free", types.void(types.int64))


@inlined_jit
def allocate(size):
    """Address of ``size`` bytes, for ``release``; 0 where there is no memory."""
    return _malloc(np.uint64(size))


@inlined_jit
def release(address):
    """Free what ``allocate`` returned."""
    _free(address)


@inlined_jit
def answers_version_query(frame):
    """Whether ``frame`` is XLA's query for the interface's version, which this answers, and not a
    call.

    The answer is XLA's own version: this module uses nothing that differs between versions.
    """
    extension = _word(frame, _FRAME_EXTENSION)
    if extension == 0:
        return False
    # The type is an enum of four bytes.
    if _word(extension, _EXTENSION_TYPE) & 0xFFFFFFFF != _METADATA_TYPE:
        return False
    version = _word(_word(frame, _FRAME_API), _API_VERSION)
    _set_word(_word(extension, _EXTENSION_METADATA), _METADATA_VERSION, version)
    return True


@inlined_jit
def argument(frame, index):
    """The buffer of argument ``index`` of the call, for ``data`` and ``length``."""
    return _word(_word(frame, _FRAME_ARGUMENTS), index)


@inlined_jit
def first_result(frame):
    """The buffer of the call's first result."""
    return _word(_word(frame, _FRAME_RESULTS), 0)


@inlined_jit
def data(buffer):
    """The address of a buffer's numbers."""
    return _word(buffer, _BUFFER_DATA)


@inlined_jit
def length(buffer, axis):
    """The length of a buffer along an axis."""
    return _word(_word(buffer, _BUFFER_DIMENSIONS), axis)


@inlined_jit
def vector(frame, index, kind):
    """Argument ``index`` of the call, an array (n,) of ``kind``, as in np.float32."""
    buffer = argument(frame, index)
    return carray(pointer(data(buffer), kind), (length(buffer, 0),))


@inlined_jit
def matrix(frame, index, kind):
    """Argument ``index`` of the call, an array (m, n) of ``kind``."""
    buffer = argument(frame, index)
    return carray(pointer(data(buffer), kind), (length(buffer, 0), length(buffer, 1)))


@inlined_jit
def result(frame, kind):
    """The call's first result, an array (k, m, n) of ``kind`` to write to."""
    buffer = first_result(frame)
    size = length(buffer, 0), length(buffer, 1), length(buffer, 2)
    return carray(pointer(data(buffer), kind), size)

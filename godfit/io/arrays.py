"""Arrays as users have them -> floats from 0 to 1, by what their numbers mean.

Integers are levels, as in a file: bytes up to 255, words up to 65535. Floats are linear light, 1.0
the brightest level. Booleans are 0 and 1.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from godfit.errors import InputError

BYTE, WORD = 255, 65535
"""The largest 8-bit and 16-bit levels."""
BRIGHT_SHARE = 0.5
"""Share of a picture's values above 1 from which its scale counts as wrong: in a picture of high
dynamic range the light alone is above 1."""


def host_array(array: Any, name: str) -> np.ndarray:
    """``array`` in NumPy, in the processor's byte order. Raises InputError for what holds no real
    numbers, and for a masked array that hides some."""
    if isinstance(array, np.ma.MaskedArray):
        if np.ma.is_masked(array):
            raise InputError(
                f"{name}: expected numbers everywhere, got a masked array that hides "
                f"{np.ma.count_masked(array)} of {array.size}; fill it, and use valid= for a target"
            )
        array = array.data
    try:
        found = np.asarray(array)
    except (TypeError, ValueError, RuntimeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{name}: expected an array of numbers, got {reason}") from error
    kind = found.dtype.name
    if found.dtype.kind not in "biuf" and kind != "bfloat16":
        raise InputError(f"{name}: expected numbers, got an array of {found.dtype}; convert it")
    return found.astype(found.dtype.newbyteorder("="), copy=False)


def levels_of(array: Any, name: str) -> tuple[np.ndarray, float | None]:
    """Values from 0 to 1, float32, and the step between two levels; None for floats.

    Raises InputError as ``host_array`` does, and for integers or floats on another scale.
    """
    found = host_array(array, name)
    top = top_of(found, name)
    if top is not None:
        return (found.astype(np.float64) / top).astype(np.float32), 1 / top
    with np.errstate(over="ignore"):
        return found.astype(np.float32, copy=False), None


def top_of(found: np.ndarray, name: str) -> int | None:
    """The integer that stands for 1; None for floats and booleans."""
    kind = found.dtype.kind
    if kind == "u" and found.dtype.itemsize <= 2:
        return BYTE if found.dtype.itemsize == 1 else WORD
    if kind in "iu":
        # A library's wide integers hold bytes or words all the same.
        least, most = (int(found.min()), int(found.max())) if found.size else (0, 0)
        if least < 0 or most > WORD:
            raise InputError(
                f"{name}: expected levels from 0 to {BYTE} or {WORD}, got integers from {least} to "
                f"{most}; scale them, or give floats with 1.0 as the brightest level"
            )
        return BYTE if most <= BYTE else WORD
    if kind != "b" and found.size:
        finite = found[np.isfinite(found)].astype(np.float64)
        above = float((finite > 1).mean()) if finite.size else 0.0
        most = float(finite.max(initial=0))
        if above > BRIGHT_SHARE and most <= WORD:
            top = BYTE if most <= BYTE else WORD
            raise InputError(
                f"{name}: expected floats with 1.0 as the brightest level, got values up to "
                f"{most:g}, {above:.0%} of them above 1; divide them by {top}"
            )
    return None


def as_light(array: Any, name: str) -> Any:
    """``array`` as floats that a model can sum: JAX arrays stay so, also while they are traced, and
    an ``Image`` is its linear values.

    Half and brain floats become float32; float64 stays where it is. Raises InputError as
    ``levels_of`` does, and for integers of a traced array whose scale is not known.
    """
    import jax
    import jax.numpy as jnp
    from jax.core import Tracer

    # That module builds on this one's neighbours, and most arrays are no images.
    from godfit.io.image import Image

    if isinstance(array, Image):
        return jnp.asarray(array.values)
    if not isinstance(array, jax.Array):
        found = host_array(array, name)
        if found.dtype == np.float64:
            top_of(found, name)
            return jnp.asarray(found)
        return jnp.asarray(levels_of(found, name)[0])
    kind = array.dtype
    if kind in (jnp.float32, jnp.float64):
        return array
    if kind == jnp.bool_ or jnp.issubdtype(kind, jnp.floating):
        return array.astype(jnp.float32)
    if kind in (jnp.uint8, jnp.uint16):
        return array.astype(jnp.float32) / (BYTE if kind == jnp.uint8 else WORD)
    if isinstance(array, Tracer):
        raise InputError(f"{name}: expected floats, bytes or 16-bit words, got {kind}; convert it")
    return jnp.asarray(levels_of(np.asarray(array), name)[0])

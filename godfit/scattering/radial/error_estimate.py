"""How wrong is a method on this mask, and which is the cheapest that is right enough?

A method's error depends on the mask more than on anything that could be said beforehand: merged
taps that are off by a fifth of a level on clouds are off by sixteen on struts. So it is measured:
the approximate picture is made and held against the exact sum at a few thousand probes. Errors sit
at the edges of streaks, so most probes lie where the approximation is steep or bent, and a factor
makes up for the worst pixel's not being among them: over 90 random pictures by six methods
it was at most 1.95 times as wrong as the worst probe.

That costs more than one exact picture: it is for many pictures of much the same mask and taps, as
in an animation, and to know an error at all. Nothing here runs inside ``jit``.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.scattering.radial.exact import EXACT, fastest
from godfit.scattering.radial.methods import METHODS, radial_sum
from godfit.scattering.taps import Taps

# Of each kind; pictures with fewer pixels than all together are compared whole.
PROBES = 1024
SAFETY = 2.5

Mask = Float[Array, "h w"] | Float[Array, "h w c"]

_sum = jax.jit(radial_sum, static_argnames="method")


def error(
    mask: Mask,
    light: Float[Array, "2"] | Float[Array, "lights 2"],
    taps: Taps,
    method: str,
    scale: float = 255.0,
) -> float:
    """The largest error of ``method`` over the picture, estimated from above.

    **Arguments:** as of `godfit.scattering.radial.radial_sum`; of several lights the errors add up.

    - `scale`: what a value of 1 is; by default the result is in 8-bit levels. Values are not
      clamped, as a picture's are: there the error may be less.

    **Returns:** an upper estimate, not a bound: the worst of the probes times a safety factor.
    """
    lights = jnp.reshape(light, (-1, 2))
    if method == "auto" or (method in EXACT and method != "packed"):
        return 0.0
    return sum(scale * _error(mask, one, taps, method) for one in lights)


def _error(mask: Mask, light: Float[Array, "2"], taps: Taps, method: str) -> float:
    rough = np.asarray(_sum(mask, light, taps, method=method))
    h, w = rough.shape[:2]
    if h * w <= 4 * PROBES:
        return float(np.abs(rough - np.asarray(_sum(mask, light, taps))).max())
    probes = _probes(rough if rough.ndim == 2 else rough.mean(-1))
    at = jnp.asarray(np.stack([probes % w, probes // w], -1), rough.dtype)
    exact = np.asarray(_sum(mask, light, taps, at=at))
    found = rough.reshape(h * w, *rough.shape[2:])[probes]
    return SAFETY * float(np.abs(found - exact).max())


def _probes(picture: np.ndarray) -> np.ndarray:
    """Row-major indices: random pixels, the steepest, the most bent, and the steepest of each cell
    of the picture."""
    h, w = picture.shape
    wide = np.pad(picture, 1, mode="edge")
    left, right, up, down = wide[1:-1, :-2], wide[1:-1, 2:], wide[:-2, 1:-1], wide[2:, 1:-1]
    slope, bend = np.hypot(right - left, down - up), abs(left + right + up + down - 4 * picture)
    random = np.random.default_rng(0).integers(0, h * w, PROBES)
    most = [np.argpartition(z.ravel(), -PROBES)[-PROBES:] for z in (slope, bend)]
    side = math.ceil(math.sqrt(h * w / PROBES))
    cells = np.pad(slope, ((0, -h % side), (0, -w % side)), constant_values=-1)
    cells = cells.reshape(-(-h // side), side, -(-w // side), side).swapaxes(1, 2)
    steepest = cells.reshape(*cells.shape[:2], -1).argmax(-1)
    rows, columns = np.indices(steepest.shape) * side
    each = (rows + steepest // side) * w + columns + steepest % side
    return np.concatenate([random, *most, each.ravel()])


def cheapest(
    mask: Mask,
    light: Float[Array, "2"] | Float[Array, "lights 2"],
    taps: Taps,
    tolerance: float,
    scale: float = 255.0,
) -> str:
    """Name of the cheapest method whose estimated `error` is no more than ``tolerance``.

    Methods are tried in the order of their cost on this device for this size and number of taps
    (`costs`), until one is good enough or none is cheaper than the fastest exact one, which is then
    the answer, as it is for a tolerance of 0. Of several lights the errors add up.
    """
    if not tolerance >= 0:
        raise ValueError(f"tolerance: expected a number, 0 or more, got {tolerance}")
    best = fastest(taps)
    if tolerance == 0 or taps.unit != "ray":
        return best
    price = costs(mask.shape[0], mask.shape[1], taps.count)
    for method in sorted(price, key=price.__getitem__):
        if price[method] >= price[best]:
            break
        if error(mask, light, taps, method, scale) <= tolerance:
            return method
    return best


def costs(h: int, w: int, count: int) -> dict[str, float]:
    """What each method costs, in taps of the fastest exact one at every pixel."""
    compiled = fastest(Taps(0.0, 0.0, 0.0, 0.0, count)) == "strips"
    # To read a small picture back; a gathered tap; a multiplication in a matrix.
    grow, gather, multiply = (40.0, 12.0, 0.6) if compiled else (1.0, 1.0, 0.02)
    radii = math.hypot(h, w) / math.sqrt(2)
    found = {
        "reference": 1.5 * gather * count,
        "pairs": gather * count,
        "packed": 0.7 * gather * count,
        "half": count / 4 + grow,
        "quarter": count / 16 + grow,
        "polar": 2 * grow + multiply * radii,
        **{f"merged/{m}": float(-(-count // m)) for m in (2, 4, 8)},
        **{f"gauss/{n}": 1.5 * gather * min(n, count) for n in (16, 32)},
    }
    if compiled:
        found["strips"] = float(count)
    return {name: cost for name, cost in found.items() if name in METHODS}

"""The error of a method on a mask, and the cheapest method whose error is within a tolerance.

A method's error depends on the mask more than on anything known beforehand: merged taps that are a
fifth of a level off on clouds are sixteen levels off on struts. So it is measured: the approximate
picture is computed and compared with the exact sum at a few thousand probes. Errors are largest at
the edges of streaks, so most probes lie where the slope or the curvature of the approximation is
large. The worst pixel need not be among them, and a safety factor makes up for that: over 90 random
pictures by six methods its error was at most 1.95 times that of the worst probe.

An estimate costs more than one exact picture. It is worth that for many pictures of similar masks
and taps, as in an animation, or where the error itself is wanted. Nothing here runs inside ``jit``.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.scattering.parameters import LIGHT_DENSITY
from godfit.scattering.radial.exact import EXACT, fastest
from godfit.scattering.radial.methods import METHODS, radial_sum
from godfit.scattering.taps import Taps

PROBES_PER_KIND = 1024
"""Probes of each of the four kinds: in this many the largest error is found within the factor."""
ERROR_SAFETY_FACTOR = 2.5
"""Estimate over the worst probe's error: above 1.95, the largest ratio measured (see above)."""

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

    **Arguments:** those of `godfit.scattering.radial.radial_sum`; errors of several lights add up.

    - `scale`: multiplies the values; by default the result is in 8-bit levels. Values are not
      clamped, as a picture's are: there the error may be less.

    **Returns:** an upper estimate, not a bound: the worst of the probes times a safety factor.
    """
    lights = jnp.reshape(light, (-1, 2))
    if method == "auto" or (method in EXACT and method != "packed"):
        return 0.0
    return sum(scale * _error(mask, one, taps, method) for one in lights)


def _error(mask: Mask, light: Float[Array, "2"], taps: Taps, method: str) -> float:
    approximate = np.asarray(_sum(mask, light, taps, method=method))
    h, w = approximate.shape[:2]
    if h * w <= 4 * PROBES_PER_KIND:
        return float(np.abs(approximate - np.asarray(_sum(mask, light, taps))).max())
    probes = _probes(approximate if approximate.ndim == 2 else approximate.mean(-1))
    at = jnp.asarray(np.stack([probes % w, probes // w], -1), approximate.dtype)
    exact = np.asarray(_sum(mask, light, taps, at=at))
    probed = approximate.reshape(h * w, *approximate.shape[2:])[probes]
    return ERROR_SAFETY_FACTOR * float(np.abs(probed - exact).max())


def _probes(picture: np.ndarray) -> np.ndarray:
    """Row-major indices of four kinds: random pixels, those of the largest slope, those of the
    largest curvature, and that of the largest slope in each cell of the picture."""
    h, w = picture.shape
    wide = np.pad(picture, 1, mode="edge")
    left, right, up, down = wide[1:-1, :-2], wide[1:-1, 2:], wide[:-2, 1:-1], wide[2:, 1:-1]
    slope = np.hypot(right - left, down - up)
    curvature = abs(left + right + up + down - 4 * picture)
    random = np.random.default_rng(0).integers(0, h * w, PROBES_PER_KIND)
    largest = [
        np.argpartition(z.ravel(), -PROBES_PER_KIND)[-PROBES_PER_KIND:] for z in (slope, curvature)
    ]
    side = math.ceil(math.sqrt(h * w / PROBES_PER_KIND))
    cells = np.pad(slope, ((0, -h % side), (0, -w % side)), constant_values=-1)
    cells = cells.reshape(-(-h // side), side, -(-w // side), side).swapaxes(1, 2)
    steepest = cells.reshape(*cells.shape[:2], -1).argmax(-1)
    rows, columns = np.indices(steepest.shape) * side
    of_cells = (rows + steepest // side) * w + columns + steepest % side
    return np.concatenate([random, *largest, of_cells.ravel()])


def cheapest(
    mask: Mask,
    light: Float[Array, "2"] | Float[Array, "lights 2"],
    taps: Taps,
    tolerance: float,
    scale: float = 255.0,
) -> str:
    """Name of the cheapest method whose estimated `error` is at most ``tolerance``.

    Methods are tried in the order of their cost on this device for this size and number of taps
    (`costs`), until one is within the tolerance. If none that is cheaper than the fastest exact
    method is, the result is that method, as it is for a tolerance of 0. Errors of several lights
    add up. Raises ValueError for a negative tolerance.
    """
    if not tolerance >= 0:
        raise ValueError(f"tolerance: expected a number, 0 or more, got {tolerance}")
    exact = fastest(taps)
    if tolerance == 0 or taps.unit != "ray":
        return exact
    price = costs(mask.shape[0], mask.shape[1], taps.count)
    if taps.end > LIGHT_DENSITY:
        # The matrix has twice the columns.
        price["polar"] *= 2
    for method in sorted(price, key=price.__getitem__):
        if price[method] >= price[exact]:
            break
        if error(mask, light, taps, method, scale) <= tolerance:
            return method
    return exact


def costs(h: int, w: int, count: int) -> dict[str, float]:
    """The cost of each method, in taps of the fastest exact one at every pixel."""
    compiled = fastest(Taps(0.0, 0.0, 0.0, 0.0, count)) == "strips"
    # To enlarge a small picture; a gathered tap; a multiplication in a matrix.
    enlarging, gathering, multiplying = (40.0, 12.0, 0.6) if compiled else (1.0, 1.0, 0.02)
    radii = math.hypot(h, w) / math.sqrt(2)
    cost = {
        "reference": 1.5 * gathering * count,
        "pairs": gathering * count,
        "packed": 0.7 * gathering * count,
        "half": count / 4 + enlarging,
        "quarter": count / 16 + enlarging,
        "polar": 2 * enlarging + multiplying * radii,
        **{f"merged/{m}": float(-(-count // m)) for m in (2, 4, 8)},
        **{f"gauss/{n}": 1.5 * gathering * min(n, count) for n in (16, 32)},
    }
    if compiled:
        cost["strips"] = float(count)
    return {name: taps for name, taps in cost.items() if name in METHODS}

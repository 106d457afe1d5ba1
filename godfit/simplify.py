"""How few samples, and how small a light pass, does a picture need?

A shader with n' samples in place of n shows much the same if its taps weigh as much together, fall
off as fast along the ray and have the same centroid: that fixes decay, weight and density for every
n' (the ends of the ray are corrected for, where a plain change of n is off by a tap's length). How
far off the picture then is depends on the mask, so it is rendered and measured, every pixel of it.
"""

from __future__ import annotations

import dataclasses
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy import optimize

from godfit.errors import InputError
from godfit.models import Mitchell
from godfit.observation import LEVELS, render, shrink

SCALES = (1.0, 0.5, 0.25)
LEAST = 2


@dataclasses.dataclass(frozen=True, eq=False)
class Simpler:
    """The cheapest setting found: ``scale`` is that of the light pass's sides. ``worst`` and
    ``rms`` are its error in levels; ``saving`` is how many times fewer taps a picture takes."""

    model: Mitchell
    scale: float
    worst: float
    rms: float
    saving: float


def resampled(model: Mitchell, samples: int) -> Mitchell:
    """``model`` with another number of samples and parameters that make up for it; density does
    not go beyond 1."""
    if samples == model.samples or model.convention.box:
        return dataclasses.replace(model, samples=samples)
    density = float(model.density)
    kappa = -model.samples * math.log(max(float(model.decay), 1e-12)) / density
    total, centroid = _moments(model)

    def at(rho: float) -> Mitchell:
        decay = math.exp(-kappa * rho / samples)
        return eqx.tree_at(
            lambda m: (m.decay, m.density),
            dataclasses.replace(model, samples=samples),
            (jnp.float32(decay), jnp.float32(rho)),
        )

    def off(rho: float) -> float:
        return _moments(at(rho))[1] - centroid

    low, high = 0.25 * density, 1.0
    if off(low) < 0 < off(high):
        rho = float(optimize.brentq(off, low, high, xtol=1e-9))  # pyright: ignore[reportArgumentType]
    else:
        rho = high if off(high) <= 0 else low
    other = at(rho)
    weight = float(model.weight) * total / max(_moments(other)[0], 1e-30)
    return eqx.tree_at(lambda m: m.weight, other, jnp.float32(weight))


def _moments(model: Mitchell) -> tuple[float, float]:
    """Sum of the taps' weights but for the pixel's own, and their centroid along the ray."""
    (taps,) = model.taps
    c = float(taps.first) * float(taps.ratio) ** np.arange(taps.count, dtype=float)
    t = float(taps.step) * np.arange(1, taps.count + 1)
    total = float(c.sum())
    return total, float(c @ t) / max(total, 1e-30)


def simplify(
    model: Mitchell,
    mask: np.ndarray,
    tolerance: float,
    *,
    background: np.ndarray | None = None,
    size: tuple[int, int] | None = None,
    by: str = "worst",
) -> Simpler:
    """The setting of fewest taps whose picture is within ``tolerance`` levels of the model's.

    **Arguments:**

    - `mask`: (h, w) or (h, w, 3), what the light pass reads at full scale.
    - `tolerance`: in 8-bit levels, of the worst pixel, or of all in the mean square
      (``by="rms"``).
    - `background`, `size`: as of `godfit.Mitchell`.

    Raises InputError for a tolerance that is not above 0, and for the shader ``three``, whose
    samples are fixed. Errors do not fall evenly with samples: fewer than were found may do too.
    """
    if not 0 < tolerance < math.inf:
        raise InputError(f"tolerance: expected levels above 0, got {tolerance:g}")
    if by not in ("worst", "rms"):
        raise InputError(f"by: expected worst or rms, got '{by}'")
    if model.convention.box:
        raise InputError(f"simplify: expected a shader with samples, got '{model.convention.name}'")
    shape = (mask.shape[0], mask.shape[1]) if size is None else size
    full = render(model, mask, background, shape)
    best = Simpler(model, 1.0, 0.0, 0.0, 1.0)
    for scale in SCALES:
        h, w = (max(1, round(n * scale)) for n in mask.shape[:2])
        low = mask if scale == 1 else shrink(mask, (h, w))
        pixels = scale**2

        def tried(samples: int, scale=scale, low=low, pixels=pixels) -> Simpler | None:
            other = resampled(model, samples)
            off = LEVELS * (render(other, low, background, shape) - full)
            worst, rms = float(np.abs(off).max()), float(np.sqrt((off.astype(float) ** 2).mean()))
            if (worst if by == "worst" else rms) > tolerance:
                return None
            saving = model.samples / (samples * pixels)
            return Simpler(other, scale, worst, rms, saving)

        found = tried(model.samples) if scale != 1 else best
        if found is None:
            continue
        enough, few = model.samples, LEAST - 1
        while enough - few > 1:
            middle = round(math.sqrt(max(few, 1) * enough)) if enough > 2 * few else 0
            middle = min(max(middle or (few + enough) // 2, few + 1), enough - 1)
            other = tried(middle)
            if other is None:
                few = middle
            else:
                enough, found = middle, other
        if found.saving > best.saving:
            best = found
    return best

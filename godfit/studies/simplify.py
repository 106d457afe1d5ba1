"""How few samples, and how small a light pass, does a picture need?

A shader with n' samples in place of n shows much the same if its taps weigh as much together, fall
off as fast along the ray and have the same centroid: that fixes decay, weight and density for every
n' (the ends of the ray are corrected for, where a plain change of n is off by a tap's length). How
far off the picture then is depends on the mask, so it is rendered and measured, every pixel of it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy import optimize

from godfit.errors import InputError
from godfit.inference.observation import LEVELS, render
from godfit.io.filters import shrink
from godfit.io.image import encode
from godfit.models.mitchell import Mitchell

SCALES = (1.0, 0.5, 0.25)
LEAST = 2
# Levels that are kept of the tolerance: what float32 may be off by, and more.
SPARE = 5e-3


@dataclasses.dataclass(frozen=True, eq=False)
class Simpler:
    """The cheapest setting found: ``scale`` is that of the light pass's sides. ``worst`` and
    ``rms`` are its error in levels against ``full``; ``saving`` is how many times fewer taps a
    picture takes."""

    full: Mitchell
    model: Mitchell
    scale: float
    worst: float
    rms: float
    saving: float

    @property
    def sentence(self) -> str:
        """What the picture needs, in words."""
        few, many = self.model.samples, self.full.samples
        if self.saving == 1:
            return f"this picture needs all of its {many} samples"
        said = f"this picture needs {few} samples, not {many}"
        if few == many:
            said = f"this picture needs its {many} samples"
        if self.scale < 1:
            said += f", and a light pass of {self.scale:g} times the sides"
        return f"{said}: {self.saving:.3g} times fewer taps"

    def summary(self) -> str:
        """The sentence, and what to paste into the shader."""
        said = f"off by {self.worst:.3g} levels at most, {self.rms:.3g} rms"
        settings = [("samples", str(self.model.samples))]
        settings += [(name, f"{value:.9g}") for name, value in _numbers(self.model).items()]
        if self.scale < 1:
            settings.append(("pass scale", f"{self.scale:g}"))
        wide = max(len(name) for name, _ in settings)
        lines = [f"  {name:<{wide}} = {value}" for name, value in settings]
        return "\n".join([self.sentence, f"  ({said})", "", *lines])


def _numbers(model: Mitchell) -> dict[str, float]:
    return {name: float(value) for name, value in model.values().items()}


def as_json(found: Simpler, tolerance: float, by: str, command: str = "") -> dict[str, Any]:
    """What ``godfit simplify --json`` prints; ``godfit render --params`` reads it."""
    return {
        "schema": 1,
        "message": found.sentence,
        "model": found.model.name,
        "shader": found.model.shader,
        "samples": found.model.samples,
        "pass_scale": found.scale,
        "params": {name: {"value": value} for name, value in _numbers(found.model).items()},
        "tolerance_levels": tolerance,
        "by": by,
        "worst_levels": found.worst,
        "rms_levels": found.rms,
        "saving": found.saving,
        "full_samples": found.full.samples,
        "command": command,
    }


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
    transfer: str = "none",
    by: str = "worst",
    progress: Callable[[str], None] | None = None,
) -> Simpler:
    """The setting of fewest taps whose picture is within ``tolerance`` levels of the model's.

    **Arguments:**

    - `mask`: (h, w) or (h, w, 3), what the light pass reads at full scale.
    - `tolerance`: in 8-bit levels, of the worst pixel, or of all in the mean square
      (``by="rms"``).
    - `background`, `size`: as of `godfit.Mitchell`.
    - `transfer`: how the picture is encoded; levels are those of the encoded picture.

    Raises InputError for a tolerance that is not above 0, and for the shader ``three``, whose
    samples are fixed. Errors do not fall evenly with samples: fewer than were found may do too.
    """
    if not 0 < tolerance < math.inf:
        raise InputError(f"tolerance: expected levels above 0, got {tolerance:g}")
    if by not in ("worst", "rms"):
        raise InputError(f"by: expected worst or rms, got '{by}'")
    if model.convention.box:
        raise InputError(f"simplify: expected a shader with samples, got '{model.convention.name}'")
    if tolerance <= 2 * SPARE:
        raise InputError(f"tolerance: expected more than {2 * SPARE:g} levels, got {tolerance:g}")
    shape = (mask.shape[0], mask.shape[1]) if size is None else size
    say = progress or (lambda text: None)

    def levels(of: Mitchell, seen: np.ndarray) -> np.ndarray:
        image = encode(render(of, seen, background, shape), transfer)
        return LEVELS * np.asarray(image, np.float64)

    full = levels(model, mask)
    best = Simpler(model, model, 1.0, 0.0, 0.0, 1.0)
    for scale in SCALES:
        h, w = (max(1, round(n * scale)) for n in mask.shape[:2])
        low = mask if scale == 1 else shrink(mask, (h, w))

        def tried(samples: int, scale=scale, low=low) -> Simpler | None:
            say(f"{samples} samples, light pass of {low.shape[1]}x{low.shape[0]}")
            other = resampled(model, samples)
            off = levels(other, low) - full
            worst, rms = float(np.abs(off).max()), float(np.sqrt((off**2).mean()))
            if (worst if by == "worst" else rms) > tolerance - SPARE:
                return None
            saving = model.samples / (samples * scale**2)
            return Simpler(model, other, scale, worst, rms, saving)

        found = tried(model.samples) if scale != 1 else best
        if found is None:
            # A pass that is smaller still would be farther off.
            break
        enough, few = model.samples, LEAST - 1
        while enough - few > 1:
            # In the middle of the logarithms while the two are far apart.
            middle = round(math.sqrt(few * enough)) if enough > 2 * few else (few + enough) // 2
            middle = min(max(middle, few + 1), enough - 1)
            other = tried(middle)
            if other is None:
                few = middle
            else:
                enough, found = middle, other
        if found.saving > best.saving:
            best = found
    return best

"""What `godfit simplify` makes of a random target, and its true error.

Both settings are rendered in float64, tap by tap, by other code; scipy upsamples the smaller pass.
"""

from __future__ import annotations

import jax
import numpy as np
from scipy import ndimage

from godfit import Mitchell
from godfit.io.filters import shrink
from godfit.report.simplify import Simpler
from godfit.studies.simplify import simplify
from tests.support import random_targets


def truth_of(model: Mitchell) -> dict[str, float]:
    return {k: float(v) for k, v in model.values().items()} | {"samples": model.samples}


def picture64(model: Mitchell, mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(h, w) levels of the model's picture, clamped, in float64 and by other code."""
    light = np.clip(random_targets.render64(mask, truth_of(model)), 0, 1)
    if light.shape != size:
        at = [
            (np.arange(n) + 0.5) * low / n - 0.5 for n, low in zip(size, light.shape, strict=True)
        ]
        at = np.meshgrid(*at, indexing="ij")
        light = ndimage.map_coordinates(light, at, order=1, mode="nearest")
    return 255 * light


def attempt(seed: int, tolerance: float | None, by: str, size: int) -> tuple[Simpler, float, float]:
    """(what was found, its true error, the tolerance), in levels."""
    kinds = list(random_targets.MASKS)
    mask, _, truth = random_targets.draw(seed, kinds[seed % len(kinds)], size)
    tolerance = tolerance or float(np.random.default_rng(seed).uniform(0.5, 4))
    numbers = [truth[k] for k in ("exposure", "decay", "density", "weight")]
    light = [truth["light_x"], truth["light_y"]]
    with jax.enable_x64(False):
        exposure, decay, density, weight = numbers
        model = Mitchell(exposure, decay, density, weight, light, "dawntime", int(truth["samples"]))
        values = (mask / 255).astype(np.float32)
        found = simplify(model, values, tolerance, by=by)
    h, w = (max(1, round(n * found.scale)) for n in mask.shape)
    low = values if found.scale == 1 else shrink(values, (h, w))
    shape = (mask.shape[0], mask.shape[1])
    off = picture64(found.model, low.astype(float), shape)
    off -= picture64(model, values.astype(float), shape)
    true = np.abs(off).max() if by == "worst" else np.sqrt((off**2).mean())
    return found, float(true), tolerance

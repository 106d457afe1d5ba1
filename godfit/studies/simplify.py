"""The fewest samples, and the smallest light pass, that a picture needs.

A shader with n' samples in place of n draws nearly the same picture if its taps have the same
total weight, the same fall-off along the ray and the same centroid. That fixes decay, weight and
density for every n'. The ends of the ray are corrected for: a plain change of n is off by a tap's
length. The remaining error depends on the mask, so every pixel is rendered and measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from godfit.errors import InputError
from godfit.inference.observation import render
from godfit.io.filters import shrink
from godfit.io.image import LEVELS, encode
from godfit.models.mitchell import Mitchell, resampled
from godfit.report.simplify import Simpler

PASS_SCALES = (1.0, 0.5, 0.25)
"""Sizes of the light pass that are tried, relative to the mask: those that engines offer."""
FEWEST_SAMPLES = 2
"""Samples of the smallest sum that is tried: one sample is no ray."""
TOLERANCE_MARGIN = 5e-3
"""Levels by which an error must be below the tolerance: more than the error of float32."""


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

    Raises InputError for a tolerance that is not above 0, and for a shader of several
    passes, whose samples are fixed. The error is not monotonic in the samples: a smaller number may
    do too.
    """
    if not 0 < tolerance < math.inf:
        raise InputError(f"tolerance: expected levels above 0, got {tolerance:g}")
    if by not in ("worst", "rms"):
        raise InputError(f"by: expected worst or rms, got '{by}'")
    if not model.convention.plain:
        raise InputError(f"simplify: expected a shader with samples, got '{model.convention.name}'")
    if tolerance <= 2 * TOLERANCE_MARGIN:
        raise InputError(
            f"tolerance: expected more than {2 * TOLERANCE_MARGIN:g} levels, got {tolerance:g}"
        )
    shape = (mask.shape[0], mask.shape[1]) if size is None else size
    say = progress or (lambda text: None)

    def levels(shader: Mitchell, occlusion: np.ndarray) -> np.ndarray:
        image = encode(render(shader, occlusion, background, shape), transfer)
        return LEVELS * np.asarray(image, np.float64)

    full = levels(model, mask)
    best = Simpler(model, model, 1.0, 0.0, 0.0, 1.0, tolerance, by)
    for scale in PASS_SCALES:
        h, w = (max(1, round(n * scale)) for n in mask.shape[:2])
        low = mask if scale == 1 else shrink(mask, (h, w))

        def tried(samples: int, scale=scale, low=low) -> Simpler | None:
            say(f"{samples} samples, light pass of {low.shape[1]}x{low.shape[0]}")
            other = resampled(model, samples)
            off = levels(other, low) - full
            worst, rms = float(np.abs(off).max()), float(np.sqrt((off**2).mean()))
            if (worst if by == "worst" else rms) > tolerance - TOLERANCE_MARGIN:
                return None
            saving = model.samples / (samples * scale**2)
            return Simpler(model, other, scale, worst, rms, saving, tolerance, by)

        found = tried(model.samples) if scale != 1 else best
        if found is None:
            # A pass that is smaller still would be farther off.
            break
        enough, too_few = model.samples, FEWEST_SAMPLES - 1
        while enough - too_few > 1:
            # In the middle of the logarithms while the two are far apart.
            middle = (
                round(math.sqrt(too_few * enough))
                if enough > 2 * too_few
                else (too_few + enough) // 2
            )
            middle = min(max(middle, too_few + 1), enough - 1)
            other = tried(middle)
            if other is None:
                too_few = middle
            else:
                enough, found = middle, other
        if found.saving > best.saving:
            best = found
    return best

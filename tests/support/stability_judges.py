"""What ``stability_cases.py`` is made of: a truth, its pictures, and how a fit is judged."""

from __future__ import annotations

import numpy as np

import godfit
from tests.support import random_targets

SAMPLES = 40
TRUTH = {
    "exposure": 0.09,
    "decay": 0.97,
    "density": 0.8,
    "weight": 0.5,
    "light_x": 0.55,
    "light_y": 0.62,
    "samples": SAMPLES,
}
# A wrong answer is outside both this and five quoted errors.
TOLERANCE = {"exposure": 0.005, "decay": 5e-4, "density": 5e-3, "weight": 0.05, "light_x": 2e-3,
             "light_y": 2e-3}  # fmt: skip
Outcome = tuple[bool, str]


def mask_of(size: int, kind: str = "triangles", seed: int = 3, **changes: float) -> np.ndarray:
    truth = TRUTH | changes
    light = np.array([truth["light_x"], truth["light_y"]])
    mask = random_targets.MASKS[kind](np.random.default_rng(seed), size, light)
    return np.floor(mask * 255 + 0.5).clip(0, 255).astype(np.uint8)


def light_pass(mask: np.ndarray, **changes: float) -> np.ndarray:
    return random_targets.render64(mask / 255, TRUTH | changes)


def fit(target: np.ndarray, mask: np.ndarray, **options) -> godfit.FitResult:
    options = {"shader": "dawntime", "samples": SAMPLES} | options
    return godfit.fit(target, mask=mask, **options)


def wrong(result: godfit.FitResult, **changes: float) -> list[str]:
    """Parameters that are said to be known and are neither near nor within five errors."""
    truth = TRUTH | changes
    return [
        name
        for name, e in result.params.items()
        if not np.isfinite(e.value)
        or (
            e.stderr is not None and abs(e.value - truth[name]) > max(TOLERANCE[name], 5 * e.stderr)
        )
    ]


def says(result: godfit.FitResult) -> str:
    off = "converged" if result.converged else "not converged"
    return f"{off}, {result.rmse_levels:.2f} levels"


def recovers(result: godfit.FitResult, **changes: float) -> Outcome:
    off = wrong(result, **changes)
    return result.converged and not off, says(result) + (
        f"; wrong: {', '.join(off)}" if off else ""
    )


def honest(result: godfit.FitResult, **changes: float) -> Outcome:
    """Recovered, or said not to be."""
    off = wrong(result, **changes)
    return not result.converged or not off, says(result) + (
        f"; off: {', '.join(off)}" if off else ""
    )


def warns(result: godfit.FitResult, text: str) -> Outcome:
    heard = any(text in w for w in result.warnings)
    return heard and finite(result), says(result) + ("; " + "; ".join(result.warnings))[:60]


def refuses(result: godfit.FitResult) -> Outcome:
    return not result.converged and finite(result), says(result)


def names(result: godfit.FitResult, *words: str) -> Outcome:
    said = " ".join(result.undetermined)
    kept = all(word in said for word in words) and finite(result)
    return kept, said[:70] or "nothing named"


def finite(result: godfit.FitResult) -> bool:
    return all(np.isfinite(e.value) for e in result.params.values())


def clean(size: int, kind: str = "triangles", noise: float = 0.0, **changes: float) -> Outcome:
    mask = mask_of(size, kind, 3, **changes)
    return recovers(
        fit(random_targets.to_bytes(light_pass(mask, **changes), noise), mask), **changes
    )

"""A small picture of a known truth, and its fit."""

from __future__ import annotations

import numpy as np

import godfit
from tests.support import random_targets

SIZE, SAMPLES = 96, 30
TRUTH = {
    "exposure": 0.12,
    "decay": 0.95,
    "density": 0.8,
    "weight": 0.5,
    "light_x": 0.55,
    "light_y": 0.62,
}
ALONE = {"inquire": False, "pass_scale": 1.0}
"""Options of a fit that is not asked for the reason where it is wrong, nor tried at another size:
each hint and each other size has a test of its own, and compiles for it."""


def picture(seed, noise=0.0, kind="triangles", **changes):
    """(target, mask) bytes: dawntime in float64, by other code than the fit's."""
    truth = TRUTH | changes | {"samples": SAMPLES}
    rng = np.random.default_rng(seed)
    light = np.array([truth["light_x"], truth["light_y"]])
    mask = random_targets.MASKS[kind](rng, SIZE, light)
    mask = np.floor(mask * 255 + 0.5).clip(0, 255).astype(np.uint8)
    return random_targets.to_bytes(random_targets.render64(mask / 255, truth), noise, seed), mask


def fit(target, mask, **options):
    shown = {"shader": "dawntime", "samples": SAMPLES, "mask": mask, "arithmetic": "exact"}
    options = shown | options
    return godfit.fit(target, **options)


def errors(result, **changes):
    truth = TRUTH | changes
    return {n: abs(e.value - truth[n]) for n, e in result.params.items()}

"""From what the user gives to what the fit works on, or one line that says why not."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

import numpy as np

from godfit.errors import InputError
from godfit.flatland.model import Flatland
from godfit.io.sources import Source
from godfit.models.hoffman_preetham import HoffmanPreetham
from godfit.models.mitchell import Mitchell

MODELS = (Mitchell.name, HoffmanPreetham.name, Flatland.name)


def check_unaided(
    model: str,
    lights: int,
    background: Source | None,
    occluder: Source | None,
    bright_pass: bool,
) -> None:
    """Raise InputError for what a fit without mask and scene does not do."""
    if model != Mitchell.name:
        raise InputError(f"mask: expected --mask or --scene with the model {model}, got neither")
    if lights != 1:
        raise InputError(f"lights: expected 1 without a mask, got {lights}; give --mask")
    if background is not None:
        raise InputError("background: expected none without a mask, got one; give --mask as well")
    if bright_pass and occluder is not None:
        raise InputError("occluder: expected none with --bright-pass, got one; give either")


def check_model(
    model: str,
    free: Sequence[str],
    shader: str | None,
    lights: int,
    fov: float | None,
    distance: float | np.ndarray | None,
) -> None:
    """Raise InputError for what does not go together."""
    if model not in MODELS:
        near = difflib.get_close_matches(model, MODELS, n=1, cutoff=0.0)[0]
        raise InputError(
            f"model: expected one of {', '.join(MODELS)}, got '{model}'; did you mean '{near}'?"
        )
    if model == Mitchell.name:
        for name, value in (("fov", fov), ("distance", distance)):
            if value is not None:
                raise InputError(f"{name}: expected --model {HoffmanPreetham.name} with it")
        return
    for name, wrong in (("free", free), ("shader", shader), ("lights", lights != 1)):
        if wrong:
            raise InputError(f"{name}: expected none with the model {model}, got one; leave it out")
    if model == Flatland.name:
        for name, value in (("fov", fov), ("distance", distance)):
            if value is not None:
                raise InputError(f"{name}: expected none with the model {model}; leave it out")
        return
    if fov is not None and not 0 < fov < 180:
        raise InputError(f"fov: expected degrees above 0 and below 180, got {fov:g}")
    away = np.asarray(1.0 if distance is None else distance)
    if away.ndim not in (0, 2) or not ((away > 0) & (away < np.inf)).all():
        got = f"{away:g}" if away.ndim == 0 else f"an array {away.shape} with others in it"
        raise InputError(f"distance: expected a finite number above 0 or (h, w) of them, got {got}")

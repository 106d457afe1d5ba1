"""What a fit solves."""

from __future__ import annotations

import difflib
from collections.abc import Mapping

import numpy as np

from godfit.errors import InputError
from godfit.inference.observation import Picture
from godfit.io.image import Image
from godfit.io.sources import shrink_mask
from godfit.models.base import AbstractModel
from godfit.models.build import check_values

# More values than this say nothing new, and their derivatives would fill the memory.
MAX_VALUES = 1 << 21


def pixels_used(picture: Picture, seed: int, most: int = MAX_VALUES) -> np.ndarray:
    """All valid pixels, or those of rows drawn at random where there are too many."""
    valid = picture.valid
    rows = max(1, most // (valid.shape[1] * picture.channels))
    if rows < valid.shape[0]:
        chosen = np.random.default_rng(seed).permutation(valid.shape[0])[:rows]
        only = np.zeros_like(valid)
        only[chosen] = True
        valid = valid & only
    return np.flatnonzero(valid)


PIXELS = 2048


def checked_picture(
    target: Image,
    mask: Image,
    background: Image | None,
    valid: np.ndarray | None,
    pass_scale: float,
    channels: int = 1,
) -> Picture:
    """Target, mask and background as one, checked against each other; see ``godfit.fit``."""
    size, values = target.values.shape[:2], mask.values
    if background is not None and background.values.shape[:2] != size:
        raise InputError(
            f"background: expected the target's {size[1]}x{size[0]} pixels, got "
            f"{background.values.shape[1]}x{background.values.shape[0]}; render it at that size"
        )
    values = shrink_mask(values, pass_scale)
    (h, w), (height, width) = values.shape[:2], size
    if h > height or w > width:
        raise InputError(
            f"mask: expected at most the target's {width}x{height} pixels, got {w}x{h}; "
            "scale the mask down or give the target at full size"
        )
    # A pass at a fraction of an odd size is rounded to whole pixels: one pixel either way.
    if abs(w * height - h * width) > max(width, height):
        raise InputError(
            f"mask: expected the target's aspect {width}:{height}, got {w}:{h}; "
            "crop or render the mask for the same frame"
        )
    if valid is not None and not valid.any():
        raise InputError("ignore: expected pixels to be left, got all of them ignored; ignore less")
    back = None if background is None else background.values
    return Picture.make(target, values, back, valid, channels)


def given_and_held(
    model: AbstractModel, fix: Mapping[str, float | None], start: Mapping[str, float]
) -> tuple[dict[str, float], np.ndarray]:
    """Values that the search takes as they are, and (p,) held parameters, NaN where free."""
    table = model.parameters
    given: dict[str, float] = {}
    for option, values in (("start", start), ("fix", fix)):
        for name, value in values.items():
            if name not in table:
                near = difflib.get_close_matches(name, table, n=1, cutoff=0.0)[0]
                raise InputError(
                    f"{option}: expected one of {', '.join(table)}, got '{name}'; "
                    f"did you mean '{near}'?"
                )
            if value is None:
                value = given.get(name, model.defaults.get(name))
            if value is None:
                raise InputError(
                    f"fix: expected {name}=VALUE, got no value; it has no default here"
                )
            given[name] = float(value)
        check_values(model, {n: given[n] for n in values}, option)
    held = np.array([given[n] if n in fix else np.nan for n in table], np.float32)
    return given, held

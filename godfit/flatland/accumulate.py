"""Frames of a noisy render, accumulated over time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from godfit.errors import InputError

KEPT = 0.9
HOW = ("mean", "exponential")


def weights(frames: int, how: str = "mean", kept: float = KEPT) -> np.ndarray:
    """(frames,) what each frame weighs in the end, the first first.

    ``mean`` is the running mean; ``exponential`` is mix(new, old, kept) after the first frame, as
    published: it forgets, and its noise stays that of (1 + kept) / (1 - kept) frames at best (of 11
    frames, first one included, 5.96), where the mean's falls with every frame.
    """
    _check(how, kept)
    if frames < 1:
        raise InputError(f"frames: expected 1 or more, got {frames}")
    if how == "mean":
        return np.full(frames, 1 / frames)
    age = np.arange(frames)[::-1]
    share = (1 - kept) * kept ** age.astype(float)
    share[0] = kept ** (frames - 1)
    return share


def effective_frames(weight: np.ndarray) -> float:
    """How many frames of equal weight would leave as much noise."""
    return float(weight.sum() ** 2 / np.square(weight).sum())


def accumulated(frames: Iterable[Any], how: str = "mean", kept: float = KEPT) -> Any:
    """The accumulated picture of ``frames``, arrays of one shape, one in memory at a time."""
    _check(how, kept)
    total = None
    for number, frame in enumerate(frames, 1):
        if total is None:
            total = frame
        else:
            new = 1 / number if how == "mean" else 1 - kept
            total = total + new * (frame - total)
    if total is None:
        raise InputError("frames: expected 1 or more, got none")
    return total


def _check(how: str, kept: float) -> None:
    if how not in HOW:
        raise InputError(f"accumulation: expected {' or '.join(HOW)}, got '{how}'")
    if not 0 <= kept < 1:
        raise InputError(f"kept: expected a share from 0 to below 1, got {kept:g}")

"""Frames of a noisy render, accumulated over time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from godfit.errors import InputError

HISTORY_SHARE = 0.9
"""Share of the accumulated picture that a mix retains at every new frame: the article's."""

ACCUMULATIONS = ("mean", "mix")
"""Ways to accumulate frames."""


def weights(frames: int, how: str = "mean", history: float = HISTORY_SHARE) -> np.ndarray:
    """(frames,) the weight of each frame in the accumulated picture, the first frame first.

    ``mean`` is the running mean. ``mix`` is mix(new, old, history) after the first frame,
    as published. It forgets: its noise never falls below that of (1 + history) / (1 - history)
    frames (5.96 after 11 frames, the first included), whereas that of the mean falls with every
    frame. Raises InputError.
    """
    _check(how, history)
    if frames < 1:
        raise InputError(f"frames: expected 1 or more, got {frames}")
    if how == "mean":
        return np.full(frames, 1 / frames)
    age = np.arange(frames)[::-1]
    share = (1 - history) * history ** age.astype(float)
    share[0] = history ** (frames - 1)
    return share


def effective_frames(weight: np.ndarray) -> float:
    """The number of frames of equal weight whose mean would have as much noise."""
    return float(weight.sum() ** 2 / np.square(weight).sum())


def accumulated(frames: Iterable[Any], how: str = "mean", history: float = HISTORY_SHARE) -> Any:
    """The accumulated picture of ``frames``, arrays of one shape, one in memory at a time. Raises
    InputError."""
    _check(how, history)
    total = None
    for number, frame in enumerate(frames, 1):
        if total is None:
            total = frame
        else:
            new = 1 / number if how == "mean" else 1 - history
            total = total + new * (frame - total)
    if total is None:
        raise InputError("frames: expected 1 or more, got none")
    return total


def _check(how: str, history: float) -> None:
    if how not in ACCUMULATIONS:
        raise InputError(f"accumulation: expected {' or '.join(ACCUMULATIONS)}, got '{how}'")
    if not 0 <= history < 1:
        raise InputError(f"history: expected a share from 0 to below 1, got {history:g}")

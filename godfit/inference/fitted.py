"""Where a fit ended."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from godfit.inference import diagnostics
from godfit.inference.information import Evidence
from godfit.inference.observation import Observation, Picture
from godfit.inference.settle import Settled
from godfit.models.base import AbstractModel


@dataclass
class Found:
    """Where a fit ended. ``free`` and ``held`` (p,) say what moved and where the rest was held;
    ``opened`` are the coordinates that the picture leaves open, each with those it trades with."""

    model: AbstractModel
    picture: Picture
    seen: Observation
    settled: Settled
    at: Evidence
    free: np.ndarray
    held: np.ndarray
    opened: list[tuple[int, list[int]]]
    inquire: bool = True
    # What may be wrong, and why the answer is not to be believed at all, in words.
    remarks: tuple[str, ...] = ()
    objection: str = ""
    # Of the coordinates (p,), where what was taken as known is a little different.
    shifts: tuple[np.ndarray, ...] = ()
    starts_agreed: tuple[int, int] | None = None
    # What another reading of the images, which explains far more, says was wrong.
    remedy: diagnostics.Suspect | None = None
    # Covariance of the coordinates (p, p), where a known cause of what is left was simulated.
    scatter: np.ndarray | None = None

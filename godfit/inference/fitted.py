"""The result of a search, from which the report is made."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from godfit.inference import diagnostics
from godfit.inference.information import Evidence
from godfit.inference.observation import Observation
from godfit.inference.problem import Problem
from godfit.inference.settle import Settled


@dataclasses.dataclass(frozen=True, eq=False)
class Found:
    """Where a fit ended.

    - ``problem`` was solved on the pixels of ``observation``; ``settled`` is the point, and
      ``evidence`` the likelihood about it.
    - ``opened`` are the coordinates that the picture leaves open, each with those it trades with.
    - ``inquire`` is False where the model is not to be diagnosed.
    - ``remarks`` are sentences with doubts about the model; ``objection`` is a sentence why the
      answer is wrong, or empty.
    - ``shifts`` are changes of the coordinates (p,), each the effect of an error in a quantity that
      was taken as known.
    - ``starts_agreed`` is (agreeing, tried) where other starts were tried.
    - ``remedy`` is another transfer or mask under which the residual is far smaller.
    - ``scatter`` (p, p) is the covariance of the coordinates where it was simulated.
    - ``notes`` are sentences for the user that are no doubts.
    - ``pass_scale`` is the size of the light pass relative to the mask, None without one.
    - ``mask_estimated`` is True where the mask comes from two screenshots.
    """

    problem: Problem
    observation: Observation
    settled: Settled
    evidence: Evidence
    opened: tuple[tuple[int, list[int]], ...] = ()
    inquire: bool = True
    remarks: tuple[str, ...] = ()
    objection: str = ""
    shifts: tuple[np.ndarray, ...] = ()
    starts_agreed: tuple[int, int] | None = None
    remedy: diagnostics.Suspect | None = None
    scatter: np.ndarray | None = None
    notes: tuple[str, ...] = ()
    pass_scale: float | None = None
    mask_estimated: bool = False

    def replaced(self, **fields: Any) -> Found:
        """The same with other ``fields``."""
        return dataclasses.replace(self, **fields)

"""Search strategies by type of model, registered in the rooms that search.

A model does not depend on its search, and ``fitting`` names no model. Each function here is a
generic (``functools.singledispatch`` on its first argument) that a search room extends for its
models.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from godfit.inference.fitted import Found
from godfit.inference.observation import Picture
from godfit.inference.problem import MAX_VALUES, Problem
from godfit.models.base import AbstractModel
from godfit.scenes.scene import Scene

Report = Callable[[str], None]


class Stage(NamedTuple):
    """One stage of a coarse-to-fine search: target and mask are blurred by the share ``blur`` of
    the longer side, the ``keep`` best iterates go on, ``sigma`` is the noise in levels."""

    blur: float
    keep: int
    sigma: float


COARSE_TO_FINE = (
    Stage(1 / 64, 3, 4.0), Stage(1 / 128, 2, 2.0), Stage(1 / 256, 1, 1.0), Stage(1 / 512, 1, 1.0),
)  # fmt: skip
"""The blur is halved until it is a pixel or two of a picture of 512 pixels; by then one start of
several is ahead."""


class Effort(NamedTuple):
    """The effort of a search: whether to ``inquire`` into what may be wrong, and how many values
    (pixels times channels) are fitted; ``report`` is called with a line for every stage.

    ``rival``, where there is one, makes the problem of the same pixels with a light pass of another
    size. It is tried where the first problem leaves more than rounding.
    """

    inquire: bool = True
    max_values: int = MAX_VALUES
    report: Report = lambda text: None
    rival: Callable[[], Problem] | None = None


@functools.singledispatch
def starts(
    model: AbstractModel, picture: Picture, given: dict[str, float], *, keep: int, seed: int
) -> list[np.ndarray]:
    """The ``keep`` best starting points (p,) in the model's coordinates, best first. Parameters in
    ``given`` are held at their values."""
    raise TypeError(f"no starts are registered for {type(model).__name__}")


SEARCH_STARTS = 6
"""Starting points of a search: stages drop those that fall behind, so that more cost little."""


def starting_points(problem: Problem, given: dict[str, float]) -> list[np.ndarray]:
    """The SEARCH_STARTS best starting points (p,) of a problem's search, best first."""
    small = problem.small
    return starts(small.model, small.picture, given, keep=SEARCH_STARTS, seed=problem.seed)


@functools.singledispatch
def stages(model: AbstractModel) -> tuple[Stage, ...]:
    """The coarse-to-fine search that suits the model."""
    return COARSE_TO_FINE


class Open(NamedTuple):
    """A coordinate that no picture determines under this model, by name; those it trades with, and
    a note for the user, "" where the report says it anyway."""

    name: str
    partners: tuple[str, ...] = ()
    note: str = ""


@functools.singledispatch
def left_open(model: AbstractModel, problem: Problem) -> Open | None:
    """The coordinate that no picture determines under this model; None if there is none."""
    return None


@functools.singledispatch
def refined_mask(
    model: AbstractModel, problem: Problem, scene: Scene, given: dict[str, float], report: Report
) -> Picture:
    """The picture of a problem whose mask is drawn from a ``scene``, with that mask refined by the
    target itself."""
    return problem.picture


@functools.singledispatch
def search(
    model: AbstractModel, problem: Problem, given: dict[str, float], effort: Effort
) -> Found:
    """The fit of ``problem`` whose model is ``model``, from parameters ``given`` or from none."""
    raise TypeError(f"no search is registered for {type(model).__name__}")


@functools.singledispatch
def trading(model: AbstractModel) -> tuple[str, ...]:
    """Coordinates in which two iterates of one minimum may differ: they trade with the rest."""
    return ()

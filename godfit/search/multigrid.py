"""From starting points to the neighbourhood of the best fit, on a few thousand pixels.

Coarse to fine: target and mask are blurred by the same amount, the blur is lowered in stages, and
iterates that fall behind are dropped.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from godfit.inference.distinct import distinct
from godfit.inference.observation import Observation, Picture
from godfit.inference.problem import Problem
from godfit.inference.solver import Point, solve
from godfit.inference.strategy import COARSE_TO_FINE, Report, Stage, trading
from godfit.runtime.parallel import parallel_imap

BLURRED_PIXELS = 256
"""Pixels of a blurred stage: neighbours agree there, so that more would add little."""
ALL_STARTS = 6
"""Iterates kept where the sum leaves no bands: all are cheap to follow there, and the best one may
fall behind at first."""
SHARP_SIGMA = 0.3
"""Noise of the last, sharp solve, in levels: about that of rounding to bytes."""
SAME_COST = 0.01
"""Relative difference of costs below which two iterates may be the same."""
SAME_RELATIVE = 0.05
SAME_ABSOLUTE = 0.03
"""Differences of coordinates below which two iterates are the same, relative and absolute."""


def climb(
    problem: Problem,
    starts: list[np.ndarray],
    report: Report,
    *,
    stages: Sequence[Stage] = COARSE_TO_FINE,
    views: Iterable[Observation] = (),
) -> Point:
    """The best of ``starts`` after all stages; ``views`` are the picture's, if they are at hand."""
    views = iter(views or blurred_views(problem.picture, problem.seed, stages))
    size = max(problem.picture.size)
    points = [Point(start, np.inf, False, 0) for start in starts]
    for stage in stages:
        observation = next(views)
        report(f"{len(points)} starts, blur of {stage.blur * size:.1f} pixels")
        points = [
            solve(p.coordinates, problem, observation, stage.sigma, bounded=False) for p in points
        ]
        points.sort(key=lambda p: p.cost)
        points = _distinct(points, problem)[: stage.keep if problem.model.banded else ALL_STARTS]
    (sharp,) = views
    points = [solve(p.coordinates, problem, sharp, SHARP_SIGMA) for p in points]
    return min(points, key=lambda p: p.cost)


def blurred_views(
    picture: Picture, seed: int, stages: Sequence[Stage] = COARSE_TO_FINE
) -> Iterator[Observation]:
    """A few pixels of the picture at the blur of every stage, and the same ones sharp; the next is
    made while one is used."""
    pixels = picture.informative(BLURRED_PIXELS, seed)
    blurs = [stage.blur * max(picture.size) for stage in stages]
    return parallel_imap(lambda blur: picture.observe(pixels, blur), [*blurs, 0.0])


def _distinct(points: list[Point], problem: Problem) -> list[Point]:
    """Points, cheapest first, that have not run into a cheaper one.

    Where coordinates trade, such points agree in cost and in all other coordinates.
    """
    compared = ~np.isin(problem.names, trading(problem.model))

    def same(p: Point, q: Point) -> bool:
        here, there = p.coordinates[compared], q.coordinates[compared]
        alike = np.allclose(here, there, rtol=SAME_RELATIVE, atol=SAME_ABSOLUTE)
        return bool(abs(p.cost - q.cost) < SAME_COST * q.cost) and alike

    return distinct(points, same)

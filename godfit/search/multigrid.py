"""From starting points to the neighbourhood of the best fit, on a few thousand pixels.

Coarse to fine: target and mask are blurred by the same amount, the blur is lowered in steps, and
starts that fall behind are dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from godfit.inference.observation import Observation, Picture
from godfit.inference.solver import Point, solve
from godfit.models.base import AbstractModel
from godfit.runtime.parallel import parallel_imap

# What is blurred needs fewer.
BLURRED_PIXELS = 256
# Blur (as a share of the longer side), starts kept, sigma in levels.
LADDER = ((1 / 64, 3, 4.0), (1 / 128, 2, 2.0), (1 / 256, 1, 1.0), (1 / 512, 1, 1.0))
ALL = 6
# Where starts are good enough: none is blurred.
SHARP = ((0.0, 1, 1.0),)


def climb(
    picture: Picture,
    model: AbstractModel,
    starts: list[np.ndarray],
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
    report: Callable[[str], None],
    ladder: Sequence[tuple[float, int, float]] = LADDER,
    views: Iterable[Observation] = (),
) -> Point:
    """The best of ``starts`` after the ladder of blurs; ``views`` are the picture's, if known."""
    views = iter(views or blurred_views(picture, seed, ladder))
    points = [Point(start, np.inf, False, 0) for start in starts]
    for share, keep, sigma in ladder:
        seen = next(views)
        report(f"{len(points)} starts, blur of {share * max(picture.size):.1f} pixels")
        points = [
            solve(p.coordinates, free, held, model, seen, sigma, bounded=False) for p in points
        ]
        points.sort(key=lambda p: p.cost)
        # Without bands all starts are cheap to follow, and the right one may fall behind at first.
        points = _distinct(points)[: keep if model.banded else ALL]
    (sharp,) = views
    points = [solve(p.coordinates, free, held, model, sharp, 0.3) for p in points]
    return min(points, key=lambda p: p.cost)


def blurred_views(
    picture: Picture, seed: int, ladder: Sequence[tuple[float, int, float]] = LADDER
) -> Iterator[Observation]:
    """A few pixels of the picture for every blur of the ladder, and the same ones sharp; while one
    is used, those to come are made."""
    pixels = picture.informative(BLURRED_PIXELS, seed)
    blurs = [share * max(picture.size) for share, _, _ in ladder]
    return parallel_imap(lambda blur: picture.observe(pixels, blur), [*blurs, 0.0])


def _distinct(points: list[Point]) -> list[Point]:
    """Points, cheapest first, that have not run into a cheaper one; where the picture leaves a
    coordinate open, such points agree in cost and in the places they put the light and density."""
    kept: list[Point] = []
    for p in points:
        if not any(
            abs(p.cost - q.cost) < 0.01 * q.cost
            and np.allclose(p.coordinates[2:], q.coordinates[2:], rtol=0.05, atol=0.03)
            for q in kept
        ):
            kept.append(p)
    return kept

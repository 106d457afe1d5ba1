"""What a finished picture says of its light pass: differences of pixels some way apart.

A difference drops most of the background out. What is left of it is a polynomial of the place, the
steps between its parts, and texture, whose spread is measured.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from godfit.blind import misfit_kernel
from godfit.blind.hypotheses import Hypothesis

NEAREST, FARTHEST = 0.015, 0.15
"""Distance of the two pixels of a pair, as shares of the longer side: nearer, the light hardly
changes; farther, the scene does."""
NEAR_LIGHT = 0.005, 0.08
"""The same for pairs about a light, where its rays change over a few pixels of the copy."""
CORE = 0.05
"""Distance from a light, as a share of the longer side, within which pixels count alike."""
LEAST_SPREAD = 0.5 / 255
"""Least spread of texture: half a level, about what rounding leaves."""
SPREAD_ROUNDS = 4
"""Rounds of weights and coefficients that measure the spread: later ones change it by under 1%."""
DARK_WEIGHT = 0.3
"""Weight of a light that exceeds the picture: the scene would be negative there."""
WIDTHS = np.array([8.0, 3.0, 1.5, 1.0])
"""Widths of the robust misfit, in spreads of the texture, lowered pass by pass."""


class Pairs(NamedTuple):
    """Pixels ``x`` and ``y`` (2, n), in pixels from the left top corner of the copy; the picture's
    ``difference`` (n,); ``side`` (n,) +1 where it is a lower bound, -1 an upper one, 0 where it is
    known; ``most`` (2, n) light that a scene of no negative value allows; differences of what is
    ``free`` (n, p); the ``spread`` of texture; the misfit without light, ``dark``."""

    x: np.ndarray
    y: np.ndarray
    difference: np.ndarray
    side: np.ndarray
    most: np.ndarray
    free: np.ndarray
    spread: float
    dark: float

    def where(self, keep: np.ndarray) -> Pairs:
        """Those pairs that are in ``keep`` (n,)."""
        chosen = self._replace(
            x=self.x[:, keep], y=self.y[:, keep], difference=self.difference[keep],
            side=self.side[keep], most=self.most[:, keep], free=self.free[keep],
        )  # fmt: skip
        return chosen._replace(dark=_dark(chosen))


def drawn(
    hypothesis: Hypothesis, count: int, seed: int, about: tuple[float, float] | None = None
) -> Pairs:
    """``count`` pairs of usable pixels in random directions; fewer where one of both is clipped.

    They may lie ``about`` a place (u, v), as many between any distance from it and its double: most
    of a picture is far from its light, and says little of its place.
    """
    usable = hypothesis.usable | hypothesis.bounded
    h, w = usable.shape
    rows, columns = np.nonzero(usable)
    rng = np.random.default_rng(seed)
    if about is None:
        index = rng.integers(0, len(rows), 4 * count)
    else:
        x, y = columns + 0.5 - about[0] * w, rows + 0.5 - (1 - about[1]) * h
        share = 1 / (x * x + y * y + (CORE * max(h, w)) ** 2)
        index = rng.choice(len(rows), 4 * count, p=share / share.sum())
    away = max(h, w) * rng.uniform(
        *(NEAREST, FARTHEST) if about is None else NEAR_LIGHT, len(index)
    )
    angle = rng.uniform(0, 2 * np.pi, len(index))
    first = rows[index], columns[index]
    second = (
        np.rint(first[0] + away * np.sin(angle)).astype(int),
        np.rint(first[1] + away * np.cos(angle)).astype(int),
    )
    inside = (second[0] >= 0) & (second[0] < h) & (second[1] >= 0) & (second[1] < w)
    kept = np.flatnonzero(inside)
    at = [np.stack([a[kept], b[kept]]) for a, b in zip(first, second, strict=True)]
    bounded = hypothesis.bounded[at[0], at[1]]
    good = usable[at[0][1], at[1][1]] & ~bounded.all(0)
    row, column = (z[:, np.flatnonzero(good)[:count]] for z in at)
    bounded = hypothesis.bounded[row, column]
    values = hypothesis.values[row, column]
    x, y = (column + 0.5) / max(h, w) - 0.5, (row + 0.5) / max(h, w) - 0.5
    free = [x, y, x * x, x * y, y * y, *(step[row, column] for step in hypothesis.steps)]
    pairs = Pairs(
        column + 0.5,
        row + 0.5,
        values[0] - values[1],
        bounded[0].astype(float) - bounded[1],
        hypothesis.ceiling[row, column],
        np.ascontiguousarray(np.stack([z[0] - z[1] for z in free], -1)),
        LEAST_SPREAD,
        0.0,
    )
    # About a light the differences are its own: texture is measured all over the picture.
    spread = _texture(pairs) if about is None else drawn(hypothesis, count, seed).spread
    pairs = pairs._replace(spread=spread)
    return pairs._replace(dark=_dark(pairs))


def _texture(pairs: Pairs) -> float:
    """Median residual of what is free, by weights that fall with the residual."""
    known = pairs.side == 0
    free, goal = pairs.free[known], pairs.difference[known]
    spread, weight = LEAST_SPREAD, np.ones(len(goal))
    for _ in range(SPREAD_ROUNDS):
        root = np.sqrt(weight)
        solved = np.linalg.lstsq(free * root[:, None], goal * root, rcond=None)[0]
        left = goal - free @ solved
        spread = max(float(np.median(np.abs(left), axis=0)) if len(left) else 0, LEAST_SPREAD)
        weight = 1 / (1 + (left / spread) ** 2)
    return spread


def _dark(pairs: Pairs) -> float:
    no_light = np.zeros((0, 2, len(pairs.difference)))
    return misfit_kernel.misfit(
        pairs.free, pairs.difference, pairs.side, no_light, pairs.most, pairs.spread, DARK_WEIGHT,
        WIDTHS,
    )[0]  # fmt: skip


def costs(points: np.ndarray, pairs: Pairs, hypothesis: Hypothesis) -> np.ndarray:
    """(m,) misfits at ``points`` (m, 5) of light x and y, in pixels, attenuation along the ray,
    density and radius, in pixels: per pair, less that without light; below 0 light explains."""
    found, _ = solved(points, pairs, hypothesis)
    return (found - pairs.dark) / len(pairs.difference)


def solved(
    points: np.ndarray, pairs: Pairs, hypothesis: Hypothesis
) -> tuple[np.ndarray, np.ndarray]:
    """The misfits (m,) and the linear coefficients (m, maps + free)."""
    return misfit_kernel.misfits(
        np.ascontiguousarray(points, np.float64), pairs.x, pairs.y, pairs.difference, pairs.side,
        pairs.most, pairs.free, hypothesis.maps, hypothesis.windowed, pairs.spread, DARK_WEIGHT,
        WIDTHS,
    )  # fmt: skip

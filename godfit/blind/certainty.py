"""How well a search knows its numbers: the same minimum on other pixels, and sector by sector."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from godfit.blind.pairs import Pairs, drawn
from godfit.blind.search import FINE_PAIRS, Candidate, climbed, ends, in_pixels, place_of
from godfit.runtime.parallel import parallel_map

SECTORS = 8
"""Sectors about the light that are left out one after the other: an object, or a part of the
background, lies in one or two of them."""
SAME_PLACE = 0.01
"""Distance of the lights of two searches on independent pairs, as a share of the picture, up to
which they agree."""
SURE_COST = -0.1
"""Misfit per pair, less that without light, from which light explains a picture for certain: of 52
real composites none with less was chosen right and sure."""
RAYS_COST = -0.043
"""The same from which there are rays at all: pictures without lie between -.038 and 0."""
LEAST_ERROR = 5e-4
"""Least standard error of a light on the copy, as a share of the picture: a sixth of its pixel,
the error of nearest texels."""


class Certainty(NamedTuple):
    """The ``covariance`` (4, 4) of light u and v, attenuation for each unit of ray, and density;
    how far the lights of two independent searches are apart, ``apart``; whether a number lies
    ``at_end`` of its range."""

    covariance: np.ndarray
    apart: float
    at_end: bool

    @property
    def place_error(self) -> float:
        """The larger standard error of the light's coordinates."""
        return float(np.sqrt(np.diag(self.covariance)[:2].max()))


def certainty(candidate: Candidate, near: tuple[float, float] | None, seed: int) -> Certainty:
    """The jackknife over sectors about the light (Miller, Biometrika 61 (1974), 1), and the
    distance of two minima on pairs that share none."""
    between = ends(near)
    # About the light, where the search refined it so.
    about = candidate.place if candidate.hypothesis.windowed.all() else None
    *chosen, pairs = (
        drawn(candidate.hypothesis, FINE_PAIRS // 2, seed + k, about) for k in (11, 12, 13)
    )
    sector = _sectors(candidate, pairs)
    kept = [sector != k for k in range(SECTORS)]
    chosen += [pairs.where(keep) for keep in kept]
    found = parallel_map(lambda p: climbed(candidate, p, between), chosen)
    apart = max(abs(a - b) for a, b in zip(found[0].place, found[1].place, strict=True))
    values = np.array([_numbers(other) for other in found[2:]])
    spread = values - values.mean(0)
    covariance = spread.T @ spread * (len(values) - 1) / max(len(values), 1)
    covariance += np.diag([(apart / 2) ** 2] * 2 + [0.0] * 2)
    covariance[[0, 1], [0, 1]] = np.maximum(covariance[[0, 1], [0, 1]], LEAST_ERROR**2)
    lower, upper = between
    margin = 0.01 * (upper - lower)
    end = (candidate.point - lower < margin) | (upper - candidate.point < margin)
    # A radius that no map has is no number.
    end[4] &= bool(candidate.hypothesis.windowed.any())
    # Without attenuation is a setting that shaders ship, and no end of what was searched.
    return Certainty(
        covariance, apart, bool(end[[0, 1, 3, 4]].any() or (end[2] and candidate.kappa))
    )


def _numbers(candidate: Candidate) -> np.ndarray:
    point = candidate.point
    return np.array([float(place_of(point[0])), float(place_of(point[1])), point[2], point[3]])


def _sectors(candidate: Candidate, pairs: Pairs) -> np.ndarray:
    """(n,) the sector of every pair's first pixel, of equally many pairs each."""
    light = in_pixels(candidate.point, candidate.hypothesis.values.shape)[0]
    angle = np.arctan2(pairs.y[0] - light[1], pairs.x[0] - light[0])
    rank = np.argsort(np.argsort(angle))
    return rank * SECTORS // len(angle)

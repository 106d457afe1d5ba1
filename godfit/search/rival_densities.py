"""Other densities that a picture does not rule out, as a part of the errors.

Where rays are short, a step between two taps is less than a pixel. Bands are then hidden by
rounding, and the likelihood has a minimum for every band that is nearly as deep as the right one.
The curvature of one of them says nothing of the others. So densities over all of their range are
settled, on a part of the pixels and then on all. One that is likelier takes the fit's place. The
rest are samples of the likelihood's other maxima, and the variance over all of them is that of a
mixture (MacKay, Information Theory, Inference, and Learning Algorithms (2003), section 22.1).
"""

from __future__ import annotations

import math

import numpy as np

from godfit.inference.distinct import distinct
from godfit.inference.fitted import Found
from godfit.inference.information import evidence
from godfit.inference.noise import WITHIN_ROUNDING
from godfit.inference.problem import Problem
from godfit.inference.repeated_values import counted_once
from godfit.inference.settle import Settled, settle
from godfit.runtime.parallel import parallel_map
from godfit.search.density_minima import COMPARED_PIXELS, bands_at
from godfit.search.density_scan import BEYOND_DOUBT, LOWEST_DENSITY, along_valley

FAR_PLACES = 16
"""Densities over the range that are settled: each stands for the bands about it."""
NEAR_BANDS = (-2, -1, 1, 2)
"""Bands next to the fit's own that are settled as well."""
WALKED = 3
"""The likeliest of these densities, next to which more are settled."""
LIKELIER = 0.5
"""Gain in log-likelihood from which another density takes the fit's place."""
ROUNDS = 3
"""Times that densities are tried, at most."""


def with_rivals(found: Found) -> Found:
    """The fit at the likeliest of the densities tried, with ``shifts`` to the others; as it is
    where the picture determines density to less than a band."""
    problem = found.problem
    if not problem.model.banded or found.settled.sigma >= WITHIN_ROUNDING:
        return found
    for left in reversed(range(ROUNDS)):
        along, width, doubtful = bands_at(found.settled, found.evidence, problem)
        if not doubtful:
            return found
        rivals = _rivals(found, along, width)
        best = max(rivals, key=lambda one: one.log_likelihood, default=found.settled)
        if not left or best.log_likelihood < found.settled.log_likelihood + LIKELIER:
            return found.replaced(shifts=(*found.shifts, *_shifts(found, rivals, along, width)))
        found = _moved(found, best)
    return found


def _places(problem: Problem, here: float, along: int, width: float) -> np.ndarray:
    """(n,) densities to settle from."""
    lowest = max(problem.bounds[0][along], LOWEST_DENSITY)
    edges = np.linspace(lowest, problem.bounds[1][along], FAR_PLACES + 1)
    return np.concatenate([here + width * np.array(NEAR_BANDS), (edges[1:] + edges[:-1]) / 2])


def _rivals(found: Found, along: int, width: float) -> list[Settled]:
    """Other minima of the cost in density, on all pixels: those of places over the range, and those
    next to the best of these, which may be a band or two from the right one."""
    problem, own = found.problem, found.settled
    here = float(own.coordinates[along])
    ends = _settled_at(_places(problem, here, along, width), found, along, width)
    best = [float(one.coordinates[along]) for one in ends[:WALKED]]
    # Bands are as much wider as density is larger.
    beside = [z * (1 + width / here * np.array(NEAR_BANDS)) for z in best]
    more = _settled_at(np.concatenate(beside), found, along, width) if beside else []
    return _distinct([*ends, *more], along, width)


def _distinct(ends: list[Settled], along: int, width: float) -> list[Settled]:
    """One of each density, the likeliest first."""

    def same(a: Settled, b: Settled) -> bool:
        return abs(float(a.coordinates[along] - b.coordinates[along])) < width / 2

    return distinct(sorted(ends, key=lambda one: -one.log_likelihood), same)


def _settled_at(places: np.ndarray, found: Found, along: int, width: float) -> list[Settled]:
    """Other minima than the fit's own, from densities ``places`` (n,), on all pixels."""
    problem, own = found.problem, found.settled
    starts = along_valley(own.coordinates, places, problem, along)
    some = problem.observe(COMPARED_PIXELS)
    here, *there = parallel_map(lambda z: settle(z, problem, some)[0], [own.coordinates, *starts])
    near = [one for one in there if one.log_likelihood > here.log_likelihood - BEYOND_DOUBT]
    near = _distinct(near, along, width)
    ends = [settle(one.coordinates, problem, found.observation)[0] for one in near]
    there = float(own.coordinates[along])
    ends = _distinct(ends, along, width)
    return [one for one in ends if abs(float(one.coordinates[along]) - there) >= width / 2]


def _moved(found: Found, to: Settled) -> Found:
    """The fit with another density."""
    problem = found.problem
    settled, tangent, counted = counted_once(to.coordinates, problem, found.observation, [])
    at = evidence(settled, tangent, counted).thinned(problem.picture.repeats)
    return found.replaced(settled=settled, evidence=at, observation=counted)


def _shifts(found: Found, rivals: list[Settled], along: int, width: float) -> list[np.ndarray]:
    """Changes of the coordinates to each of the ``rivals``, whose squares add to the mixture's
    variance about the fit."""
    problem, own = found.problem, found.settled
    span = problem.bounds[1][along] - max(problem.bounds[0][along], LOWEST_DENSITY)
    bands = max(span / FAR_PLACES / width, 1.0)
    reach = (max(NEAR_BANDS) + 0.5) * width
    weights = [
        math.exp(min(one.log_likelihood - own.log_likelihood, 0.0))
        * (1.0 if abs(one.coordinates[along] - own.coordinates[along]) < reach else bands)
        for one in rivals
    ]
    whole = 1 + sum(weights)
    return [
        math.sqrt(weight / whole) * (one.coordinates - own.coordinates).astype(np.float64)
        for weight, one in zip(weights, rivals, strict=True)
    ]

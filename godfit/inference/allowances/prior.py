"""What is known of parameters beforehand: a Gaussian row of the likelihood for each.

A prior of a parameter with mean v and standard deviation s adds -((value - v) / s)^2 / 2 to the
log-likelihood, as a measurement of it would. On a model's tangent it is a row beside those of the
pixels (Bayesian regression: Gelman et al., Bayesian Data Analysis, 3rd ed., section 14.8).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from godfit.errors import InputError, shown
from godfit.inference.evaluate import parameters_at
from godfit.models.base import AbstractModel

Prior = Mapping[str, tuple[float, float]]
"""Mean and standard deviation of parameters, by name, in their own units."""


class PriorRows(NamedTuple):
    """The priors about a point: ``excess`` (k,), how far each value lies above its mean, and its
    ``slopes`` (k, p) by coordinates over their scales, both in standard deviations of the prior."""

    excess: np.ndarray
    slopes: np.ndarray

    def moved(self, step: np.ndarray) -> PriorRows:
        """The rows at a ``step`` (p,) in coordinates over their scales."""
        return self._replace(excess=self.excess + self.slopes @ step)

    @property
    def log_density(self) -> float:
        """The logarithm of the priors' density, up to a constant."""
        return -0.5 * float(self.excess @ self.excess)

    @property
    def slope(self) -> np.ndarray:
        """(p,) slope of the log-density."""
        return -self.excess @ self.slopes

    @property
    def information(self) -> np.ndarray:
        """(p, p) curvature of the log-density."""
        return self.slopes.T @ self.slopes


def prior_rows(
    prior: Prior, model: AbstractModel, held: np.ndarray, coordinates: np.ndarray, scale: np.ndarray
) -> PriorRows | None:
    """The rows at ``coordinates`` (p,) with ``scale`` (p,); None where no parameter of the model
    has a prior."""
    names = list(model.parameters)
    if not any(name in names for name in prior):
        return None
    values, by_coordinate = parameters_at(model, coordinates, held)
    slopes = np.asarray(by_coordinate, np.float64) * np.asarray(scale, np.float64)
    return rows_of(prior, names, values, slopes)


def rows_of(prior: Prior, names: list[str], values: Any, slopes: Any) -> PriorRows | None:
    """The rows at the ``values`` (p,) of the parameters ``names``, with their ``slopes`` (p, p) by
    coordinates over their scales; None where none of them has a prior."""
    known = [name for name in prior if name in names]
    if not known:
        return None
    at = [names.index(name) for name in known]
    means, sigmas = np.array([prior[name] for name in known], np.float64).T
    excess = np.asarray(values, np.float64)[at] - means
    return PriorRows(excess / sigmas, np.asarray(slopes, np.float64)[at] / sigmas[:, None])


def checked_prior(prior: Any, model: AbstractModel, held: np.ndarray) -> Prior:
    """The priors as pairs of floats. Raises InputError for that of a parameter that the model does
    not fit, and for what is no pair of numbers."""
    try:
        pairs = {str(name): (float(mean), float(sigma)) for name, (mean, sigma) in prior.items()}
    except (AttributeError, TypeError, ValueError):
        raise InputError(
            f"prior: expected a mean and a standard deviation by name, got {shown(prior)}"
        ) from None
    names = list(model.parameters)
    free = [n for n, on, at in zip(names, model.used, held, strict=True) if on and np.isnan(at)]
    for name, (mean, sigma) in pairs.items():
        if name not in free:
            raise InputError(
                f"prior: expected a parameter that is fitted, one of {', '.join(free)}, got "
                f"'{name}'"
            )
        if not (math.isfinite(mean) and math.isfinite(sigma) and sigma > 0):
            raise InputError(
                f"prior: expected {name}=VALUE+-SIGMA with finite numbers and a SIGMA above 0, got "
                f"{mean:g}+-{sigma:g}"
            )
    return pairs

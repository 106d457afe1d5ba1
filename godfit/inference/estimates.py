"""From coordinates and their covariance to parameters with errors, and sentences on open ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from godfit.inference.evaluate import model_at, parameters_at
from godfit.models.base import AbstractModel


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A parameter's value; ``stderr`` is None where it is fixed or not determined. ``interval`` is
    the 95% interval of its profile likelihood, ``posterior`` the middle 95% of the posterior; both
    are None where they were not computed.

    >>> import godfit
    >>> godfit.Estimate(value=0.8, stderr=0.01)
    Estimate(value=0.8, stderr=0.01, fixed=False, at_bound=False, interval=None, posterior=None)
    """

    value: float
    stderr: float | None
    fixed: bool = False
    at_bound: bool = False
    interval: tuple[float, float] | None = None
    posterior: tuple[float, float] | None = None


class Estimates(NamedTuple):
    """The ``model`` at its parameters, these with their errors, their product
    (``combined``), ``covariance`` (p, p) of the parameters (NaN where not known), sentences on the
    ``undetermined`` ones, ``held`` (p,), NaN where free, and the derivatives ``slopes`` (p, p) of
    the parameters by the coordinates."""

    model: AbstractModel
    params: dict[str, Estimate]
    combined: dict[str, Estimate]
    covariance: np.ndarray
    undetermined: tuple[str, ...]
    held: np.ndarray
    slopes: np.ndarray


class Solution(NamedTuple):
    """Coordinates (p,) with their covariance (p, p), zero for those that are not free; ``free``
    and ``held`` as in ``Problem``, ``opened`` as in ``Found``."""

    coordinates: np.ndarray
    covariance: np.ndarray
    free: np.ndarray
    held: np.ndarray
    opened: Sequence[tuple[int, list[int]]]


def estimates(model: AbstractModel, solution: Solution, used: np.ndarray) -> Estimates:
    """The parameters of ``model`` at a ``solution``; only those in ``used`` (p,) are reported."""
    coordinates, spread, free, held, open_ = solution
    names = list(model.parameters)
    opened = [i for i, _ in open_]
    z = np.where(np.isnan(held), coordinates, held)
    z = np.where(np.isin(np.arange(len(names)), opened), z, coordinates)
    # An open parameter was held only by default, so that its own effect is not known either.
    loose = np.where(np.isin(np.arange(len(names)), opened), np.nan, held).astype(np.float32)
    z = z.astype(np.float32)
    fitted = model_at(z, loose, model)
    values, by_coordinate = parameters_at(model, z, loose)
    values, by_coordinate = np.asarray(values), np.asarray(by_coordinate, np.float64)
    covariance = by_coordinate @ spread @ by_coordinate.T
    combined = _combined(model.product, names, opened, values, covariance)
    # A parameter that an open coordinate would change is not known, however well the rest is.
    follows = np.count_nonzero(by_coordinate[:, opened], axis=1) > 0
    unknown = follows | np.isin(np.arange(len(names)), opened) | (np.diag(covariance) <= 0)
    stderr = np.sqrt(np.where(unknown, np.nan, np.diag(covariance)))
    covariance[unknown] = covariance[:, unknown] = np.nan
    lower, upper = (np.asarray(b, np.float32) for b in model.bounds())
    # A value within its error of a bound counts as on it.
    error = np.sqrt(np.diag(spread))
    at_bound = (coordinates - lower <= error) | (upper - coordinates <= error)
    params = {
        name: Estimate(
            float(values[i]),
            None if unknown[i] else float(stderr[i]),
            fixed=bool(not np.isnan(held[i]) and i not in opened),
            at_bound=bool(free[i] and at_bound[i] and not follows[i]),
        )
        for i, name in enumerate(names)
        if used[i]
    }
    undetermined = _sentences(open_, names, values, combined)
    at = held_at(held, opened, values)
    return Estimates(fitted, params, combined, covariance, undetermined, at, by_coordinate)


def held_at(held: np.ndarray, opened: list[int], values: np.ndarray) -> np.ndarray:
    """(p,) values at which parameters are held, the open ones included; NaN where free."""
    return np.where(np.isin(np.arange(len(held)), opened), values, held).astype(np.float32)


def _combined(
    product: tuple[str, str],
    names: list[str],
    opened: list[int],
    values: np.ndarray,
    covariance: np.ndarray,
) -> dict[str, Estimate]:
    """The product, by name. It is also known where one factor is open: from the other one,
    estimated with the open one held."""
    if not set(product) <= set(names):
        return {}
    pair = [names.index(name) for name in product]
    slope = values[pair[::-1]]
    variance = float(slope @ covariance[np.ix_(pair, pair)] @ slope)
    known = variance > 0 and pair[1] not in opened
    stderr = float(np.sqrt(variance)) if known else None
    return {"*".join(product): Estimate(float(np.prod(values[pair])), stderr)}


def _sentences(
    open_: Sequence[tuple[int, list[int]]],
    names: list[str],
    values: np.ndarray,
    combined: dict[str, Estimate],
) -> tuple[str, ...]:
    """A sentence for each group of parameters that is open."""
    opened = [index for index, _ in open_]
    sentences, alone = [], []
    for index, partners in open_:
        rest = [names[i] for i in partners if i not in opened]
        both = [(n, e) for n, e in combined.items() if n.startswith(f"{names[index]}*")]
        if both and both[0][1].stderr is not None:
            name, e = both[0]
            sentences.append(f"only {name} is determined ({e.value:.6g} +- {e.stderr:.2g})")
        elif rest:
            together = " and ".join([names[index], *rest])
            sentences.append(f"only a combination of {together} is determined")
        else:
            alone.append(index)
            continue
        sentences[-1] += f"; {names[index]} was held at {values[index]:.6g}"
    if alone:
        held = ", ".join(f"{names[i]} (held at {values[i]:.6g})" for i in alone)
        sentences.append(f"not determined by this picture: {held}")
    return tuple(sentences)

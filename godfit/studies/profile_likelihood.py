"""Profile likelihood: the interval of one parameter that the picture does not exclude.

The parameter is held at a value and all the others, the noise among them, are fitted again. The 95%
interval is where twice the log-likelihood has fallen by less than 3.84, the quantile of chi-squared
(Wilks 1938; Venzon & Moolgavkar, Applied Statistics 37 (1988), 87). It need not be symmetric. It
ends at the parameter's own bound where the likelihood has not fallen that far, as at decay = 1.

Where values share noise, the fall is divided by what that adds to the parameter's variance
(Rotnitzky & Jewell, Biometrika 77 (1990), 485).

The likelihood is profiled on the model's tangent, rendered once. Where noise makes the interval so
wide that the tangent may be wrong at its ends, they are corrected with the model itself.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.errors import LIKELIHOOD_INCOMPLETE, InputError
from godfit.inference.allowances.arithmetic import with_arithmetic
from godfit.inference.allowances.prior import PriorRows, rows_of
from godfit.inference.information import evidence
from godfit.inference.noise import WITHIN_ROUNDING
from godfit.inference.observation import Observation
from godfit.inference.problem import pixels_used
from godfit.inference.repeated_values import relieved
from godfit.inference.settle import Settled, aim, settle
from godfit.inference.solver import Tangent
from godfit.models.base import AbstractModel, Vector
from godfit.report.result import FitResult
from godfit.runtime.guest import as_guest

ROOT_CHI_SQUARED_95 = 1.959964
"""Root of 3.84, the 95% quantile of chi-squared with one degree of freedom."""
ROOT_TOLERANCE = 0.02
"""Error of the root of the fall in log-likelihood at an end: a hundredth of the interval."""
TANGENT_TRIES = 12
"""Values at which the tangent's likelihood is profiled to find an end, at most."""
RENDERED_TRIES = 5
"""Values at which the model's likelihood is profiled to correct an end, at most: each renders."""
LARGEST_KAPPA = 1e4
"""Attenuation that stands for that of decay = 0, which is infinite."""
LEAST_PART = 0.02
"""Share of a bracket that a new value keeps from either end: both must come nearer."""

Fall = Callable[[float], float]


def profile(result: FitResult, name: str) -> FitResult:
    """``result`` with the 95% profile interval of the parameter ``name``, in its own unit.

    Raises InputError for a parameter that is not fitted, or not determined by the picture.
    """
    with as_guest():
        interval = _interval(result, name)
    params = result.params | {name: dataclasses.replace(result.params[name], interval=interval)}
    return dataclasses.replace(result, params=params)


def check(result: FitResult, name: str) -> None:
    """Raise InputError for a parameter that has no interval."""
    if result.picture.foreign:
        raise InputError("profile: expected a fit with a mask or a scene, got neither; give one")
    if result.simulated:
        raise InputError(LIKELIHOOD_INCOMPLETE.format("profile"))
    if name not in result.params:
        raise InputError(f"profile: expected one of {', '.join(result.params)}, got '{name}'")
    if result.params[name].fixed:
        raise InputError(f"profile: expected a parameter that is fitted, got '{name}', held")
    if result.params[name].stderr is None:
        raise InputError(
            f"profile: expected a parameter that the picture determines, got '{name}'; "
            "hold one that it trades with (--fix)"
        )


def _interval(result: FitResult, name: str) -> tuple[float, float]:
    check(result, name)
    model, picture = result.model, result.picture
    index = list(model.parameters).index(name)
    row, best = model.parameters[name], result.params[name].value
    observation = picture.observe(pixels_used(picture, result.seed))
    line = _ProfileLine(result, observation, index)
    # The pixels of an upsampled pass share its texels.
    share = picture.independent(model) / line.growth
    low, high = (
        _end(line.on_tangent, best, way * line.stderr, bound, share, TANGENT_TRIES)
        for way, bound in ((-1, row.lower), (1, row.upper))
    )
    if result.noise_levels > WITHIN_ROUNDING:
        low, high = (
            _end(line.rendered, best, end - best, bound, share, RENDERED_TRIES)
            for end, bound in ((low, row.lower), (high, row.upper))
        )
    return low, high


def _end(
    likelihood: Fall, best: float, step: float, bound: float, share: float, tries: int
) -> float:
    """The value at which the root of twice the fall in log-likelihood from its top, at ``best``, is
    ROOT_CHI_SQUARED_95. ``step`` is a first guess of the distance, with its sign. That root is
    nearly a straight line."""

    if step == 0:
        return best
    top = likelihood(best)
    inner, outer = (0.0, 0.0), None
    value = _inside(best + step, bound, step)
    for _ in range(tries):
        fall = 2 * share * (top - likelihood(value))
        root = math.copysign(math.sqrt(abs(fall)), fall)
        distance = abs(value - best)
        if abs(root - ROOT_CHI_SQUARED_95) < ROOT_TOLERANCE or (
            value == bound and root < ROOT_CHI_SQUARED_95
        ):
            break
        if root < ROOT_CHI_SQUARED_95:
            inner = (distance, max(root, 0.0))
        else:
            outer = (distance, root)
        if outer is None:
            slope = (inner[1] or 0.3 * ROOT_CHI_SQUARED_95) / max(inner[0], 1e-30)
            distance = min(ROOT_CHI_SQUARED_95 / slope, 4 * inner[0]) if inner[0] else 2 * distance
        else:
            part = (ROOT_CHI_SQUARED_95 - inner[1]) / (outer[1] - inner[1])
            # A new value keeps its distance from either end, so that both come nearer.
            part = min(max(part, LEAST_PART), 1 - LEAST_PART)
            distance = inner[0] + part * (outer[0] - inner[0])
        value = _inside(best + math.copysign(distance, step), bound, step)
    return value


def _inside(value: float, bound: float, step: float) -> float:
    return min(value, bound) if step > 0 else max(value, bound)


@eqx.filter_jit
def _linearise(
    at: Vector,
    held: Vector,
    index: int,
    scale: Vector,
    model: AbstractModel,
    observation: Observation,
) -> tuple[Float[Array, " m"], Float[Array, "p m"]]:
    """Levels and their derivatives by ``at`` over ``scale``, where entry ``index`` of ``at`` is
    the parameter itself and the others are coordinates, which it leaves as they are."""

    def predict(y):
        return observation.predict(_on_line(y * scale, held, index, model))

    y = at / scale
    move = functools.partial(jax.jvp, predict, (y,))
    return jax.vmap(move, out_axes=(None, 0))((jnp.eye(y.shape[0], dtype=y.dtype),))


def _on_line(at: Vector, held: Vector, index: int, model: AbstractModel) -> AbstractModel:
    """The model at ``at`` (p,), whose entry ``index`` is the parameter itself."""
    return model.moved(at, jnp.asarray(held).at[index].set(at[index]))


@eqx.filter_jit
def _parameters(
    at: Vector, held: Vector, index: int, scale: Vector, model: AbstractModel
) -> tuple[Vector, Float[Array, "p p"]]:
    """The parameters (p,), and their derivatives (p, p) by ``at`` over ``scale``."""

    def values(y):
        return jnp.stack(list(_on_line(y * scale, held, index, model).values().values()))

    return values(at / scale), jax.jacfwd(values)(at / scale)


class _ProfileLine:
    """The fits of largest likelihood along a line: one parameter is held at each value."""

    def __init__(self, result: FitResult, observation: Observation, index: int) -> None:
        self.index = index
        self.others = result.free & (np.arange(len(result.free)) != index)
        self.problem = result.problem.replaced(free=self.others)
        z = np.asarray(result.model.coordinates(), np.float32)
        # decay = 0 has no finite coordinate; nothing else moves it.
        z = np.nan_to_num(z, posinf=LARGEST_KAPPA)
        self.best = float(list(result.model.values().values())[index])
        at = z.copy()
        scale = result.model.scales(z)
        scale[index] = 0.1 * abs(self.best) + 1e-3
        z[index] = self.best
        prediction, jacobian = _linearise(z, result.held, index, scale, result.model, observation)
        self.held, self.scale = result.held, scale
        rows = self._priors(z)
        self.tangent = Tangent(np.asarray(prediction), np.asarray(jacobian), scale, rows)
        observation = with_arithmetic(observation, result.problem, at)
        self.observation = observation = relieved(
            observation, self.tangent.prediction, result.noise_levels
        )
        self.at = Settled(z, result.noise_levels, -np.inf, True)
        moving = self.others | (np.arange(len(z)) == index)
        at_best = evidence(self.at, self.tangent, observation)
        covariance = at_best.covariance(moving)
        alone = at_best.without_shared_noise().covariance(moving)[index, index]
        self.growth = float(covariance[index, index] / alone) if alone > 0 else 1.0
        variance = max(float(covariance[index, index]), 1e-24)
        self.stderr = ROOT_CHI_SQUARED_95 * math.sqrt(variance)
        self.follow = np.where(self.others, covariance[:, index] / variance, 0.0)
        self.found: dict[float, Settled] = {}

    def _priors(self, at: np.ndarray) -> PriorRows | None:
        """The rows of the fit's priors at ``at`` (p,), with the parameter itself at its place."""
        prior, model = self.problem.prior, self.problem.model
        if not prior:
            return None
        values, slopes = _parameters(at, self.held, self.index, self.scale, model)
        return rows_of(prior, self.problem.names, values, slopes)

    def _settled(self, value: float) -> Settled:
        """On the tangent, the best fit with the parameter at ``value``."""
        if value not in self.found:
            z, by = self.at.coordinates, value - self.best
            bounds = self.problem.bounds
            start = np.where(self.others, np.clip(z + by * self.follow, *bounds), z)
            start[self.index] = value
            start = start.astype(np.float32)
            # In double precision: errors can be finer than float32 holds the value.
            step = np.where(self.others, start.astype(np.float64) - z, 0.0)
            step[self.index] = by
            # The parameters are no straight lines over as wide a step as a prior allows.
            moved = self.tangent.shifted(step)._replace(prior=self._priors(start))
            begun = self.at._replace(coordinates=start)
            self.found[value] = aim(begun, moved, self.problem, self.observation)[0]
        return self.found[value]

    def on_tangent(self, value: float) -> float:
        """Log-likelihood, profiled on the tangent."""
        return self._settled(value).log_likelihood

    def rendered(self, value: float) -> float:
        """Log-likelihood, profiled with the model itself."""
        held = self.problem.held.copy()
        held[self.index] = value
        start = self._settled(value).coordinates
        settled, _ = settle(start, self.problem.replaced(held=held), self.observation)
        return settled.log_likelihood

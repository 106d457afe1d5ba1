"""One nonlinear least-squares solve: optimistix on deviance residuals, bounds by an active set."""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from godfit.inference.allowances.prior import PriorRows, prior_rows
from godfit.inference.likelihood import deviance_residuals, interval
from godfit.inference.noise import noise_of
from godfit.inference.observation import Observation
from godfit.inference.problem import Problem
from godfit.models.base import AbstractModel, Values, Vector
from godfit.runtime.blas import one_thread
from godfit.runtime.device import on_device
from godfit.runtime.program_cache import cached_jit

Switches = Bool[Array, " p"] | Bool[np.ndarray, " p"]
"""Which coordinates move."""

Scalar = Float[Array, ""] | np.float32

MAX_ACTIVE_SET_ROUNDS = 6
"""Solves with another set of coordinates on their bounds, at most, lest they go in circles."""
MAX_STEPS = 12
"""Steps of Levenberg-Marquardt, at most: they limit the time that a poor start takes."""
SOLVER_RTOL = 1e-5
"""Relative change of coordinates and deviance at which a solve ends: near the error of float32."""
MAX_TANGENT_STEPS = 60
"""Newton steps on a tangent, at most: a limit for likelihoods that are nearly flat."""
TANGENT_GAIN = 1e-2
"""Gain in log-likelihood below which no further step is taken on a tangent: a tenth of a standard
error is 5e-3."""
FIRST_DAMPING = 1e-2
"""Damping of the first Newton step on a tangent, relative to least squares."""
LEAST_DAMPING = 1e-6
"""Damping that later steps fall to, at least: the matrix stays invertible in double precision."""
STRAIGHT_GAIN = 0.7
"""Share of the gain that the slope promises from which a step met no curvature: a whole Newton step
gains half of it."""


class Point(NamedTuple):
    """Where a solve ended: coordinates (p,), half the deviance there, whether the solver
    terminated by itself, and how many steps it took."""

    coordinates: np.ndarray
    cost: float
    settled: bool
    steps: int


class Stop(NamedTuple):
    """When a solve stops: once no step changes coordinates (in their scales) or deviance by more
    than a share of ``rtol``, or after ``steps``."""

    rtol: float = SOLVER_RTOL
    steps: int = MAX_STEPS


class Tangent(NamedTuple):
    """The model about a point: levels (m,), derivatives (p, m) by coordinates over ``scale``, and
    the rows of priors, None without any. Of a model that ``jumps``, it holds on average alone."""

    prediction: np.ndarray
    jacobian: np.ndarray
    scale: np.ndarray
    prior: PriorRows | None = None
    jumps: bool = False

    def only(self, rows: np.ndarray) -> Tangent:
        """The tangent of some of the levels."""
        return self._replace(prediction=self.prediction[rows], jacobian=self.jacobian[:, rows])

    def at(self, by: np.ndarray, prediction: np.ndarray) -> Tangent:
        """The tangent at coordinates that differ ``by`` (p,), where the levels are ``prediction``
        (m,)."""
        prior = None if self.prior is None else self.prior.moved(by / self.scale)
        return self._replace(prediction=prediction, prior=prior)

    def shifted(self, by: np.ndarray) -> Tangent:
        """The tangent at coordinates that differ ``by`` (p,)."""
        return self.at(by, self.moved(by))

    @property
    def log_prior(self) -> float:
        """The logarithm of the priors' density at the point, 0 without any."""
        return 0.0 if self.prior is None else self.prior.log_density

    def moved(self, by: np.ndarray) -> np.ndarray:
        """(m,) levels at coordinates that differ ``by`` (p,)."""
        step = np.asarray(by / self.scale, np.float32)
        return np.asarray(_along(self.prediction, self.jacobian, step))


class Intervals(NamedTuple):
    """Bounds ``lo`` (m,) and ``hi`` (m,) of values in levels, the share ``foreign`` of them that
    may have any level, and each value's ``own_noise`` (m,) in levels, None without."""

    lo: Values
    hi: Values
    foreign: float = 0.0
    own_noise: Values | None = None


def tangent_at(coordinates: np.ndarray, problem: Problem, observation: Observation) -> Tangent:
    """The tangent at a point: every pixel is rendered, with its derivatives."""
    scale = problem.model.scales(coordinates)
    # Noise has no part in a rendering, and would make another program of it.
    plain = observation.with_noise(None)
    prediction, jacobian = linearise(coordinates, problem.held, scale, problem.model, plain)
    prior = prior_rows(problem.prior, problem.model, problem.held, coordinates, scale)
    jumps = problem.model.jumps
    return Tangent(np.asarray(prediction), np.asarray(jacobian), scale, prior, jumps)


@cached_jit
def _along(prediction, jacobian, step):
    # XLA's product: BLAS in numpy keeps a core busy, waiting, long after it is done.
    return prediction + step @ jacobian


@cached_jit
def _least_squares(
    start: Vector,
    moving: tuple[Switches, Vector, Vector],
    model: AbstractModel,
    observation: Observation,
    sigma: Scalar,
    stop: Stop,
):
    import lineax as lx
    import optimistix as optx

    free, held, scale = moving
    lo, hi, foreign = observation.lo, observation.hi, observation.foreign

    def residuals(y, _):
        at = model.moved(jnp.where(free, y * scale, start), held)
        return share * deviance_residuals(observation.predict(at), lo, hi, sigma, foreign)

    # Residuals of order one in sum make the solver's first damping, 1, mean something: it starts
    # between the gradient and the Newton step instead of leaping.
    share = lo.shape[0] ** -0.5
    rtol = stop.rtol
    solver = optx.LevenbergMarquardt(rtol=rtol, atol=rtol / 10, linear_solver=lx.QR())
    solution = optx.least_squares(
        residuals, solver, start / scale, max_steps=stop.steps, throw=False
    )
    coordinates = jnp.where(free, solution.value * scale, start)
    cost = 0.5 * jnp.sum((solution.state.f_info.residual / share) ** 2)
    settled = solution.result == optx.RESULTS.successful
    return coordinates, cost, settled, solution.stats["num_steps"]


@cached_jit
def linearise(
    coordinates: Vector,
    held: Vector,
    scale: Vector,
    model: AbstractModel,
    observation: Observation,
) -> tuple[Float[Array, " m"], Float[Array, "p m"]]:
    """Predicted levels and, a row for each, their derivatives by the coordinates divided by
    ``scale``."""

    def predict(y):
        return observation.predict(model.moved(y * scale, held))

    y = coordinates / scale
    move = functools.partial(jax.jvp, predict, (y,))
    return jax.vmap(move, out_axes=(None, 0))((jnp.eye(y.shape[0], dtype=y.dtype),))


@cached_jit
def _on_tangent(
    step: Vector,
    prediction: Values,
    jacobian: Float[Array, "p m"] | Float[np.ndarray, "p m"],
    intervals: Intervals,
    sigma: Scalar,
) -> Float[Array, "p+2 p"]:
    """Log-likelihood with the model replaced by its tangent (first of the first row), slope by
    ``step`` (second row) and curvature."""
    jacobian = jnp.asarray(jacobian)
    levels = jnp.asarray(prediction) + step @ jacobian
    low, high = (jnp.asarray(z) - levels for z in (intervals.lo, intervals.hi))
    noise = noise_of(sigma, intervals.own_noise)
    pixel = interval(low / noise, high / noise, intervals.foreign)
    curvature = (jacobian * (pixel.curvature / noise**2)[None]) @ jacobian.T
    slope = jacobian @ (pixel.slope / noise)
    # In one array: each transfer to the host takes as long as the computation.
    return jnp.concatenate([jnp.full_like(slope, pixel.log.sum())[None], slope[None], curvature])


@cached_jit
def _gram(jacobian):
    return jacobian @ jacobian.T


STOP = Stop()


def solve(
    start: np.ndarray,
    problem: Problem,
    observation: Observation,
    sigma: float,
    *,
    bounded: bool = True,
    stop: Stop = STOP,
) -> Point:
    """Minimise the deviance over the free coordinates from ``start`` (p,), at a noise of ``sigma``
    levels.

    The solution lies inside the problem's bounds. Far from the answer bounds can be switched off: a
    path may lead outside, where the sum is as smooth.
    """
    model, held = problem.model, problem.held

    def run(z, free):
        moving = free, held, model.scales(z)
        with one_thread():
            found = _least_squares(z, moving, model, observation, np.float32(sigma), stop)
            # JAX returns before the computation is done.
            return jax.block_until_ready(found)

    if not bounded:
        value, cost, settled, steps = run(start, problem.free)
        sound = np.isfinite(value).all() and np.isfinite(cost)
        return Point(np.asarray(value), float(cost) if sound else np.inf, bool(settled), int(steps))

    def slope(z):
        levels, jacobian = linearise(z, held, np.ones_like(z), model, observation)
        intervals = Intervals(observation.lo, observation.hi, observation.foreign)
        return _slope(levels, jacobian, intervals, np.float32(sigma))

    return _inside(start, problem, run, slope)


def solve_tangent(
    start: np.ndarray, problem: Problem, tangent: Tangent, intervals: Intervals, sigma: float
) -> Point:
    """The coordinates of largest likelihood inside the bounds on the ``tangent`` at ``start``.
    This is a concave problem in a few unknowns.

    Newton's method is damped by the matrix of least squares, as the likelihood is flat inside the
    intervals and steep outside. It is projected onto the bounds: a coordinate on its bound with a
    slope outwards stays there (Bertsekas, SIAM J. Control Optim. 20 (1982), 221).
    """
    prediction, jacobian, scale, prior, _ = tangent
    lo, hi, foreign, own_noise = intervals
    free = problem.free
    levels, slopes, lower_ends, upper_ends = (on_device(z) for z in (prediction, jacobian, lo, hi))
    own_noise = None if own_noise is None else on_device(own_noise)
    walls = Intervals(lower_ends, upper_ends, foreign, own_noise)
    values = levels, slopes, walls, np.float32(sigma)
    bounds = [np.asarray(b, np.float64) for b in problem.bounds]
    lower, upper = ((b - start) / scale for b in bounds)
    width = np.asarray(hi) - np.asarray(lo)
    rounding = width[np.isfinite(width)].max(initial=0) ** 2 / 12
    # The identity on top holds coordinates that the picture does not determine.
    least_squares = np.asarray(_gram(slopes), np.float64) / (sigma**2 + rounding)
    if prior is not None:
        least_squares += prior.information
    regular, size = 1.0, np.sqrt(np.diag(least_squares) + 1)

    def at(step):
        found = _on_tangent(step.astype(np.float32), *values)
        found = np.asarray(found, np.float64)
        if prior is None:
            return found[0, 0], found[1], found[2:]
        row = prior.moved(step)
        return found[0, 0] + row.log_density, found[1] + row.slope, found[2:] + row.information

    step, damping, settled, steps = np.zeros(len(start)), FIRST_DAMPING, False, 0
    likelihood, slope, curvature = at(step)
    if not all(np.isfinite(z).all() for z in (likelihood, slope, curvature, least_squares)):
        return Point(start, np.inf, False, 0)
    while steps < MAX_TANGENT_STEPS and not settled:
        steps += 1
        held = ((step <= lower) & (slope < 0)) | ((step >= upper) & (slope > 0))
        moving = np.flatnonzero(free & ~held)
        if not len(moving):
            settled = True
            break
        damped = curvature + damping * least_squares + regular * np.eye(len(start))
        damped /= np.outer(size, size)
        move = np.zeros(len(start))
        pull = slope[moving] / size[moving]
        move[moving] = np.linalg.solve(damped[np.ix_(moving, moving)], pull) / size[moving]
        trial = np.clip(step + move, lower, upper)
        promised = float(slope @ (trial - step))
        found = at(trial)
        if found[0] >= likelihood:
            if found[0] - likelihood > STRAIGHT_GAIN * promised:
                # The step met no curvature: the regularisation ended it, and is reduced.
                regular /= 10
            step, (likelihood, slope, curvature) = trial, found
            damping = max(damping / 10, LEAST_DAMPING)
        else:
            damping = 4 * damping
        settled = promised < TANGENT_GAIN
    z = np.clip(start + step * scale, *bounds)
    return Point(z.astype(np.float32), -float(likelihood), settled, steps)


@cached_jit
def _slope(prediction, jacobian, intervals, sigma):
    lo, hi, foreign, own_noise = intervals
    noise = noise_of(sigma, own_noise)
    pixel = interval((lo - prediction) / noise, (hi - prediction) / noise, foreign)
    return -jacobian @ (pixel.slope / noise)


def _inside(start, problem, run, slope) -> Point:
    """``run`` repeatedly with fewer or more coordinates moving, until all are in bounds.

    A coordinate that a run takes out of its bounds is put on the bound and stays there for the next
    run. A true value can lie *on* a bound, which a sigmoid could never reach.
    """
    free, (lower, upper) = problem.free, problem.bounds

    def inward(z, among):
        falls = np.asarray(slope(z)) if among.any() else np.zeros_like(z)
        return among & (((z <= lower) & (falls < 0)) | ((z >= upper) & (falls > 0)))

    z = np.clip(np.asarray(start, np.float32), lower, upper)
    # A coordinate on its bound that would leave it at once is held from the start.
    bound = free & ((z <= lower) | (z >= upper))
    moving = free & (~bound | inward(z, bound))
    released, steps = False, 0
    for _ in range(MAX_ACTIVE_SET_ROUNDS):
        value, cost, settled, taken = run(z, moving)
        steps += int(taken)
        moved = np.asarray(value)
        if not np.isfinite(moved).all() or not np.isfinite(float(cost)):
            return Point(z, float("inf"), False, steps)
        z = np.clip(moved, lower, upper)
        out = moving & (z != moved)
        if out.any():
            moving = moving & ~out
            continue
        # A coordinate is released once only: it would go in circles otherwise.

        back = inward(z, free & ~moving & (not released))
        if not back.any():
            break
        moving, released = moving | back, True
    return Point(z, float(cost), bool(settled), steps)

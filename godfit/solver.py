"""One nonlinear least-squares solve: optimistix on deviance residuals, bounds by an active set."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from godfit.likelihood import deviance_residuals, interval
from godfit.models import AbstractModel, Values, Vector
from godfit.observation import Observation

Switches = Bool[Array, " p"] | Bool[np.ndarray, " p"]

Scalar = Float[Array, ""] | np.float32

MAX_ACTIVE_SET_ROUNDS = 6
MAX_STEPS = 12
# On a tangent steps are cheap, and where rounding is all the noise there is they are many: the
# likelihood is flat inside the intervals and steep outside.
MAX_TANGENT_STEPS = 100


class Point(NamedTuple):
    """Where a solve ended: coordinates, half the deviance there, whether the solver was content."""

    coordinates: np.ndarray
    cost: float
    settled: bool
    steps: int


def scales(coordinates: np.ndarray) -> np.ndarray:
    """Sizes that bring every coordinate's useful steps to order one. Unscaled, Levenberg-Marquardt
    needs several times the steps."""
    floor = np.full(coordinates.shape, 0.1, np.float32)
    floor[[0, 3]] = 1e-3
    return np.abs(coordinates) * np.float32(0.1) + floor


@eqx.filter_jit
def _least_squares(
    start: Vector,
    free: Switches,
    scale: Vector,
    held: Vector,
    model: AbstractModel,
    seen: Observation,
    sigma: Scalar,
):
    def residuals(y, _):
        at = model.moved(jnp.where(free, y * scale, start), held)
        return share * deviance_residuals(seen.predict(at), seen.lo, seen.hi, sigma)

    # Residuals of order one in sum make the solver's first damping, 1, mean something: it starts
    # between the gradient and the Newton step instead of leaping.
    share = seen.lo.shape[0] ** -0.5

    return _minimise(residuals, start, free, scale, share, MAX_STEPS)


def _minimise(residuals, start, free, scale, share, max_steps):
    solver = optx.LevenbergMarquardt(rtol=1e-5, atol=1e-6, linear_solver=lx.QR())
    solution = optx.least_squares(
        residuals, solver, start / scale, max_steps=max_steps, throw=False
    )
    coordinates = jnp.where(free, solution.value * scale, start)
    cost = 0.5 * jnp.sum((solution.state.f_info.residual / share) ** 2)
    settled = solution.result == optx.RESULTS.successful
    return coordinates, cost, settled, solution.stats["num_steps"]


@eqx.filter_jit
def linearise(
    coordinates: Vector,
    held: Vector,
    scale: Vector,
    model: AbstractModel,
    seen: Observation,
) -> tuple[Float[Array, " m"], Float[Array, "m p"]]:
    """Predicted levels and their derivatives by the coordinates divided by ``scale``."""

    def predict(y):
        prediction = seen.predict(model.moved(y * scale, held))
        return prediction, prediction

    jacobian, prediction = jax.jacfwd(predict, has_aux=True)(coordinates / scale)
    return prediction, jacobian


@eqx.filter_jit
def _linear_least_squares(
    start: Vector,
    free: Switches,
    scale: Vector,
    prediction: Values,
    jacobian: Float[Array, "m p"] | Float[np.ndarray, "m p"],
    lo: Values,
    hi: Values,
    sigma: Scalar,
):
    """The solve with the model replaced by its tangent: the likelihood alone is nonlinear."""
    share = lo.shape[0] ** -0.5

    def residuals(y, _):
        step = jnp.where(free, y - start / scale, 0.0)
        return share * deviance_residuals(prediction + jacobian @ step, lo, hi, sigma)

    return _minimise(residuals, start, free, scale, share, MAX_TANGENT_STEPS)


def solve(
    start: np.ndarray,
    free: np.ndarray,
    held: np.ndarray,
    model: AbstractModel,
    seen: Observation,
    sigma: float,
    *,
    bounded: bool = True,
) -> Point:
    """Minimise the deviance over the ``free`` coordinates, inside the model's bounds or, far from
    the answer, without them: the way there may lead outside, where the sum is as smooth."""

    def run(z, moving):
        return _least_squares(z, moving, scales(z), held, model, seen, np.float32(sigma))

    if not bounded:
        value, cost, settled, steps = run(start, free)
        sound = np.isfinite(value).all() and np.isfinite(cost)
        return Point(np.asarray(value), float(cost) if sound else np.inf, bool(settled), int(steps))

    def slope(z):
        prediction, jacobian = linearise(z, held, np.ones_like(z), model, seen)
        return _slope(prediction, jacobian, seen.lo, seen.hi, np.float32(sigma))

    return _inside(start, free, model, run, slope)


def solve_tangent(
    start: np.ndarray,
    free: np.ndarray,
    model: AbstractModel,
    scale: np.ndarray,
    prediction: Values,
    jacobian: Float[Array, "m p"] | Float[np.ndarray, "m p"],
    lo: Values,
    hi: Values,
    sigma: float,
) -> Point:
    """``solve`` on the tangent at ``start``, given by ``linearise``; a small part of its cost."""

    def run(z, moving):
        shifted = prediction + jacobian @ ((z - start) / scale)
        return _linear_least_squares(z, moving, scale, shifted, jacobian, lo, hi, np.float32(sigma))

    def slope(z):
        shifted = prediction + jacobian @ ((z - start) / scale)
        return _slope(shifted, jacobian, lo, hi, np.float32(sigma)) / scale

    return _inside(start, free, model, run, slope)


@jax.jit
def _slope(prediction, jacobian, lo, hi, sigma):
    pixel = interval((lo - prediction) / sigma, (hi - prediction) / sigma)
    return -(pixel.slope / sigma) @ jacobian


def _inside(start, free, model, run, slope) -> Point:
    """``run`` again and again with fewer or more coordinates moving, until all are in bounds.

    A coordinate that a run takes out of its bounds is put on the bound and stays there for the next
    one: a true value can lie *on* a bound, which a sigmoid could never reach.
    """
    lower, upper = (np.asarray(b, np.float32) for b in model.bounds())
    z = np.clip(np.asarray(start, np.float32), lower, upper)
    moving = free.copy()
    steps = 0
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
        stuck = free & ~moving
        if slope is None or not stuck.any():
            break
        falls = np.asarray(slope(z))
        inward = stuck & (((z <= lower) & (falls < 0)) | ((z >= upper) & (falls > 0)))
        if not inward.any():
            break
        # Released ones get no second chance to leave: that would go round for ever.
        moving = moving | inward
        slope = None
    return Point(z, float(cost), bool(settled), steps)

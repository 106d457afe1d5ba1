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

from godfit.likelihood import deviance_residuals
from godfit.models import AbstractModel
from godfit.observation import Observation

MAX_ACTIVE_SET_ROUNDS = 6
# One number for all stages, because it is part of what is compiled.
MAX_STEPS = 12


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
    start: Float[Array, " p"],
    free: Bool[Array, " p"],
    scale: Float[Array, " p"],
    held: Float[Array, " p"],
    model: AbstractModel,
    seen: Observation,
    sigma: Float[Array, ""],
):
    def residuals(y, _):
        at = model.moved(jnp.where(free, y * scale, start), held)
        return share * deviance_residuals(seen.predict(at), seen.lo, seen.hi, sigma)

    # Residuals of order one in sum make the solver's first damping, 1, mean something: it starts
    # between the gradient and the Newton step instead of leaping.
    share = seen.lo.shape[0] ** -0.5

    solver = optx.LevenbergMarquardt(rtol=1e-5, atol=1e-6, linear_solver=lx.QR())
    solution = optx.least_squares(
        residuals, solver, start / scale, max_steps=MAX_STEPS, throw=False
    )
    coordinates = jnp.where(free, solution.value * scale, start)
    info = solution.state.f_info
    cost = 0.5 * jnp.sum((info.residual / share) ** 2)
    settled = solution.result == optx.RESULTS.successful
    return coordinates, cost, settled, solution.stats["num_steps"]


@eqx.filter_jit
def gradient(
    coordinates: Float[Array, " p"],
    held: Float[Array, " p"],
    model: AbstractModel,
    seen: Observation,
    sigma: Float[Array, ""],
) -> Float[Array, " p"]:
    """Derivative of half the deviance by every coordinate."""

    def cost(z):
        return 0.5 * jnp.sum(
            deviance_residuals(seen.predict(model.moved(z, held)), seen.lo, seen.hi, sigma) ** 2
        )

    # Forward mode: the four sums give all columns, and reverse mode would keep every tap.
    return jax.jacfwd(cost)(coordinates)


def solve(
    start: np.ndarray,
    free: np.ndarray,
    held: np.ndarray,
    model: AbstractModel,
    seen: Observation,
    sigma: float,
    *,
    release: bool = False,
) -> Point:
    """Minimise the deviance over the ``free`` coordinates, inside the model's bounds.

    A coordinate that a solve takes out of its bounds is put on the bound and kept there for the
    next one (a true value can lie *on* a bound, which a sigmoid could never reach); with
    ``release`` it is let go again if the cost falls inwards.
    """
    lower, upper = (np.asarray(b, np.float32) for b in model.bounds())
    z = np.clip(np.asarray(start, np.float32), lower, upper)
    moving = free.copy()
    steps = 0
    for _ in range(MAX_ACTIVE_SET_ROUNDS):
        value, cost, settled, taken = _least_squares(
            jnp.asarray(z),
            jnp.asarray(moving),
            jnp.asarray(scales(z)),
            jnp.asarray(held),
            model,
            seen,
            jnp.float32(sigma),
        )
        steps += int(taken)
        moved = np.asarray(value)
        if not np.isfinite(moved).all() or not np.isfinite(float(cost)):
            return Point(z, float("inf"), False, steps)
        z = np.clip(moved, lower, upper)
        out = moving & (z != moved)
        if out.any():
            moving &= ~out
            continue
        stuck = free & ~moving
        if not (release and stuck.any()):
            break
        slope = np.asarray(
            gradient(jnp.asarray(z), jnp.asarray(held), model, seen, jnp.float32(sigma))
        )
        inward = stuck & (((z <= lower) & (slope < 0)) | ((z >= upper) & (slope > 0)))
        if not inward.any():
            break
        # Released ones get no second chance to leave: that would go round for ever.
        moving |= inward
        release = False
    return Point(z, float(cost), bool(settled), steps)

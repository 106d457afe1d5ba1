"""The ways in which ``experiments/speed/peers.py`` has the same fit done, each as its users would
write it."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any
from unittest import mock

import equinox as eqx
import jax
import jax.numpy as jnp
import numba
import numpy as np
import optimistix as optx
from scipy import ndimage, optimize

from godfit import Mitchell, fit
from godfit.inference import solver
from godfit.inference.solver import linearise

NAMES = ("exposure", "decay", "density", "weight", "light_x", "light_y")
TRUTH = np.array([0.02, 0.985, 0.85, 0.7, 0.56, 0.6])
START = np.array([0.0225, 0.983, 0.75, 0.6, 0.58, 0.58])
# What the error is counted in, and the solvers' scale of each parameter.
UNITS = np.array([0.02, 0.015, 0.85, 0.7, 1.0, 1.0])
BOUNDS = (
    np.array([0, 0, 1e-3, 0, -np.inf, -np.inf]),
    np.array([np.inf, 1, 1, np.inf] + 2 * [np.inf]),
)
CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True)
class Problem:
    """A mask (h, w), 0 to 1, and a target (h, w) of bytes."""

    mask: np.ndarray
    target: np.ndarray
    samples: int

    @property
    def levels(self) -> np.ndarray:
        """The target, float64, 1 is white."""
        return self.target / 255


class Arrived(Exception):
    """The point asked for is near enough, or the budget is spent."""


class Watch:
    """Is shown every point that a peer asks for, and stops it."""

    def __init__(self, tolerance: float, budget: float):
        self.tolerance, self.budget = tolerance, budget
        self.evaluations, self.error = 0, np.inf
        self.began = time.perf_counter()

    def __call__(self, parameters) -> None:
        self.error = float(np.sqrt(np.mean(((np.asarray(parameters) - TRUTH) / UNITS) ** 2)))
        if self.error < self.tolerance or time.perf_counter() - self.began > self.budget:
            raise Arrived
        self.evaluations += 1


Solve = Callable[[Watch], Any]
Forward = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Run:
    seconds: float
    error: float
    evaluations: int
    arrived: bool


def timed(solve: Solve, tolerance: float, budget: float) -> Run:
    """The fit, stopped by the watch."""
    watch = Watch(tolerance, budget)
    with contextlib.suppress(Arrived):
        solve(watch)
    seconds = time.perf_counter() - watch.began
    return Run(seconds, watch.error, watch.evaluations, watch.error < tolerance)


# Forward models: parameters (6,) -> light pass (h, w).


def scipy_forward(mask: np.ndarray, samples: int) -> Forward:
    """``map_coordinates`` for every tap, the taps shared out among threads."""
    h, w = mask.shape
    rows, columns = np.mgrid[:h, :w].astype(np.float64)
    pool = ThreadPoolExecutor(CORES)

    def forward(parameters: np.ndarray) -> np.ndarray:
        exposure, decay, density, weight, u, v = parameters
        ray_y, ray_x = (1 - v) * h - 0.5 - rows, u * w - 0.5 - columns

        def taps(first: int) -> np.ndarray:
            total = np.zeros_like(mask)
            for i in range(first, samples, CORES):
                t = i * density / samples
                at = [rows + t * ray_y, columns + t * ray_x]
                total += decay**i * ndimage.map_coordinates(mask, at, order=1, mode="nearest")
            return total

        return exposure * (mask + weight * sum(pool.map(taps, range(1, 1 + CORES))))

    return forward


@numba.njit(parallel=True, fastmath=True, cache=True)
def _loops(mask, exposure, decay, density, weight, light_x, light_y, samples):
    h, w = mask.shape
    out = np.empty_like(mask)
    for y in numba.prange(h):
        for x in range(w):
            total, power = 0.0, weight
            for i in range(1, samples):
                power *= decay
                t = i * density / samples
                column = min(max(x + t * (light_x - x), 0.0), w - 1.0)
                row = min(max(y + t * (light_y - y), 0.0), h - 1.0)
                a, b = int(row), int(column)
                c, d = min(a + 1, h - 1), min(b + 1, w - 1)
                f, g = row - a, column - b
                top = mask[a, b] + g * (mask[a, d] - mask[a, b])
                bottom = mask[c, b] + g * (mask[c, d] - mask[c, b])
                total += power * (top + f * (bottom - top))
            out[y, x] = exposure * (mask[y, x] + total)
    return out


def numba_forward(mask: np.ndarray, samples: int) -> Forward:
    """The definition as compiled loops, rows in parallel."""
    h, w = mask.shape

    def forward(parameters: np.ndarray) -> np.ndarray:
        exposure, decay, density, weight, u, v = (float(p) for p in parameters)
        light_x, light_y = u * w - 0.5, (1 - v) * h - 0.5
        return _loops(mask, exposure, decay, density, weight, light_x, light_y, samples)

    return forward


def godfit_forward(mask: np.ndarray, samples: int, method: str):
    """godfit's sum by one of its methods, in JAX."""
    values = jnp.asarray(mask, float)

    def forward(parameters):
        exposure, decay, density, weight = parameters[:4]
        model = Mitchell(exposure, decay, density, weight, parameters[4:], "dawntime", samples)
        return model.light_pass(values, method=method)

    return forward


def torch_forward(mask: np.ndarray, samples: int, chunk: int = 50):
    """``grid_sample`` of many taps at a time: its threads share out the pictures of a batch."""
    import torch  # pyright: ignore[reportMissingImports]

    h, w = mask.shape
    texture = torch.tensor(mask, dtype=torch.float32)[None, None]
    x, y = ((torch.arange(n) + 0.5) * 2 / n - 1 for n in (w, h))
    grid = torch.stack(torch.meshgrid(x, y, indexing="xy"), -1)
    taps = torch.arange(1, samples)

    def forward(parameters):
        exposure, decay, density, weight, u, v = parameters
        ray = torch.stack([2 * u - 1, 1 - 2 * v]) - grid
        total = texture[0, 0]
        for i in taps.split(chunk):
            at = grid + (i * density / samples)[:, None, None, None] * ray
            read = torch.nn.functional.grid_sample(
                texture.expand(len(i), 1, h, w), at, padding_mode="border", align_corners=False
            )
            total = total + torch.tensordot(weight * decay**i, read[:, 0], 1)
        return exposure * total

    return forward


# Peers: what they prepare and warm up, and the fit that is timed.


def least_squares(forward: Forward, problem: Problem, watch: Watch, jacobian: Any = "2-point"):
    """scipy's trust region. Its own tests do not stop it before the watch does."""

    def residuals(parameters):
        watch(parameters)
        return (forward(parameters) - problem.levels).ravel()

    return optimize.least_squares(
        residuals, START, jacobian, BOUNDS, x_scale=UNITS, ftol=1e-15, xtol=1e-15, gtol=1e-15
    )


def scipy_map_coordinates(problem: Problem) -> Solve:
    forward = scipy_forward(problem.mask, problem.samples)
    return lambda watch: least_squares(forward, problem, watch)


def scipy_numba(problem: Problem) -> Solve:
    forward = numba_forward(problem.mask, problem.samples)
    forward(START)
    return lambda watch: least_squares(forward, problem, watch)


def scipy_strips(problem: Problem) -> Solve:
    forward = jax.jit(godfit_forward(problem.mask, problem.samples, "strips"))
    derivative = jax.jit(jax.jacfwd(forward))
    jax.block_until_ready([forward(START), derivative(START)])

    def jacobian(parameters):
        return np.asarray(derivative(parameters), float).reshape(-1, len(NAMES))

    return lambda watch: least_squares(
        lambda p: np.asarray(forward(p), float), problem, watch, jacobian
    )


def optimistix_naive(problem: Problem) -> Solve:
    """Step by step, so that the watch is asked."""
    forward = godfit_forward(problem.mask, problem.samples, "reference")
    target, units = jnp.asarray(problem.levels, float), jnp.asarray(UNITS, float)

    # Of this size, the residuals make the solver's first damping, 1, mean something: much larger
    # ones begin with Newton steps that leap away, much smaller ones with many short steps.
    share = 4 * 255 / target.size**0.5

    @jax.custom_jvp
    def residuals(y):
        return share * (forward(y * units) - target).ravel()

    # Linearised as it is, a scan keeps every tap's reads: the derivatives are made at once instead.
    @residuals.defjvp
    def _(at, along):
        def both(y):
            value = share * (forward(y * units) - target).ravel()
            return value, value

        derivative, value = jax.jacfwd(both, has_aux=True)(at[0])
        return value, derivative @ along[0]

    def function(y, _):
        return residuals(y), None

    solver = optx.LevenbergMarquardt(rtol=1e-9, atol=1e-9)
    start = jnp.asarray(START / UNITS, float)
    given = {"args": None, "options": {"jac": "fwd"}, "tags": frozenset()}
    shape = jax.eval_shape(residuals, start)
    first = solver.init(function, start, f_struct=shape, aux_struct=None, **given)
    step = eqx.filter_jit(lambda y, state: solver.step(function, y, state=state, **given)[:2])
    jax.block_until_ready(step(start, first)[0])

    def solve(watch):
        y, state = start, first
        while True:
            watch(np.asarray(state.y_eval) * UNITS)
            y, state = step(y, state)

    return solve


def torch_descent(problem: Problem, optimiser: Callable[..., Any], **settings) -> Solve:
    """Coordinates are counted in what changes the picture alike at the start (finite differences,
    within the time). Reads are of float32; the sum of squares is of float64, without which line
    searches end in rounding."""
    import torch  # pyright: ignore[reportMissingImports]

    torch.set_num_threads(CORES)
    sums = torch_forward(problem.mask, problem.samples)
    target, start = torch.tensor(problem.levels), torch.tensor(START)

    def forward(parameters):
        return sums(parameters.float()).double()

    def value_and_slope(z, scale):
        loss = ((forward(start + scale * z) - target) ** 2).mean()
        loss.backward()
        return loss

    value_and_slope(torch.zeros_like(start, requires_grad=True), torch.ones_like(start))

    def solve(watch):
        watch.evaluations += 2 * len(NAMES)
        with torch.no_grad():
            steps = torch.diag(torch.tensor(1e-3 * UNITS))
            changes = [(forward(start + s) - forward(start - s)).square().mean() for s in steps]
            scale = 0.1 * 2 * steps.diag() / torch.stack(changes).sqrt()
        z = torch.zeros_like(start, requires_grad=True)
        descent = optimiser([z], **settings)

        def closure():
            descent.zero_grad()
            watch((start + scale * z).detach().numpy())
            return value_and_slope(z, scale)

        while True:
            descent.step(closure)

    return solve


def torch_lbfgs(problem: Problem) -> Solve:
    import torch  # pyright: ignore[reportMissingImports]

    return torch_descent(
        problem, torch.optim.LBFGS, max_iter=1000, history_size=10, tolerance_grad=0,
        tolerance_change=0, line_search_fn="strong_wolfe",
    )  # fmt: skip


def torch_adam(problem: Problem) -> Solve:
    import torch  # pyright: ignore[reportMissingImports]

    return torch_descent(problem, torch.optim.Adam, lr=0.05, betas=(0.9, 0.99))


@eqx.filter_jit
def _parameters_at(z, held, model):
    values = model.moved(z, held).values()
    return jnp.stack([values[name] for name in NAMES])


def godfit_fit(problem: Problem, start: dict[str, float] | None, *, whole: bool) -> Solve:
    """``whole``: to its own end, errors and warnings included, the watch shown the answer. Else the
    watch is shown every point at which the fit renders, as with the others."""
    mask = np.floor(problem.mask * 255 + 0.5).astype(np.uint8)

    def answer():
        return fit(
            problem.target, mask=mask, shader="dawntime", samples=problem.samples, start=start
        )

    def solve(watch: Watch):
        if whole:
            result = answer()
            watch([result.params[name].value for name in NAMES])
            return

        def shown(z, held, scale, model, seen):
            watch(np.asarray(_parameters_at(z, held, model)))
            return linearise(z, held, scale, model, seen)

        with mock.patch.object(solver, "linearise", shown):
            answer()

    answer()
    return solve


PEERS: dict[str, Callable[[Problem], Solve]] = {
    "godfit": lambda problem: godfit_fit(
        problem, dict(zip(NAMES, START.tolist(), strict=True)), whole=False
    ),
    "godfit, no start": lambda problem: godfit_fit(problem, None, whole=False),
    "godfit, no start, with errors": lambda problem: godfit_fit(problem, None, whole=True),
    "scipy, strips and their Jacobian": scipy_strips,
    "scipy, numba": scipy_numba,
    "optimistix, jacfwd of the naive sum": optimistix_naive,
    "torch, LBFGS": torch_lbfgs,
    "torch, Adam": torch_adam,
    "scipy, map_coordinates": scipy_map_coordinates,
}

"""The same fit by optimistix: Levenberg-Marquardt on the residuals."""

import jax
import optimistix
from whitening import whitened

import godfit


def fitted(problem):
    """The parameters, by name."""
    start, to_params = whitened(problem)
    solver = optimistix.LevenbergMarquardt(rtol=1e-8, atol=1e-8)
    answer = optimistix.least_squares(
        lambda u, _: problem.residuals(to_params(u)), solver, start, max_steps=50
    )
    return to_params(answer.value)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    picture = "data_synthetic/disc"
    problem = godfit.problem(
        f"{picture}.png", mask=f"{picture}_mask.png", shader="dawntime", samples=100
    )
    print({name: float(value) for name, value in fitted(problem).items()})

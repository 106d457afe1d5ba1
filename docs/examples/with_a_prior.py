"""A fit with one more term: a prior on density, as from the shader's source or another frame."""

import jax
import optimistix
from whitening import whitened

import godfit


def fitted(problem, density, error):
    """The parameters of the largest posterior, by name, with a Gaussian prior on density."""
    start, to_params = whitened(problem)

    def cost(u, _):
        params = to_params(u)
        prior = -0.5 * ((params["density"] - density) / error) ** 2
        return -(problem.log_likelihood(params) + prior)

    answer = optimistix.minimise(cost, optimistix.BFGS(rtol=1e-8, atol=1e-8), start)
    return to_params(answer.value)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    picture = "data_synthetic/disc"
    problem = godfit.problem(
        f"{picture}.png", mask=f"{picture}_mask.png", shader="dawntime", samples=100
    )
    print({name: float(value) for name, value in fitted(problem, 0.9, 0.001).items()})

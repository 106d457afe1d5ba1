"""The same fit by optax: L-BFGS on the log-likelihood."""

import jax
import optax
from whitening import whitened

import godfit

STEPS = 20


def fitted(problem):
    """The parameters, by name."""
    start, to_params = whitened(problem)

    def cost(u):
        return -problem.log_likelihood(to_params(u))

    solver = optax.lbfgs()
    value_and_slope = optax.value_and_grad_from_state(cost)

    def step(carry, _):
        u, state = carry
        value, slope = value_and_slope(u, state=state)
        change, state = solver.update(slope, state, u, value=value, grad=slope, value_fn=cost)
        return (optax.apply_updates(u, change), state), value

    (u, _), _ = jax.lax.scan(step, (start, solver.init(start)), length=STEPS)
    return to_params(u)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    picture = "data_synthetic/disc"
    problem = godfit.problem(
        f"{picture}.png", mask=f"{picture}_mask.png", shader="dawntime", samples=100
    )
    print({name: float(value) for name, value in fitted(problem).items()})

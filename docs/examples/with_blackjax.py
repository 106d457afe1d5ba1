"""The posterior by blackjax: draws of the No-U-Turn sampler, with a flat prior."""

import blackjax
import jax
from whitening import whitened

import godfit

DRAWS = 1000


def drawn(problem, seed=0):
    """Draws of every parameter, by name, (DRAWS,) each."""
    start, to_params = whitened(problem)
    sampler = blackjax.nuts(
        lambda u: problem.log_likelihood(to_params(u)), step_size=0.7,
        inverse_mass_matrix=jax.numpy.ones_like(start),
    )  # fmt: skip

    def step(state, key):
        state, _ = sampler.step(key, state)
        return state, state.position

    keys = jax.random.split(jax.random.key(seed), DRAWS)
    _, draws = jax.jit(lambda s: jax.lax.scan(step, s, keys))(sampler.init(start))
    return jax.vmap(to_params)(draws)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    picture = "data_synthetic/disc"
    problem = godfit.problem(
        f"{picture}.png", mask=f"{picture}_mask.png", shader="dawntime", samples=100
    )
    for name, values in drawn(problem).items():
        print(f"{name}: {values.mean():.6g} +- {values.std():.2g}")

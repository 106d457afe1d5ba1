"""The likelihood in other hands: solvers, a sampler and a prior reach the command line's answer.

The picture is that of ``test_lmfit.py``, so that its programs are compiled once.
"""

import json
import runpy
from pathlib import Path

import jax
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import godfit
from godfit.__main__ import main
from godfit.inference.allowances.arithmetic import with_arithmetic
from godfit.inference.likelihood import log_likelihood
from godfit.inference.noise import noise_of
from tests.support import scattering_oracle as oracle
from tests.support.compiling import quick_jit

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"
SIZE, SAMPLES, NOISE_LEVELS = 96, 30, 1.0
TRUTH = (0.1, 0.95, 0.7, 0.5, (0.4, 0.6))
NEAR = 0.1
"""Standard errors within which an answer is the command line's."""
AWAY = 1.0
"""Standard errors by which a start is moved along every axis of whitened coordinates."""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("problem")
    mask = oracle.smooth_mask(SIZE, SIZE, scale=3).astype(np.float32)
    noise = np.random.default_rng(1).normal(0, NOISE_LEVELS / 255, mask.shape)
    target = oracle.light_pass(mask.astype(float), "dawntime", *TRUTH, SAMPLES) + noise
    for name, image in (("target", target), ("mask", mask)):
        np.save(folder / f"{name}.npy", image.astype(np.float32))
    return folder / "target.npy", folder / "mask.npy"


@pytest.fixture(scope="module")
def answer(files, tmp_path_factory):
    """The params of the fit.json that the command line writes."""
    folder = tmp_path_factory.mktemp("answer")
    target, mask = map(str, files)
    with jax.enable_x64(False):
        arguments = ["fit", target, "--mask", mask, "--samples", str(SAMPLES), "-q"]
        assert main([*arguments, "--shader", "dawntime", "-o", str(folder)]) == 0
    return json.loads((folder / "fit.json").read_text())["params"]


def example(name):
    """The names of a script of docs/examples."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(EXAMPLES)
        return runpy.run_path(str(EXAMPLES / f"{name}.py"))


def distances(params, answer):
    """How far parameters are from the answer, in its standard errors."""
    return {n: abs(float(v) - answer[n]["value"]) / answer[n]["stderr"] for n, v in params.items()}


@pytest.fixture(scope="module")
def problem(files, answer):
    """The problem with a start that is AWAY from the answer along each of its six axes: on so small
    a picture the search itself ends at the answer."""
    target, mask = files
    found = godfit.problem(target, mask=mask, shader="dawntime", samples=SAMPLES)
    assert max(distances(found.start, answer).values()) < 1
    start, to_params = example("whitening")["whitened"](found)
    away = {name: float(value) for name, value in to_params(start + AWAY).items()}
    light = [away.pop(name) for name in ("light_x", "light_y")]
    model = godfit.Mitchell(**away, light=light, shader="dawntime", samples=SAMPLES)
    moved = found.replaced(point=np.asarray(model.coordinates()))
    assert max(distances(moved.start, answer).values()) > AWAY / 2
    return moved


@pytest.mark.parametrize("name", ["with_optimistix", "with_optax"])
def test_solvers_reach_the_answer(name, problem, answer):
    off = distances(example(name)["fitted"](problem), answer)
    assert len(off) == 6
    assert max(off.values()) < NEAR, off


def test_sampler_reaches_the_answer(problem, answer):
    """Fewer draws than the example's know a mean to 5% of the error, and the error to 4%."""
    drawn = example("with_blackjax")["drawn"]
    drawn.__globals__["DRAWS"] = 400
    draws = drawn(problem)
    off = distances({name: values.mean() for name, values in draws.items()}, answer)
    assert max(off.values()) < 1.5 * NEAR, off
    for name, values in draws.items():
        assert float(values.std()) == pytest.approx(answer[name]["stderr"], rel=0.12), name


def test_a_prior_counts_as_one_more_measurement(problem, answer):
    fitted = example("with_a_prior")["fitted"]
    value, stderr = (answer["density"][key] for key in ("value", "stderr"))
    off = distances(fitted(problem, value + stderr, 1e3 * stderr), answer)
    assert max(off.values()) < NEAR, off
    # As precise as the picture, and a standard error away: the answer is in the middle.
    both = float(fitted(problem, value + stderr, stderr)["density"])
    assert both == pytest.approx(value + stderr / 2, abs=NEAR * stderr)


def test_derivatives_are_those_of_finite_differences(problem, answer):
    flat, unflatten = ravel_pytree(problem.start)

    def of_values(values):
        return problem.log_likelihood(unflatten(values))

    likelihood, slope = quick_jit(of_values), quick_jit(jax.grad(of_values))
    curvature = quick_jit(jax.hessian(of_values))(flat)
    found = slope(flat)
    errors = ravel_pytree({name: answer[name]["stderr"] for name in problem.start})[0]
    for i, step in enumerate(1e-4 * errors):
        ahead, behind = flat.at[i].add(step), flat.at[i].add(-step)
        by_values = (likelihood(ahead) - likelihood(behind)) / (2 * step)
        # In units of the errors, so that a slope of one is what a standard error off makes.
        assert float(found[i] * errors[i]) == pytest.approx(float(by_values * errors[i]), rel=1e-5)
        by_slopes = (slope(ahead) - slope(behind)) / (2 * step)
        scale = errors * errors[i]
        np.testing.assert_allclose(curvature[i] * scale, by_slopes * scale, rtol=1e-4, atol=1e-4)


def test_likelihood_is_differentiable_in_the_noise(problem):
    def of_noise(noise):
        return problem.log_likelihood(problem.start, noise)

    likelihood, slope = quick_jit(of_noise), quick_jit(jax.grad(of_noise))
    by_values = (likelihood(0.5 + 1e-5) - likelihood(0.5 - 1e-5)) / 2e-5
    assert float(slope(0.5)) == pytest.approx(float(by_values), rel=1e-6)


def test_an_unknown_parameter_is_named(problem):
    with pytest.raises(godfit.InputError, match="got 'densty'; did you mean 'density'"):
        problem.log_likelihood({"densty": 0.5})


def test_priors_are_rows_and_terms(problem):
    at = problem.start["density"]
    known = problem.replaced(prior={"density": (at - 0.03, 0.02), "weight": (0.5, 1e9)})
    rows = np.asarray(known.residuals(problem.start))
    np.testing.assert_allclose(rows[:-2], problem.residuals(problem.start))
    np.testing.assert_allclose(rows[-2:], [1.5, 0], atol=1e-6)
    gap = problem.log_likelihood(problem.start) - known.log_likelihood(problem.start)
    assert float(gap) == pytest.approx(1.5**2 / 2, rel=1e-4)
    by_density = jax.grad(lambda p: problem.log_likelihood(p) - known.log_likelihood(p))
    assert float(by_density(problem.start)["density"]) == pytest.approx(1.5 / 0.02, rel=1e-4)


@pytest.mark.parametrize("arithmetic", ["gpu", "exact"])
def test_the_arithmetic_of_a_gpu_is_in_the_likelihood(files, arithmetic):
    """Against the interval likelihood with the noise of ``with_arithmetic``, value by value."""
    target, mask = (np.load(path) for path in files)
    stored = np.rint(255 * target.clip(0, 1)).astype(np.uint8)
    options = {"mask": mask, "shader": "dawntime", "samples": SAMPLES, "arithmetic": arithmetic}
    found = godfit.problem(stored, **options)
    whole = found.picture.observe(np.arange(stored.size))
    assert found.point is not None
    with jax.enable_x64(False):
        own = with_arithmetic(whole, found, found.point).own_noise
    assert (own is None) == (arithmetic == "exact")
    noise = noise_of(NOISE_LEVELS, None if own is None else np.asarray(own, float))
    levels = whole.predict(found.at(found.point))
    expected = log_likelihood(levels, whole.lo, whole.hi, noise).sum()
    value = quick_jit(found.log_likelihood)(found.start, NOISE_LEVELS)
    assert float(value) == pytest.approx(float(expected), rel=1e-5)
    # Half the squares of the residuals fall by what the likelihood gains.
    away = found.start | {"density": found.start["density"] + 0.01}
    squares = [
        0.5 * float((found.residuals(p, NOISE_LEVELS) ** 2).sum()) for p in (away, found.start)
    ]
    gain = value - found.log_likelihood(away, NOISE_LEVELS)
    assert squares[0] - squares[1] == pytest.approx(float(gain), rel=1e-4)

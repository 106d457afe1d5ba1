"""Derivatives: the hand-written JVP against JAX's own of the reference in float64, against finite
differences, and at every edge where one could become infinite."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from jax.test_util import check_grads

from godfit.models.mitchell import Mitchell
from godfit.scattering.conventions import CONVENTIONS
from godfit.scattering.radial import radial_sum
from godfit.scattering.taps import Taps
from tests.support import scattering_oracle as oracle
from tests.support.compiling import quick_jit

# A density that puts no tap on a texel line by accident: there the bilinear mask has two slopes.
POINT = (0.13, 0.93, 0.7391, 0.6)
NAMES = ("exposure", "decay", "density", "weight", "light_x", "light_y")
MASK = jnp.asarray(np.random.default_rng(0).random((11, 13)))
SMOOTH = jnp.asarray(oracle.smooth_mask(11, 13))
TAPS = Taps(0.3, 0.21, 0.93, 0.0739, 9)
AT = jnp.array([[3.25, 4.5], [7.0, 2.0], [-0.5, 10.5], [-9.0, 3.0]])


def light_pass(parameters, shader="mitchell", method="pairs", mask=MASK, at=None, samples=9):
    """The light pass as a function of the vector of NAMES."""
    exposure, decay, density, weight = parameters[:4]
    model = Mitchell(exposure, decay, density, weight, parameters[4:], shader, samples)
    return model.light_pass(mask, at, method)


compiled = quick_jit(jax.jacfwd(light_pass), static_argnames=("shader", "method"))


def jacobian(z, shader="mitchell", method="pairs", mask=MASK, at=None):
    """Compiled once for each shader and method, and used at every point."""
    return compiled(z, shader, method, mask, at)


def vector(light, point=POINT):
    return jnp.array([*point, *light])


def agree(actual, expected, rtol):
    """Every derivative to ``rtol`` of the largest in its column."""
    size = np.abs(expected).reshape(-1, expected.shape[-1]).max(0)
    for name, column, reference, scale in zip(
        NAMES, np.moveaxis(actual, -1, 0), np.moveaxis(expected, -1, 0), size, strict=True
    ):
        np.testing.assert_allclose(column, reference, rtol=0, atol=rtol * scale, err_msg=name)


@pytest.mark.parametrize("light", oracle.LIGHTS.values(), ids=oracle.LIGHTS)
# The article's and Babylon's have mitchell's taps; test_conventions.py has derivatives of all.
@pytest.mark.parametrize("shader", ["mitchell", "dawntime", "vesper", "pmndrs"])
def test_jvp_is_that_of_the_reference(shader, light):
    z = vector(light)
    expected = jacobian(z, shader, "reference")
    agree(jacobian(z, shader, "pairs"), expected, 1e-10)
    agree(jacobian(z, shader, "strips"), expected, 1e-10)


# No light in a row of pixels: the taps of that row would be on a texel line, where slopes jump.
@pytest.mark.parametrize("light", [(0.37, 0.62), (0.0, 0.31), (-0.6, 1.7), (3.0, -2.0)])
def test_jvp_beyond_the_light(light):
    z = vector(light, (0.13, 0.93, 1.7391, 0.6))
    for at in (None, AT):
        expected = jacobian(z, method="reference", at=at)
        for method in ("pairs", "strips"):
            agree(jacobian(z, method=method, at=at), expected, 1e-10)


@pytest.mark.parametrize("light", oracle.LIGHTS.values(), ids=oracle.LIGHTS)
@pytest.mark.parametrize("method", ["pairs", "strips"])
def test_jvp_at_points(light, method):
    z = vector(light)
    expected = jacobian(z, method="reference", at=AT)
    agree(jacobian(z, method=method, at=AT), expected, 1e-10)


@pytest.mark.parametrize("shader", ["mitchell", "dawntime", "pmndrs"])
@pytest.mark.parametrize("method", ["pairs", "strips"])
def test_reverse_is_forward(shader, method):
    z = vector(oracle.LIGHTS["off screen"])
    reverse = quick_jit(jax.jacrev(light_pass), static_argnames=("shader", "method"))
    agree(reverse(z, shader, method), jacobian(z, shader, method), 1e-12)


@pytest.mark.parametrize("method", ["reference", "pairs", "strips"])
@pytest.mark.parametrize("at", [None, AT], ids=["every pixel", "points"])
def test_derivative_by_the_mask_is_the_sum_itself(method, at):
    """The sum is linear in the mask; reverse is its transpose."""
    light = jnp.array([0.3, 1.2])
    change = jnp.asarray(np.random.default_rng(1).normal(size=MASK.shape))

    def sum_of(mask):
        return radial_sum(mask, light, TAPS, at=at, method=method)

    @quick_jit
    def derivatives(mask, change):
        out, tangent = jax.jvp(sum_of, (mask,), (change,))
        return out, tangent, sum_of(change), jax.vjp(sum_of, mask)[1](out)[0]

    out, tangent, of_change, back = derivatives(MASK, change)
    np.testing.assert_allclose(tangent, of_change, rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(jnp.vdot(back, change), jnp.vdot(out, tangent), rtol=1e-12)


def test_everything_moves_at_once():
    """Mask, light and taps together: the tangents add up."""
    light, rng = jnp.array([0.3, 1.2]), np.random.default_rng(2)
    inputs = (SMOOTH, light, jnp.array([0.3, 0.21, 0.93, 0.0739]))
    moves = tuple(jnp.asarray(rng.normal(size=z.shape)) for z in inputs)

    def out(method):
        def sum_of(mask, light, numbers):
            return radial_sum(mask, light, Taps(*numbers, count=9), at=AT, method=method)

        return quick_jit(lambda inputs, moves: jax.jvp(sum_of, inputs, moves))(inputs, moves)

    for actual, expected in zip(out("pairs"), out("reference"), strict=True):
        np.testing.assert_allclose(actual, expected, rtol=1e-11)


@pytest.mark.parametrize("shader", ["mitchell", "dawntime", "pmndrs"])
def test_check_grads_on_a_smooth_mask(shader):
    z = vector((0.37, 0.62))
    smooth = jax.jit(lambda z: light_pass(z, shader, mask=SMOOTH))
    check_grads(smooth, (z,), order=1, modes=["fwd", "rev"], eps=1e-7, atol=1e-6, rtol=1e-5)


def squares(z, method, mask, target):
    return jnp.mean((light_pass(z, method=method, mask=mask) - target) ** 2)


loss_and_slopes = quick_jit(jax.value_and_grad(squares), static_argnames="method")


@pytest.mark.parametrize("method", ["reference", "pairs", "strips"])
@pytest.mark.parametrize("light", [(0.37, 0.62), (-0.6, 1.7)], ids=["on screen", "off screen"])
def test_loss_against_central_differences(light, method):
    """A sum of squares over the whole image averages the kinks of single pixels away."""
    mask = jnp.asarray(oracle.smooth_mask(32, 32, scale=3))
    target = light_pass(vector((0.4, 0.6), (0.2, 0.9, 0.8, 0.5)), mask=mask)

    def loss(z):
        return loss_and_slopes(z, method, mask, target)

    z, step = vector(light), 1e-5
    _, gradient = loss(z)
    shifts = step * np.eye(len(NAMES))
    differences = [(loss(z + s)[0] - loss(z - s)[0]) / (2 * step) for s in shifts]
    np.testing.assert_allclose(gradient, differences, rtol=2e-4)


EDGES = {
    "decay 0": (0.13, 0.0, 0.74, 0.6),
    "decay 1": (0.13, 1.0, 0.74, 0.6),
    "density 0": (0.13, 0.93, 0.0, 0.6),
    "density 1": (0.13, 0.93, 1.0, 0.6),
    "density 2": (0.13, 0.93, 2.0, 0.6),
    "weight 0": (0.13, 0.93, 0.74, 0.0),
    "exposure 0": (0.0, 0.93, 0.74, 0.6),
}
FINITE_AT = [
    *((point, oracle.LIGHTS["texel centre"], MASK) for point in EDGES.values()),
    *((POINT, light, MASK) for light in oracle.LIGHTS.values()),
    (POINT, oracle.LIGHTS["texel centre"], jnp.zeros((11, 13))),
]


@quick_jit
def summed_gradient(z, mask):
    return {
        shader: jax.grad(lambda z, s=shader: light_pass(z, s, "auto", mask).sum())(z)
        for shader in TAP_FUNCTIONS
    }


# One of every kind of taps; the others share theirs with mitchell.
TAP_FUNCTIONS = ("mitchell", "dawntime", "pmndrs", "three")


@pytest.mark.parametrize(
    ("point", "light", "mask"), FINITE_AT, ids=[*EDGES, *oracle.LIGHTS, "black mask"]
)
def test_finite_at_every_edge(point, light, mask):
    z = vector(light, point)
    backward = summed_gradient(z, mask)
    for shader in TAP_FUNCTIONS:
        for method in ("reference",) if shader == "three" else ("reference", "pairs"):
            forward = jacobian(z, shader, method, mask)
            assert np.isfinite(forward).all(), (shader, method)
        reverse = backward[shader]
        np.testing.assert_allclose(reverse, forward.sum((0, 1)), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("light", [(0.37, 0.62), (-0.3, 1.2)])
def test_three_against_central_differences(light):
    """Exposure and light of the convention without a hand-written JVP. Its taps end at the light:
    sums jump where one more fits in, and few pixels are that near to one."""
    three = quick_jit(lambda z: light_pass(z, "three", "auto", SMOOTH))
    z, step = vector(light), 1e-7
    exact = np.asarray(jacobian(z, "three", "auto", SMOOTH))
    for i in (0, 4, 5):
        s = step * np.eye(len(NAMES))[i]
        up, down = (three(z + way * s) for way in (1, -1))
        difference = np.asarray(up - down) / (2 * step)
        close = np.abs(difference - exact[..., i]) < 1e-5 * np.abs(exact[..., i]).max()
        assert close.mean() > 0.97, NAMES[i]


def test_points_are_not_differentiated_by_pairs():
    def sum_at(at, method):
        return radial_sum(MASK, jnp.array([0.3, 0.4]), TAPS, at=at, method=method)

    with pytest.raises(ValueError, match=r"differentiable in `at` by method 'reference' alone"):
        jax.jacfwd(sum_at)(AT, "pairs")
    assert np.isfinite(jax.jacfwd(sum_at)(AT, "reference")).all()


# Fit coordinates.

MODELS = {
    "one light": Mitchell(*POINT, [[0.3, 0.8]], "vesper", 9),
    "two lights": Mitchell(0.05, 0.99, 0.8, 0.7, [[0.3, 0.8], [-0.5, 1.5]], "babylon", 20),
    "decay on its bound": Mitchell(0.2, 1.0, 1.0, 0.5, [[0.1, 0.1]], "mitchell", 7),
}


def numbers(model):
    return jnp.stack(list(model.values().values()))


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
class TestCoordinates:
    def test_moved_inverts_coordinates(self, model):
        elsewhere = Mitchell(0.9, 0.5, 0.3, 2.0, 0.9 * model.light, model.shader, model.samples)
        back = elsewhere.moved(model.coordinates())
        np.testing.assert_allclose(numbers(back), numbers(model), rtol=1e-13)

    def test_coordinates_inverts_moved(self, model):
        z = model.coordinates() * 1.1 + 0.01
        np.testing.assert_allclose(model.moved(z).coordinates(), z, rtol=1e-12)

    def test_they_are_what_they_are_called(self, model):
        exposure, kappa, density, gain, *lights = model.coordinates()
        per_ray = model.samples / model.density
        np.testing.assert_allclose(exposure, model.exposure)
        np.testing.assert_allclose(kappa, -per_ray * np.log(model.decay), atol=1e-15)
        np.testing.assert_allclose(density, model.density)
        np.testing.assert_allclose(gain, model.exposure * model.weight * per_ray)
        np.testing.assert_allclose(np.array(lights).reshape(-1, 2), model.light)

    def test_held_parameters_stay(self, model):
        """Each parameter by itself: it keeps its value wherever the coordinates go, and the others
        go where they would have gone, but for what follows from it."""
        z = model.coordinates() * 1.1 + 0.01
        names = list(model.parameters)
        derivative = quick_jit(jax.jacfwd(lambda z, held: numbers(model.moved(z, held))))
        follows = {"exposure": {"weight"}, "density": {"decay", "weight"}}
        for i, name in enumerate(names):
            held = jnp.full(len(names), jnp.nan).at[i].set(0.123)
            moved, free = model.moved(z, held), model.moved(z)
            assert moved.values()[name] == 0.123
            for other in set(names) - {name} - follows.get(name, set()):
                assert moved.values()[other] == free.values()[other]
            by_z = derivative(z, held)
            assert not by_z[i].any()
            assert np.isfinite(by_z).all()

    def test_image_follows_the_coordinates(self, model):
        """The image's derivative by coordinates is that by parameters, times theirs by finite
        differences, which are smooth."""
        z, step = model.coordinates() + 0.003, 1e-6
        shifts = step * jnp.eye(len(z))
        at = quick_jit(lambda z: numbers(model.moved(z)))
        by_z = jnp.stack([(at(z + s) - at(z - s)) / (2 * step) for s in shifts], axis=-1)

        def image(parameters):
            here = Mitchell(*parameters[:4], parameters[4:], model.shader, model.samples)
            return here.light_pass(MASK)

        expected = quick_jit(jax.jacfwd(image))(numbers(model.moved(z))) @ by_z
        actual = quick_jit(jax.jacfwd(lambda z: model.moved(z).light_pass(MASK)))(z)
        np.testing.assert_allclose(actual, expected, rtol=1e-6, atol=1e-8)


def test_without_exposure_there_is_no_light_and_no_infinity():
    model = MODELS["one light"]
    z = model.coordinates().at[0].set(0.0)
    assert np.isfinite(quick_jit(jax.jacfwd(lambda z: numbers(model.moved(z))))(z)).all()
    assert np.isfinite(quick_jit(jax.jacfwd(lambda z: model.moved(z)(MASK)))(z)).all()
    assert not eqx.tree_at(lambda m: m.exposure, model, jnp.zeros(()))(MASK).any()


def test_second_derivatives_are_those_of_the_reference():
    """By the light, the taps and the mask, forward over reverse."""
    mask = jnp.asarray(np.random.default_rng(0).random((9, 8)))
    values = {
        "light": jnp.array([0.41, 0.63]),
        "numbers": jnp.array([0.1, 0.9, 0.7, 0.5]),
        "bend": jnp.array(0.2),
    }
    flat, unflatten = ravel_pytree(values)
    way = jnp.asarray(np.random.default_rng(1).standard_normal(flat.size))

    def squares(method, flat):
        at = unflatten(flat)
        (taps,) = CONVENTIONS["mitchell"].taps(*at["numbers"], 6)
        bent = mask + at["bend"] * mask**2
        return (radial_sum(bent, at["light"], taps, method=method) ** 2).sum()

    @functools.partial(quick_jit, static_argnums=0)
    def along(method, flat):
        slope = jax.grad(functools.partial(squares, method))
        return jax.jvp(slope, (flat,), (way,))[1]

    found, expected = along("auto", flat), along("reference", flat)
    assert abs(expected).max() > 0.1
    np.testing.assert_allclose(found, expected, atol=1e-10 * abs(expected).max())

"""Derivatives of the light in the plane: compiled against JAX's own of the plain walk, against
central differences of a render with other and more rays, and refused where there is none."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from godfit.flatland import Canvas, Sky, canvas, render
from godfit.flatland.drawing import Drawing, Shape
from tests.support import flatland_oracle as oracle
from tests.support.compiling import quick_jit

SKY = Sky(70.0, 50.0, (0.9, 0.8, 0.5), (0.1, 0.2, 0.4))
METHODS = {"distance": {}, "march": {"steps": 40}}


def canvases():
    """Five canvases, hard and soft, square, wide, of one row, empty: each size is compiled once."""
    return {
        f"{h}x{w}, {seed}": oracle.random_canvas((h, w), seed, share=share)
        for seed, (h, w, share) in enumerate(
            [
                (12, 25, 0.02), (12, 25, 0.1), (12, 25, 0.4), (1, 40, 0.05), (12, 25, 0.0),
            ]
        )
    }  # fmt: skip


@pytest.mark.parametrize(("method", "jitter"), [("distance", False), ("march", True)])
def test_compiled_derivatives_are_those_of_the_plain_walk(method, jitter):
    rng = np.random.default_rng(0)
    made = canvas(*oracle.random_canvas((9, 13), 3))
    where = (made, SKY, jnp.asarray(0.7))
    move = jax.tree.map(lambda z: jnp.asarray(rng.normal(size=z.shape)), where)
    pull = jnp.asarray(rng.normal(size=(9, 13, 3)))

    def of(plain):
        def picture(made, sky, exposure):
            return render(made, sky, rays=6, method=method, jitter=jitter, exposure=exposure,
                          plain=plain, **METHODS[method])  # fmt: skip

        @quick_jit
        def slopes(where, move, pull):
            _, forward = jax.jvp(picture, where, move)
            return forward, jax.vjp(picture, *where)[1](pull)

        return slopes(where, move, pull)

    found, expected = of(False), of(True)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-11 * max(1, np.abs(b).max()))
    assert np.abs(expected[1][0].opacity).max() > 0.1


SKY_NUMBERS = ("angle", "width", "sun", "sky")


def squares(z, made, ways, weight, rays):
    """The weighted sum of squares of a picture whose parts are moved by ``z`` (7,)."""
    sky = Sky(SKY.angle + 60 * z[1], SKY.width + 20 * z[2], SKY.sun * (1 + z[3]),
              SKY.sky * (1 + z[4]))  # fmt: skip
    held = Canvas(made.radiance + z[5] * ways["emission"], made.opacity + z[6] * ways["opacity"])
    image = render(held, sky, rays=rays, exposure=1 + z[0])
    return (weight * image**2).sum()


many = quick_jit(squares, static_argnames="rays")
few = quick_jit(jax.grad(squares), static_argnames="rays")


@pytest.mark.parametrize("drawn", canvases().values(), ids=canvases())
def test_against_central_differences_of_more_rays(drawn):
    """Every number of the sky, the exposure, and the emission and opacity of all pixels along a
    direction, for a weighted sum over the picture, within 1%."""
    made = canvas(*drawn)
    rng = np.random.default_rng(1)
    y, x = np.indices(made.size) / max(made.size)
    weight = jnp.asarray((1.3 + np.sin(5 * x + 1) * np.cos(4 * y))[..., None] * [0.9, 1.0, 1.1])
    ways = {
        "emission": jnp.asarray(rng.uniform(0, 1, (*made.size, 3))),
        # Inwards only: opacity lies between none and one.
        "opacity": jnp.asarray(rng.uniform(0, 1, made.size) * (np.asarray(made.opacity) == 0))
        - jnp.asarray(rng.uniform(0, 1, made.size) * (np.asarray(made.opacity) > 0)),
    }
    parts = {"exposure": 0, "angle": 1, "width": 2, "sun": 3, "sky": 4, "emission": 5, "opacity": 6}
    z = jnp.zeros(7)
    found = few(z, made, ways, weight, rays=768)
    for name, i in parts.items():
        h = 1e-4
        # One-sided where there is only one side, of second order.
        there = [many(z.at[i].set(s * h), made, ways, weight, rays=1021) for s in (0, 1, 2)]
        expected = float((-3 * there[0] + 4 * there[1] - there[2]) / (2 * h))
        if abs(expected) < 1e-9:
            assert abs(found[i]) < 1e-9
            continue
        assert found[i] == pytest.approx(expected, rel=0.01), name


SHAPES = {
    "disc": Shape("disc", (1.0, 0.8, 0.3), centre=(0.42, 0.55), radius=0.12),
    "segment": Shape("segment", start=(0.2, 0.3), end=(0.7, 0.45), thickness=0.06),
    "box": Shape("box", (0.1, 0.9, 0.2), centre=(0.6, 0.6), size=(0.3, 0.14), angle=25.0),
    "polygon": Shape("polygon", points=[(0.3, 0.3), (0.75, 0.35), (0.6, 0.5), (0.5, 0.75)]),
}
BESIDE = Shape("disc", (0.8, 0.8, 1.0), centre=(0.85, 0.85), radius=0.08)


@pytest.mark.parametrize("kind", SHAPES)
def test_shapes_that_move(kind):
    """Every number of every shape within 1% of central differences of a render of more rays."""
    size = (48, 56)
    shape = SHAPES[kind]
    y, x = np.indices(size) / size[0]
    weight = jnp.asarray(np.stack([np.sin(6 * x + c) * np.cos(5 * y) + 0.5 for c in range(3)], -1))

    def loss(numbers, rays):
        moved = eqx.tree_at(lambda s: s.numbers, shape, numbers)
        image = render(Drawing((moved, BESIDE), size).drawn(), SKY, rays=rays)
        return (weight * image).sum()

    gradient = quick_jit(jax.grad(loss), static_argnums=1)(shape.numbers, 384)
    value = quick_jit(loss, static_argnums=1)
    largest = max(float(jnp.abs(g).max()) for n, g in gradient.items() if n != "angle")
    for name, slope in gradient.items():
        for index in np.ndindex(slope.shape):
            h = 1e-4 if name != "angle" else 1e-2

            def at(by, name=name, index=index):
                moved = shape.numbers | {name: shape.numbers[name].at[index].add(by)}
                return value(moved, 768)

            expected = (at(h) - at(-h)) / (2 * h)
            scale = largest if name != "angle" else abs(expected)
            assert abs(slope[index] - expected) < 0.01 * max(abs(expected), 0.1 * scale), name


@pytest.mark.parametrize("options", [{"method": "cascades"}, {"steps": 3}])
def test_what_has_no_derivative_refuses(options):
    made = canvas(*oracle.random_canvas((8, 8), 2))

    def by_sky(angle):
        return render(made, eqx.tree_at(lambda s: s.angle, SKY, angle), rays=4, **options).sum()

    def by_canvas(radiance):
        return render(Canvas(radiance, made.opacity), SKY, rays=4, **options).sum()

    for by, at in ((by_sky, SKY.angle), (by_canvas, made.radiance)):
        with pytest.raises(ValueError, match="has no derivative; use method 'distance' or 'march'"):
            jax.grad(by)(at)
        with pytest.raises(ValueError, match="has no derivative"):
            jax.jvp(by, (at,), (jnp.ones_like(at),))

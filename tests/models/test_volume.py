"""The march against closed forms, finer marches, other code, and differences."""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate

from godfit import InputError
from godfit.models.atmosphere import Air, hoffman_preetham, sunlight
from godfit.models.build import view_of_scene
from godfit.models.volume import march, render, trace, view_rays
from godfit.scenes.scene import read_scene
from godfit.scenes.shadow_maps import shadow_map
from tests.support import mitsuba_scenes as theirs
from tests.support.compiling import quick_filter_jit, quick_jit

REFERENCES = Path(__file__).parent / "volume_references.npz"
TOWARDS = np.array([0.0, 0.8, -0.6])
AIR = (3.0, 0.6, 4.0, 4e3)


def stage(tmp_path, objects="", light=(0.0, 80.0, -60.0), size=24, camera=(0.0, 0.0, 0.0)):
    """A scene with a camera that looks along -z."""
    x, y, z = camera
    text = f"""
        [image]
        width = {size}
        height = {size}
        [camera]
        position = [{x}, {y}, {z}]
        target = [{x}, {y}, {z - 1}]
        fov_y = 80
        far = 30
        [light]
        position = [{", ".join(map(str, light))}]
        radius = 0.05
        {objects}"""
    (tmp_path / "scene.toml").write_text(text)
    return read_scene(tmp_path / "scene.toml")


BOX = """
        [[object]]
        primitive = "box"
        size = [1.5, 0.6, 1.0]
        position = [0.3, 1.2, -5]
"""
BALL = """
        [[object]]
        primitive = "icosphere"
        radius = 0.5
        position = [-0.6, 0.1, -3]
"""


def traced(scene, source="sun", steps=128, resolution=1024, length=None):
    pixels = np.arange(scene.size[0] * scene.size[1])
    if length is None:
        length = np.asarray(view_of_scene(scene).distance, np.float64).reshape(-1)
    shadow = shadow_map(scene, source, resolution)
    return trace(scene, view_rays(scene, pixels), length, shadow, source, steps)


@pytest.mark.parametrize("steps", [1, 7, 128])
def test_without_occluders_it_is_hoffman_preetham(tmp_path, steps):
    scene, air = stage(tmp_path), Air(*AIR)
    rays = traced(scene, steps=steps)
    zenith = np.arccos(TOWARDS[1])
    expected = hoffman_preetham(air, rays.length, rays.direction @ jnp.asarray(TOWARDS), zenith)
    np.testing.assert_allclose(march(air, rays), expected, rtol=1e-6)


def shaded(origin, direction, low, high, towards):
    """Where rays (n, 3) lie in the shadow of the box low..high: (n,) begin and end, along the ray.

    A point is shaded if it can be moved some t >= 0 along ``towards`` into the box. Every bound of
    the box is a least or a greatest t, linear in the point: the shadow is where no least one is
    above a greatest one.
    """
    least, greatest = [(np.zeros(3), 0.0)], []
    begin, end = np.zeros(len(direction)), np.full(len(direction), np.inf)
    planes = []
    for axis, d in enumerate(towards):
        normal = np.eye(3)[axis]
        if d == 0:
            planes += [(normal, high[axis]), (-normal, -low[axis])]
            continue
        near, far = (low[axis], high[axis]) if d > 0 else (high[axis], low[axis])
        least.append((-normal / d, near / d))
        greatest.append((-normal / d, far / d))
    planes += [(a - b, q - p) for a, p in least for b, q in greatest]
    for normal, offset in planes:
        # normal . (origin + s direction) <= offset
        slope, room = direction @ normal, offset - origin @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            at = room / slope
        begin = np.where(slope < 0, np.maximum(begin, at), begin)
        end = np.where(slope > 0, np.minimum(end, at), end)
        end = np.where((slope == 0) & (room < 0), -np.inf, end)
    return begin, np.maximum(begin, end)


def test_shadow_of_a_box_is_its_closed_form(tmp_path):
    scene, air = stage(tmp_path, BOX), Air(*AIR)
    rays = traced(scene, resolution=2048)
    found = np.asarray(march(air, rays))
    direction, length = np.asarray(rays.direction), np.asarray(rays.length)
    low, high = np.array([-0.45, 0.9, -5.5]), np.array([1.05, 1.5, -4.5])
    begin, end = shaded(np.zeros(3), direction, low, high, TOWARDS)
    begin, end = np.minimum(begin, length), np.minimum(end, length)
    beta = np.asarray(air.beta_ex)
    left = [np.exp(-beta * s[:, None]) for s in (begin, end, length)]
    sun = 4.0 * np.asarray(sunlight(3.0, np.arccos(TOWARDS[1]))) / beta
    open_ = np.asarray(air.scattered(rays.direction @ jnp.asarray(TOWARDS))) * sun
    expected = open_ * (1 - left[0] + left[1] - left[2])
    assert ((end > begin + 0.2) & (length > 20)).sum() > 20
    # Of the light without the box: a texel at the shadow's edge is part lit.
    off = np.abs(found - expected) / (open_ * (1 - left[2]))
    assert np.sqrt((off**2).mean()) < 1e-3
    assert np.quantile(off, 0.99) < 3e-3


@pytest.mark.parametrize("source", ["sun", "lamp"])
def test_twice_the_steps_and_twice_the_map_change_little(tmp_path, source):
    light = (0.0, 80.0, -60.0) if source == "sun" else (0.4, 0.8, -4.0)
    scene, air = stage(tmp_path, BOX + BALL, light), Air(*AIR)
    whole = np.asarray(march(air, traced(scene, source)))
    for finer in ({"steps": 256}, {"resolution": 2048}):
        change = np.asarray(march(air, traced(scene, source, **finer))) - whole
        assert np.sqrt((change**2).mean() / (whole**2).mean()) < 3e-3


def test_lamp_is_the_integral(tmp_path):
    scene, air = stage(tmp_path, light=(0.4, 0.8, -4.0)), Air(*AIR)
    rays = traced(scene, "lamp", 128)
    found = np.asarray(march(air, rays))
    lamp, beta = np.array([0.4, 0.8, -4.0]), np.asarray(air.beta_ex)
    for i in (0, 100, 250, 301, 575):
        d, length = np.asarray(rays.direction[i], float), float(rays.length[i])

        def light(s, d=d):
            """(3, n) of all channels at places (n,) along the ray."""
            to = lamp - s[:, None] * d
            r = np.linalg.norm(to, axis=-1)[:, None]
            scattered = np.asarray(air.scattered(jnp.asarray(to @ d / r[:, 0])))
            return (scattered * 4.0 / r**2 * np.exp(-beta * (s[:, None] + r))).T

        # Up to where the ray is nearest to the lamp, and from there.
        middle = min(max(float(d @ lamp), 0.0), length)
        parts = ((0.0, middle), (middle, length))
        expected = sum(integrate.fixed_quad(light, *part, n=400)[0] for part in parts)
        np.testing.assert_allclose(found[i], expected, rtol=1e-4)


@pytest.mark.parametrize("source", ["sun", "lamp"])
def test_derivatives_are_those_of_differences(tmp_path, source):
    light = (0.0, 80.0, -60.0) if source == "sun" else (0.4, 0.8, -4.0)
    rays = traced(stage(tmp_path, BOX, light, size=8), source)

    def of_values(z):
        return (march(Air(*z), rays) * jnp.array([[1.0, 2.0, 3.0]])).mean()

    mean, slopes = quick_jit(of_values), quick_jit(jax.grad(of_values))
    for z in (AIR, (0.995, 0.0, 4.0, 4e3), (3.0, 0.6, 0.0, 4e3)):
        z = jnp.array(z)
        slope = slopes(z)
        for i, size in enumerate((1.0, 0.5, 1.0, 1e3)):
            way = jnp.zeros(4).at[i].set(1e-3 * size)
            one, two = (float(mean(z + k * way) - mean(z - k * way)) for k in (1, 2))
            assert float(slope[i]) == pytest.approx(
                (8 * one - two) / (12e-3 * size), rel=1e-5, abs=1e-12
            )


@pytest.mark.parametrize("source", ["sun", "lamp"])
def test_limits_are_finite(tmp_path, source):
    scene = stage(tmp_path, BALL, (0.0, 0.0, -4.0), size=9)
    length = np.linspace(0.0, 20.0, 81)
    # The middle ray runs through the lamp itself; the first has no length.
    rays = traced(scene, source, length=length)

    @quick_filter_jit
    @eqx.filter_value_and_grad
    def sum_and_slopes(air):
        return march(air, rays).sum()

    for z in ((3.0, 0.6, 4.0, 0.0), (0.995, 0.9, 4.0, 4e3), AIR):
        value, slope = sum_and_slopes(Air(*z))
        assert np.isfinite(float(value))
        assert all(np.isfinite(g) for g in jax.tree.leaves(slope))


def test_the_sun_may_stand_behind_an_object(tmp_path):
    """The camera is in the ball's shadow, and rays beside the ball come out of it."""
    scene = stage(tmp_path, BALL.replace("-0.6, 0.1, -3", "0, 0, -3"), (0.0, 0.0, -40.0), size=9)
    lit = np.asarray(traced(scene).lit)
    assert lit[:, 40].max() == 0
    assert lit[0].max() == 0
    assert (lit[-1, [0, 8, 72, 80]] == 1).all()
    assert (np.diff(lit[:, 0]) >= 0).all()


def test_image_is_the_rays_and_the_background(tmp_path):
    scene, air = stage(tmp_path, BOX), Air(*AIR)
    distance = np.asarray(view_of_scene(scene).distance)
    image = render(scene, air, distance, resolution=1024)
    assert image.shape == (24, 24, 3)
    rays = np.asarray(march(air, traced(scene))).reshape(24, 24, 3)
    np.testing.assert_allclose(image, rays, rtol=1e-5)
    behind = render(scene, air, distance, resolution=1024, background=np.full((24, 24), 0.5))
    left = 0.5 * np.asarray(air.transmitted(jnp.asarray(distance)))
    np.testing.assert_allclose(behind - image, left, atol=1e-6)


def test_distances_are_those_of_the_box(tmp_path):
    scene = stage(tmp_path, BOX.replace("1.2, -5", "0.0, -5"))
    distance = np.asarray(view_of_scene(scene).distance)
    direction = view_rays(scene, np.arange(24 * 24)).reshape(24, 24, 3)
    front = distance < 30
    assert front.sum() > 5
    depth = distance * -direction[..., 2]
    # The front face stands at -4.5; its sides are seen from neither side here.
    np.testing.assert_allclose(depth[front], 4.5, rtol=1e-5)
    np.testing.assert_allclose(distance[~front], 30)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"steps": 0}, "steps: expected a whole number from 1 to 65536, got 0"),
        ({"resolution": 0}, "resolution: expected"),
        ({"source": "moon"}, "source: expected sun or lamp, got 'moon'"),
    ],
)
def test_bad_numbers_are_refused(tmp_path, options, words):
    scene = stage(tmp_path)
    with pytest.raises(InputError, match=words):
        render(scene, Air(*AIR), np.ones(scene.size), **options)


def test_agrees_with_mitsuba(tmp_path):
    """Five scenes against another's path tracer, whose noise (2%) is known for every value."""
    arrays, part = np.load(REFERENCES), 12
    side = theirs.SIZE * part
    for name, reference in theirs.REFERENCES.items():
        # A pixel is the mean over its area.
        scene = dataclasses.replace(theirs.scene_of(reference, tmp_path), size=(side, side))
        direction = view_rays(scene, np.arange(side**2))
        seen = np.asarray(view_of_scene(scene, 1e6).distance, np.float64).reshape(-1)
        length = np.minimum(seen, theirs.to_the_wall(direction))
        rays = traced(scene, "lamp", 128, 2048, length)
        image = np.asarray(march(theirs.air_of(reference), rays))
        image = image.reshape(theirs.SIZE, part, theirs.SIZE, part, 3).mean((1, 3))
        mean, error = arrays[f"{name}/mean"], arrays[f"{name}/error"]
        known = error > 0
        off = (image - mean)[known] / error[known]
        assert 0.85 < np.sqrt(np.mean(off[np.abs(off) < 4] ** 2)) < 1.2, name
        assert np.mean(np.abs(off) < 4) > 0.99, name
        noise = np.sqrt((error**2).sum()) / mean.sum()
        assert abs(image.sum() / mean.sum() - 1) < 4 * noise + 5e-3, name

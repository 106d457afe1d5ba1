"""Masks from scenes: against rays, supersampling, differences of both, and WebGL."""

import dataclasses
import functools
import json
import math

import equinox as eqx
import imageio.v3 as imageio
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from godfit.scenes import contours, mesh, projection, raster, visibility
from godfit.scenes.scene import Camera, Light, Object, Scene
from tests.support import raster_oracle as oracle
from tests.support.paths import SHARED

WEBGL, MODELS = SHARED / "targets" / "webgl", SHARED / "models"
CLOSE = 1e-9

# Each scene has a program of its own, which runs a few times: to compile it takes three times as
# long where LLVM optimises it. Fits have the optimised programs (models/test_staged.py).
compiled = functools.partial(eqx.filter_jit, compiler_options={"xla_backend_optimization_level": 0})
rasterise = compiled(raster.rasterise)
visible = compiled(raster.visible)
# The same values as with a derivative, of which a mask beside its gradient is made.
coverage = compiled(functools.partial(raster.coverage, still=True))


def array(values):
    return jnp.asarray(values, float)


def built(vertices, faces, position=(0, 0, 0), rotation=(0, 0, 0), scale=1.0, colour=0.0):
    """An object as it is given: nothing is cleaned away."""
    faces = np.asarray(faces, np.int32)
    return Object(
        array(vertices),
        jnp.asarray(faces),
        jnp.asarray(mesh.edges(faces)),
        array(position),
        array(rotation),
        array(scale),
        (colour,) * 3,
    )


def thing(kind, *pose, sizes=None, colour=0.0):
    shape = mesh.primitive(kind, **(sizes or {}))
    return built(shape.vertices, shape.faces, *pose, colour=colour)


def stage(*objects, light=(0.3, 0.2, -2), radius=0.5, eye=(0.1, 0.2, 5), fov_y=50, size=(48, 64)):
    return Scene(
        Camera(array(eye), array([0, 0, 0]), array([0.05, 1, 0]), array(fov_y), 0.1, 50.0),
        Light(array(light), array(radius), (1.0,) * 3),
        objects,
        (0.1,) * 3,
        size,
    )


BOX = {"size": [0.8, 1.3, 0.5]}
TORUS = {"radius": 0.7, "tube": 0.25, "radial_segments": 7, "tubular_segments": 14}
RING = {"radius": 0.7, "tube": 0.25, "radial_segments": 5, "tubular_segments": 6}
# 0.3 of a pixel, at the distance of 5 and with 48 rows for 50 degrees.
STRUT = {"radius": 0.015, "height": 3.0, "segments": 5}
BALL = {"radius": 0.6, "subdivisions": 1}
SCENES = {
    "box": stage(thing("box", (0.4, 0.3, 0), (20, 30, 10), sizes=BOX)),
    # The corner that points at the torus lies in its plane of symmetry and on its outer circle.
    "torus that touches a box": stage(
        thing("torus", (-0.55, 0, 0), (0, 0, 0), sizes=TORUS),
        thing("box", (0.4 + 0.5 * math.sqrt(0.5), 0, 0), (0, 0, 45), 0.5, sizes={"size": [1.0] * 3},
              colour=0.4),
    ),
    "thin struts": stage(
        *(thing("cylinder", (x, 0.1, 0.3), (7 * x, 0, 20 + 35 * x), sizes=STRUT)
          for x in (-1.2, -0.4, 0.5, 1.1)),
    ),
    "two colours through each other": stage(
        thing("box", (0.1, 0.1, 0.1), (25, 40, 10), sizes=BOX),
        thing("icosphere", (0.4, -0.2, 0.2), (10, 0, 0), sizes=BALL, colour=0.6),
        thing("torus", (0, 0.1, -0.1), (60, 20, 0), sizes=TORUS, colour=0.3),
    ),
    "floor from behind the camera": stage(
        thing("plane", (0, -0.6, 2), (-90, 0, 3), sizes={"width": 3.0, "height": 20.0}),
        thing("box", (0.5, 0.2, 1), (0, 20, 0), sizes=BOX, colour=0.3),
    ),
    "torus around the camera": stage(
        thing("torus", (0.1, 0.2, 4.6), (75, 20, 0), sizes=RING),
        thing("box", (0.4, 0.3, 0), (20, 30, 10), sizes=BOX, colour=0.3),
        # Most of the torus fills the picture: a ray for every sample and triangle takes long.
        size=(24, 32),
    ),
    "light partly hidden": stage(
        thing("box", (0.35, 0.4, 1.5), (20, 30, 10), sizes=BOX), light=(0.0, 0.1, 0.2)
    ),
    "light in a box": stage(
        thing("box", (0.1, 0.1, 0.1), (25, 40, 10), sizes=BOX, colour=0.3), light=(0, 0, 0)
    ),
    "light off the screen": stage(
        thing("box", (0.4, 0.3, 0), (20, 30, 10), sizes=BOX), light=(9, 3, -2)
    ),
    "light across the border": stage(
        thing("box", (1.7, 0.3, 0), (20, 30, 10), sizes=BOX), light=(1.9, 1.3, 1.5)
    ),
    "nothing on the screen": stage(thing("box", (9, 0, 0), sizes=BOX), light=(-9, 3, -2)),
    "objects beyond far": stage(thing("box", (0, 0, -60), sizes=BOX), light=(0.0, 3.0, -70.0)),
    "no objects": stage(),
}  # fmt: skip
# Those whose contours are edges, and exact.
SMOOTH = [
    "box",
    "torus that touches a box",
    "thin struts",
    "floor from behind the camera",
    "torus around the camera",
    "light partly hidden",
    "light across the border",
]
# Where a line of intersection passes a cell twice, its colour in between is missed.
CROSSED = ["two colours through each other", "light in a box"]
POSE = ("light.position", "light.radius", "camera.position", "camera.fov_y",
        "object[0].position", "object[0].rotation", "object[0].scale")  # fmt: skip


def colours(scene) -> np.ndarray:
    """(labels, colours) 1 where a label has a colour of the palette."""
    by_label = [scene.background, scene.light.colour, *(o.colour for o in scene.objects)]
    return np.array([[float(c == p) for p in raster.palette(scene)] for c in by_label])


def weight(size, phase=0.0) -> np.ndarray:
    """Smooth over the picture."""
    y, x = np.mgrid[: size[0], : size[1]] / max(size)
    return 1 + 0.7 * np.sin(5 * x + phase) * np.cos(4 * y - 1) + 0.5 * x * y


def loss(scene, antialias=True):
    mask = raster.rasterise(scene, antialias=antialias)
    return (mask * weight(scene.size)).sum(), mask


# One program has the mask and its derivative.
loss_and_gradient = compiled(eqx.filter_value_and_grad(loss, has_aux=True))


def gradient(scene):
    return loss_and_gradient(scene)[1]


def exact_loss(scene) -> float:
    """The same without a derivative, and compiled already for the other tests."""
    values = np.array([c[0] for c in raster.palette(scene)])
    return ((np.asarray(coverage(scene)) @ values) * weight(scene.size)).sum()


def sampled_loss(scene) -> float:
    return (oracle.mask(scene, 32) * weight(scene.size)).sum()


def differences(function, scene, name, step) -> np.ndarray:
    """Central differences of a scene's number; ``step`` is in its unit."""
    value = np.asarray(scene.value(name), float)
    out = np.zeros(value.shape)
    for k in np.ndindex(value.shape):
        ends = []
        for sign in (1, -1):
            moved = value.copy()
            moved[k] += sign * step
            ends.append(function(scene.replaced({name: jnp.asarray(moved)})))
        out[k] = (ends[0] - ends[1]) / (2 * step)
    return out


def finite(tree) -> bool:
    return all(bool(jnp.isfinite(z).all()) for z in jax.tree.leaves(tree))


@pytest.mark.parametrize("name", SCENES)
class TestAgainstRays:
    def test_labels_and_depth(self, name):
        label, depth = visible(SCENES[name])
        expected, expected_depth = oracle.nearest(SCENES[name])
        same = np.asarray(label) == expected
        assert (~same).sum() <= 2
        np.testing.assert_allclose(depth[same], expected_depth[same], rtol=1e-7)

    def test_coverage(self, name):
        scene = SCENES[name]
        share = np.asarray(coverage(scene))
        expected = oracle.shares(scene, 32) @ colours(scene)
        np.testing.assert_allclose(share.sum(-1), 1, atol=CLOSE)
        assert share.min() >= 0
        error, edge = np.abs(share - expected), expected.max(-1) < 1
        assert error[edge].sum() <= 0.005 * error[edge].size
        # Further than a pixel from every contour.
        pure = ~edge
        for axis in (0, 1):
            for shift in (1, -1):
                pure &= (np.roll(expected, shift, axis) == expected).all(-1)
        assert error[pure].max(initial=0) < CLOSE
        area = expected.sum((0, 1))
        # Besides, what supersampling is uncertain of.
        allowed = (2e-2 if name in CROSSED else 5e-4) * area + 0.005
        assert (np.abs(share.sum((0, 1)) - area) <= allowed).all()


@pytest.mark.parametrize("name", SMOOTH)
def test_gradient_is_that_of_the_exact_loss(name):
    scene = SCENES[name]
    (value, _), found = loss_and_gradient(scene)
    assert finite(found)
    assert value == pytest.approx(exact_loss(scene), rel=1e-12)
    for key in POSE:
        step = 1e-3 if key.endswith(("rotation", "fov_y")) else 1e-4
        expected = differences(exact_loss, scene, key, step)
        largest = np.abs(expected).max()
        np.testing.assert_allclose(found.value(key), expected, rtol=0, atol=1e-4 * largest + 1e-6)


def test_gradient_where_surfaces_pass_through_each_other():
    """Lines of intersection are found by scan lines: a few of them, between others, are missed. A
    light that passes through a box is below."""
    keys = ("camera.position", "camera.fov_y", "object[0].position", "object[0].scale")
    scene = dataclasses.replace(SCENES[CROSSED[0]], size=(96, 128))
    found = gradient(scene)
    assert finite(found)
    for key in keys:
        expected = differences(exact_loss, scene, key, 0.3 if key.endswith("fov_y") else 0.03)
        largest = np.abs(expected).max()
        np.testing.assert_allclose(found.value(key), expected, rtol=0, atol=0.06 * largest)


def test_gradient_where_the_near_plane_cuts_a_box():
    """The outline in sight is the cut, whose corners slide along the box's edges."""
    box = thing("box", (0.097, 0.205, 4.86), (8, 5, 20), sizes={"size": [0.05, 0.035, 0.2]})
    scene = stage(box)
    assert 0.1 < (np.asarray(visible(scene).label) == 2).mean() < 0.3
    found = gradient(scene)
    for key in ("object[0].position", "object[0].rotation", "camera.position", "object[0].scale"):
        expected = differences(exact_loss, scene, key, 1e-3 if key.endswith("rotation") else 1e-5)
        largest = np.abs(expected).max()
        np.testing.assert_allclose(found.value(key), expected, rtol=0, atol=0.01 * largest)


def test_gradient_of_a_light_far_off_the_axis():
    """Rays to it are longer than their share along the view, by which depths on the light's sphere
    are computed, where it passes through a box."""
    box = thing("box", (3.1, 2.2, 0.6), (25, 40, 10), sizes={"size": [2.0, 2.2, 1.8]}, colour=0.3)
    scene = stage(box, light=(3.2, 2.2, 0.6), radius=1.25, fov_y=95, size=(96, 128))
    found = gradient(scene)
    for key in ("light.position", "light.radius", "camera.position", "object[0].position"):
        expected = differences(exact_loss, scene, key, 0.01)
        largest = np.abs(expected).max()
        np.testing.assert_allclose(found.value(key), expected, rtol=0, atol=0.01 * largest)


def test_gradient_is_that_of_the_supersampled_loss():
    scene = SCENES["light partly hidden"]
    found = gradient(scene)
    # Steps of about half a pixel; of all the pose by differences of exact masks above.
    for key, step in (("light.radius", 0.05), ("object[0].rotation", 4.0)):
        expected = differences(sampled_loss, scene, key, step)
        largest = np.abs(expected).max()
        np.testing.assert_allclose(found.value(key), expected, rtol=0, atol=0.02 * largest)


def test_forward_and_reverse_mode_agree():
    scene = SCENES["floor from behind the camera"]
    arrays, rest = eqx.partition(scene, eqx.is_inexact_array)
    rng = np.random.default_rng(0)
    tangent = jax.tree.map(lambda z: jnp.asarray(rng.standard_normal(z.shape)), arrays)

    @compiled
    def forward(arrays, tangent):
        return jax.jvp(lambda z: raster.rasterise(eqx.combine(z, rest)), (arrays,), (tangent,))[1]

    products = jax.tree.map(lambda a, b: (a * b).sum(), tangent, gradient(scene))
    expected = (forward(arrays, tangent) * weight(scene.size)).sum()
    np.testing.assert_allclose(sum(jax.tree.leaves(products)), expected, rtol=1e-9)


# Three corners on a line, two corners in one place, a face that names a vertex twice, a face seen
# edge on, one there twice, an edge of three faces, a vertex that no face has, and a good face.
CORNERS = [
    [-1, -1, 0], [0, 0, 0], [1, 1, 0], [1, 1, 0], [-1, 1, 0.2], [0, 0, 1], [0, 0, 2], [9, 9, 9],
    [0.5, -1, 0.3],
]  # fmt: skip
FACES = [
    [0, 1, 2], [0, 2, 3], [4, 4, 0], [1, 5, 6], [0, 4, 2], [0, 4, 2], [0, 8, 2], [0, 2, 6],
]  # fmt: skip


def strip(*corners) -> Scene:
    """Two faces with a common edge, in front of a camera at (0, 0, 5) that looks along -z."""
    return stage(built(corners, [[0, 1, 2], [0, 2, 3]]), eye=(0.0, 0.0, 5.0))


HARD = {
    "faces without area": stage(built(CORNERS, FACES), eye=(0.0, 0.0, 5.0)),
    "all on a line": strip([-1, -1, 0], [0, 0, 0], [1, 1, 0], [2, 2, 0]),
    "all in one place": strip(*[[0.1, 0.2, 0.3]] * 4),
    "seen edge on": strip([0, -1, 1], [0, 1, 1], [0, 1, 0], [0, -1, 0]),
    "through the camera": strip([-1, -1, 8], [1, -1, 8], [0, 1.5, 2], [0, 0.7, -3]),
    "a corner in the camera": strip([0, 0, 5], [1, -1, 0], [0, 1.5, 2], [-1, 1, 1]),
    "a corner beside the camera": strip([1, 0.3, 5], [1, -1, 0], [0, 1.5, 2], [-1, 1, 1]),
    "an edge in the near plane": strip([0, 0, 4.9], [1, -1, 4.9], [0, 1.5, 2], [-1, 1, 1]),
    "camera in a box": stage(thing("box", (0, 0, 5), sizes={"size": [4.0, 4.0, 4.0]})),
    "light cut by the near plane": stage(
        thing("box", (9, 0, 0), sizes=BOX), light=(0.1, 0.1, 4.0), radius=0.92
    ),
    "everything off the screen": SCENES["nothing on the screen"],
    "everything behind": stage(thing("box", (0.0, 0.0, 9.0), sizes=BOX), light=(40.0, 0.0, 0.0)),
}


@pytest.mark.parametrize("name", HARD)
def test_hard_cases_stay_finite(name):
    scene = HARD[name]
    np.testing.assert_allclose(np.asarray(coverage(scene)).sum(-1), 1, atol=CLOSE)
    expected = oracle.mask(scene, 8)
    (_, mask), slopes = loss_and_gradient(scene)
    error = np.abs(np.asarray(mask) - expected)
    # Eighths of pixels are what it is measured in.
    assert error.max() < 0.06
    assert error.mean() < 2e-4
    assert finite(slopes)


def test_off_screen_has_no_derivative():
    found = jax.tree.leaves(gradient(SCENES["nothing on the screen"]))
    assert max(float(jnp.abs(z).max()) for z in found) == 0


def test_hard_mask():
    """The colours at the pixel centres, without derivative."""
    scene = SCENES["two colours through each other"]
    (_, hard), found = loss_and_gradient(scene, antialias=False)
    by_label = np.array([0.1, 1.0, *(o.colour[0] for o in scene.objects)])
    np.testing.assert_array_equal(hard, by_label[np.asarray(visible(scene).label)])
    assert max(float(jnp.abs(z).max()) for z in jax.tree.leaves(found)) == 0


def test_compiled_is_eager():
    scene = SCENES["box"]
    (_, mask), _ = loss_and_gradient(scene)
    np.testing.assert_allclose(raster.rasterise(scene), mask, atol=CLOSE)


def test_single_precision(single_precision):
    def rounded(tree):
        return jax.tree.map(
            lambda z: jnp.asarray(z, jnp.float32) if eqx.is_inexact_array(z) else z, tree
        )

    scene = SCENES["light partly hidden"]
    with jax.enable_x64(True):
        (_, expected), slope = loss_and_gradient(scene)
    (_, found), slopes = loss_and_gradient(rounded(scene))
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, expected, atol=1e-4)
    for key in POSE:
        reference = np.asarray(slope.value(key))
        actual = slopes.value(key)
        assert actual.dtype == jnp.float32
        np.testing.assert_allclose(actual, reference, atol=2e-3 * np.abs(reference).max())


def test_colours_that_are_not_grey():
    scene = stage(thing("box", (0.4, 0.3, 0), (20, 30, 10), sizes=BOX))
    red = dataclasses.replace(scene, background=(0.3, 0.0, 0.1))
    mask = np.asarray(rasterise(red))
    assert mask.shape == (48, 64, 3)
    np.testing.assert_allclose(mask, np.asarray(coverage(red)) @ np.array(raster.palette(red)))


@pytest.mark.parametrize("antialias", [True, False])
def test_light_behind_the_camera(antialias):
    with pytest.raises(Exception, match="light: expected it before the camera, got a place behind"):
        jax.block_until_ready(rasterise(stage(light=(0.0, 0.0, 9.0)), antialias=antialias))


def test_too_many_contours(monkeypatch):
    monkeypatch.setattr(raster, "FRAGMENT_ROOM", 0)
    scene = stage(thing("box", (0.4, 0.3, 0), (20, 30, 10), sizes=BOX), size=(4, 4), radius=2.0)
    with pytest.raises(Exception, match="pieces of contour in 4x4 pixels"):
        jax.block_until_ready(raster.rasterise(scene))


def test_light_on_the_screen():
    """A tiny light is seen where its centre is said to be."""
    scene = stage(light=(0.7, -0.4, 1.0), radius=0.1)
    share = np.asarray(coverage(scene))[..., 1]
    height, width = scene.size
    y, x = np.mgrid[:height, :width] + 0.5
    u, v = (share * x).sum() / share.sum() / width, 1 - (share * y).sum() / share.sum() / height
    np.testing.assert_allclose(raster.on_screen(scene), [u, v], atol=2e-3)


def test_area_of_the_light():
    """A sphere off the axis is an ellipse, of an area that a formula gives."""
    scene = stage(light=(0.9, -0.4, 1.0), radius=0.6)
    turn, position = oracle.view(scene)
    centre = turn @ (np.asarray(scene.light.position) - position)
    squared, depth = centre @ centre - 0.6**2, centre[2] ** 2 - 0.6**2
    expected = math.pi * 0.6**2 * math.sqrt(squared) / depth**1.5
    expected *= (24 / math.tan(math.radians(25))) ** 2
    np.testing.assert_allclose(np.asarray(coverage(scene))[..., 1].sum(), expected, rtol=1e-6)


@pytest.mark.parametrize("crossing", [False, True])
def test_whole_outline_of_the_light_counts(crossing):
    """Moved outwards, every piece of the outline uncovers its own length."""
    rng = np.random.default_rng(0)
    for _ in range(10):
        x, y, radius = rng.uniform([-0.8, -0.6, 0.1], [0.8, 0.6, 1.0])
        view = raster._view(stage(light=(x, y, -2), radius=radius, size=(240, 320)))
        drawing = raster._draw((240, 320), 0.1, 50.0, view)
        corners, edges = drawing.mesh.vertices, np.asarray(view.edges)
        sources = projection.EdgeSources(corners, edges, 0, drawing.cuts)
        outline = projection.screen_edges(sources, drawing.scene.lens, (240, 320))
        found = contours.contours(drawing.scene, outline, drawing.label, np.array([0, 1]), crossing)
        along = outline.ends[:, 2:] - outline.ends[:, :2]
        length = np.linalg.norm(along, axis=-1)
        across = np.stack([along[:, 1], -along[:, 0]], -1) / length[:, None]
        uncovered = np.zeros(len(length))
        moved = found.weight[:, 1, :2] + found.weight[:, 1, 2:]
        np.add.at(uncovered, found.edge, (moved * across[found.edge]).sum(-1))
        np.testing.assert_allclose(np.abs(uncovered), length, rtol=1e-6)


def test_area_of_a_quadrilateral():
    scene = stage(thing("plane", (0.2, 0.3, 0.5), (30, 40, 50)), light=(90.0, 0.0, 0.0))
    turn, position = oracle.view(scene)
    x, y, z = turn @ (np.asarray(scene.objects[0].world()) - position).T
    focal = 24 / math.tan(math.radians(25))
    u, v = x / -z * focal, y / -z * focal
    expected = 0.5 * (u * np.roll(v, -1) - v * np.roll(u, -1)).sum()
    found = np.asarray(coverage(scene))[..., 2].sum()
    np.testing.assert_allclose(found, abs(expected), rtol=1e-9)


class TestTopLeftRule:
    LENS = projection.Lens(4.0, 4.0, 4.0, 4.0, 0.1, 100.0)

    def labels(self, vertices, faces, face_label):
        shape = projection.CameraMesh(
            np.array(vertices, float), np.array(faces, np.int32), np.array(face_label, np.int32)
        )
        triangles, _ = projection.screen_triangles(shape, self.LENS, (8, 8))
        nowhere = projection.Sphere(np.array([0.0, 900.0, -1.0]), 0.1)
        scene = projection.ProjectedScene(triangles, nowhere, self.LENS)
        return visibility.label_pixels(scene, (8, 8))[0]

    @pytest.mark.parametrize("turned", [False, True])
    def test_borders_through_pixel_centres(self, turned):
        """Left and top belong, right and bottom do not, whichever way the face is turned."""
        square = [[-1.5, 2.5, -4], [-1.5, -1.5, -4], [2.5, -1.5, -4], [2.5, 2.5, -4]]
        faces = np.array([[0, 1, 2], [0, 2, 3]])[:, :: -1 if turned else 1]
        expected = np.zeros((8, 8), int)
        expected[1:5, 2:6] = 2
        np.testing.assert_array_equal(self.labels(square, faces, [2, 2]), expected)

    def test_neighbours_share_every_centre_once(self):
        """Eight faces around a pixel centre: no centre is missed, and each has one owner."""
        ring = [[2, 0], [2, 2], [0, 2], [-2, 2], [-2, 0], [-2, -2], [0, -2], [2, -2]]
        corners = [[-0.5, 0.5, -4], *([x - 0.5, y + 0.5, -4] for x, y in ring)]
        faces = [[0, 1 + k, 1 + (k + 1) % 8] for k in range(8)]
        alone = [self.labels(corners, [f], [2]) == 2 for f in faces]
        expected = np.zeros((8, 8), int)
        expected[1:5, 1:5] = 1
        np.testing.assert_array_equal(np.sum(alone, 0), expected)


def webgl_scene(meta) -> Scene:
    """The scene that a target of shared/ was drawn from."""
    name, position, scale, radius, colour, near, far = {
        "Skull": ("skull", (0, 0, 3), 1.0, 0.8, 0.0, 0.1, 350.0),
        "Icosahedron": ("icosahedron", (0, 0, 4), 1.0, 1.5, 0.0, 0.1, 35.0),
        "Satellite": ("satellite", (0, 5, 75), 0.01, 3.0, 1 / 255, 0.1, 5000.0),
    }[meta["scene"]]
    rotation, n = (0.0, 0.0, 0.0), meta.get("animation_updates") or 0
    if n:
        angle = 0.009 * (n - 1)
        position = 4 * math.sin(angle), 0, 4 * math.cos(angle)
        rotation = math.degrees(0.01 * n), 0.0, math.degrees(0.005 * n)
    shape = mesh.load(MODELS / name / "scene.gltf")
    width, height = meta["occlusion_size"]
    background = int(meta["occlusion_clear_colour"][1:3], 16) / 255
    return Scene(
        Camera(
            array(meta["camera_pos"]), array([0, 0, 0]), array([0, 1, 0]),
            array(meta["camera_fov_y"]), near, far,
        ),
        Light(array(meta["light_world"]), array(radius), (1.0,) * 3),
        (built(shape.vertices, shape.faces, position, rotation, scale, colour),),
        (background,) * 3,
        (height, width),
    )  # fmt: skip


@pytest.mark.skipif(not WEBGL.is_dir() or not MODELS.is_dir(), reason="no shared/ here")
@pytest.mark.parametrize(
    "name",
    ["dawn_skull_default_512", "dawn_icosa_clip_512", "dawn_satellite_offcentre_640x360"],
)
def test_hard_mask_is_that_of_webgl(name):
    scene = webgl_scene(json.loads((WEBGL / f"{name}.json").read_text()))
    theirs = imageio.imread(WEBGL / f"{name}_occlusion.png")
    theirs = (theirs if theirs.ndim == 2 else theirs[..., :3].max(-1)).astype(int)
    ours = np.round(np.asarray(rasterise(scene, antialias=False)) * 255).astype(int)
    assert ours.shape == theirs.shape
    differ, lit = np.abs(ours - theirs) > 2, (ours > 128) | (theirs > 128)
    # The outline of the light is a polygon there.
    assert differ.mean() <= 3e-4
    assert (differ & ~lit).mean() <= 1e-4

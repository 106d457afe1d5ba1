"""The ordinary pass: against rays, and which object is in which pass."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from godfit.scenes import mesh
from godfit.scenes.ordinary import RAYS_A_SIDE, ordinary_pass
from godfit.scenes.scene import Camera, Light, Object, Scene, Shading
from godfit.scenes.view import drawn_mask
from tests.support import raster_oracle as oracle

SKY = (0.02, 0.04, 0.08)


def thing(kind, position, rotation, albedo, sizes=None, **passes):
    shape = mesh.primitive(kind, **(sizes or {}))
    pose = (jnp.asarray(z, float) for z in (position, rotation, 1.0))
    edges = jnp.asarray(mesh.edges(shape.faces))
    vertices = jnp.asarray(shape.vertices, float)
    return Object(vertices, jnp.asarray(shape.faces), edges, *pose, (0.0,) * 3, albedo, **passes)


BALL = {"radius": 0.6, "subdivisions": 1}
OBJECTS = (
    thing("box", (0.5, 0.3, 0.2), (20, 30, 10), (0.8, 0.5, 0.3)),
    thing("icosphere", (-0.7, -0.2, 0.5), (10, 0, 0), (0.3, 0.6, 0.9), BALL),
    thing("plane", (0, -1, 0), (-80, 0, 0), (0.5, 0.5, 0.5), {"width": 6.0, "height": 4.0}),
)


def stage(*objects, **fields):
    def array(values):
        return jnp.asarray(values, float)

    camera = (0.1, 0.2, 5), (0, 0, 0), (0.05, 1, 0), 50
    return Scene(
        Camera(*map(array, camera), 0.1, 50.0),
        Light(array((0.4, 1.5, 2)), array(0.3), (1.0, 0.9, 0.7)),
        objects,
        (0.1,) * 3,
        (18, 24),
        shading=Shading(SKY, 0.15, 0.7),
        **fields,
    )


def traced(scene, rays):
    """(h, w, 3) a ray for every sample, every triangle tried, and Lambert's law from its words."""
    h, w = (n * rays for n in scene.size)
    turn, eye = oracle.view(scene)
    half = np.tan(np.deg2rad(float(scene.camera.fov_y)) / 2)
    x = (((np.arange(w) + 0.5) / w * 2 - 1) * half * w / h)[None]
    y = ((1 - (np.arange(h) + 0.5) / h * 2) * half)[:, None]
    light = turn @ (np.asarray(scene.light.position, float) - eye)
    image, depth = np.tile(np.array(scene.shading.colour), (h, w, 1)), np.full((h, w), np.inf)
    for body in scene.objects:
        corners = (np.asarray(body.world(), float) - eye) @ turn.T
        for a, b, c in corners[np.asarray(body.faces)]:
            t = oracle.hit(a, b, c, x, y)
            row, column = np.nonzero((t > 0) & (t < depth))
            depth[row, column] = t[row, column]
            rays_to = np.stack([x[0, column], y[row, 0], -np.ones(len(row))], -1)
            point = t[row, column, None] * rays_to
            normal = np.cross(b - a, c - a)
            normal = normal / -np.linalg.norm(normal) * np.sign(point @ normal)[:, None]
            away = light - point
            cosine = (normal * away).sum(-1) / np.linalg.norm(away, axis=-1)
            lit = scene.shading.diffuse * cosine.clip(0)[:, None] * np.array(scene.light.colour)
            image[row, column] = np.array(body.albedo) * (scene.shading.ambient + lit)
    return image.reshape(h // rays, rays, w // rays, rays, 3).mean((1, 3))


@pytest.mark.parametrize(("antialias", "rays"), [(None, RAYS_A_SIDE), (False, 1)])
def test_it_is_what_rays_find(antialias, rays):
    scene = stage(*OBJECTS, antialias=antialias)
    image = ordinary_pass(scene)
    off = np.abs(image - traced(scene, rays)).max(-1)
    assert image.dtype == np.float32
    # A ray that meets an edge exactly may end on either side of it.
    assert np.count_nonzero(off > 1e-5) <= 2
    assert len(np.unique(image)) > 100


def test_an_object_is_in_the_passes_that_it_names():
    hidden = dataclasses.replace(OBJECTS[1], in_ordinary=False)
    shown = dataclasses.replace(OBJECTS[1], in_mask=False)
    both, without = stage(*OBJECTS), stage(OBJECTS[0], OBJECTS[2])
    in_mask, in_ordinary = stage(hidden, *OBJECTS[::2]), stage(*OBJECTS[::2], shown)
    image, empty = ordinary_pass(both), ordinary_pass(without)
    np.testing.assert_array_equal(ordinary_pass(in_mask), empty)
    np.testing.assert_array_equal(ordinary_pass(in_ordinary), image)
    assert np.abs(image - empty).max() > 0.2
    full, holed = drawn_mask(both, False), drawn_mask(without, False)
    np.testing.assert_array_equal(drawn_mask(in_mask, False), full)
    np.testing.assert_array_equal(drawn_mask(in_ordinary, False), holed)
    assert np.abs(full - holed).max() > 0.09


def test_grey_passes_have_one_channel():
    grey = [dataclasses.replace(obj, albedo=(0.5,) * 3) for obj in OBJECTS]
    scene = stage(*grey)
    white = dataclasses.replace(scene.light, colour=(1.0,) * 3)
    scene = dataclasses.replace(scene, light=white, shading=Shading())
    assert ordinary_pass(scene).shape == (18, 24)
    assert ordinary_pass(dataclasses.replace(scene, objects=())).max() == 0

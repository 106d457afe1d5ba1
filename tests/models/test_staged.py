"""Scenes in the fit: masks as the target has them, and what of the scene is free."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import godfit
from godfit.errors import InputError
from godfit.models.mitchell import Mitchell
from godfit.models.staged import Staged
from godfit.scenes import mesh
from godfit.scenes.raster import on_screen, rasterise
from godfit.scenes.scene import Camera, Light, Object, Scene
from godfit.scenes.view import drawn_mask
from godfit.search import edge_pixels, placement
from tests.support import random_targets

SIZE, SAMPLES = 96, 40
# No other size of the pass is tried, nor the reason of a wrong answer asked for.
ALONE = {"inquire": False, "pass_scale": 1.0}
TRUTH = {"exposure": 0.1, "decay": 0.965, "density": 0.85, "weight": 0.6, "samples": SAMPLES}


def stage(size=SIZE):
    """A torus before a light that looks through its hole, and a box beside it."""

    def thing(kind, position, rotation, **sizes):
        shape = mesh.primitive(kind, **sizes)
        return Object(
            jnp.asarray(shape.vertices, float),
            jnp.asarray(shape.faces),
            jnp.asarray(mesh.edges(shape.faces)),
            jnp.array(position),
            jnp.array(rotation),
            jnp.asarray(1.0),
            (0.0, 0.0, 0.0),
        )

    camera = Camera(
        jnp.array([0.5, 1.0, 6.0]),
        jnp.zeros(3),
        jnp.array([0.0, 1.0, 0.0]),
        jnp.asarray(60.0),
        0.1,
        100.0,
    )
    light = Light(jnp.array([0.6, 0.4, -3.0]), jnp.asarray(1.2), (1.0, 1.0, 1.0))
    torus = thing("torus", [0.2, 0.3, 0.0], [20.0, 30.0, 10.0], radius=1.0, tube=0.25)
    box = thing("box", [-0.8, 0.0, 1.0], [0.0, 10.0, 5.0], size=[0.3, 3.0, 0.2])
    return Scene(camera, light, (torus, box), (34 / 255, 34 / 255, 34 / 255), (size, size))


def target(scene, mask):
    """Bytes of the light pass through ``mask``, in float64 by other code."""
    u, v = np.asarray(on_screen(scene), float)
    values = TRUTH | {"light_x": float(u), "light_y": float(v)}
    return random_targets.to_bytes(random_targets.render64(mask.astype(float), values)), values


@pytest.mark.usefixtures("single_precision")
@pytest.mark.parametrize("antialias", [True, False])
def test_scene_alone_gives_what_its_mask_gives(antialias):
    scene = stage()
    mask = drawn_mask(scene, antialias)
    image, truth = target(scene, mask)
    by_scene = godfit.fit(image, scene=scene, shader="dawntime", samples=SAMPLES, **ALONE)
    assert by_scene.converged, by_scene.message
    # Hard or smooth was told from the picture.
    np.testing.assert_array_equal(by_scene.picture.mask, mask)
    for name in ("decay", "density", "light_x", "light_y"):
        assert abs(by_scene.params[name].value - truth[name]) < 1e-3


def six_flipped():
    """A scene, its hard mask, and the mask with six edge pixels on the other side."""
    scene = dataclasses.replace(stage(), antialias=False)
    mask, smooth = drawn_mask(scene, False), drawn_mask(scene, True)
    other = mask.copy()
    for side in (0.0, 1.0):
        # The three edge pixels of this side that are nearest to being halved.
        near = np.where((mask == side) & (smooth > 0.15), np.abs(smooth - 0.5), 1.0)
        other.flat[np.argsort(near, axis=None)[:3]] = 1 - side
    return scene, mask, other


@pytest.mark.usefixtures("single_precision")
def test_edge_pixels_fall_as_the_target_has_them():
    """Six edge pixels of the hard mask on the other side, as another renderer may draw them."""
    scene, mask, other = six_flipped()
    image, truth = target(scene, other)
    result = godfit.fit(image, scene=scene, shader="dawntime", samples=SAMPLES, **ALONE)
    wrong = (mask != other).sum()
    assert wrong == 6
    assert (result.picture.mask != other).sum() <= 1
    assert abs(result.params["density"].value - truth["density"]) < 2e-3
    assert abs(result.params["decay"].value - truth["decay"]) < 1e-3


@pytest.fixture
def host():
    """Changes what no compiled program holds: without ``monkeypatch``, stored ones serve."""
    with pytest.MonkeyPatch.context() as patch:
        yield patch


@pytest.mark.usefixtures("single_precision")
def test_edge_pixels_that_explain_the_target_worse_stay(host):
    scene, mask, other = six_flipped()
    edges = edge_pixels._UncertainEdges
    host.setattr(edges, "settled", lambda self, problem, z: other[..., None])
    image, _ = target(scene, mask)
    result = godfit.fit(image, scene=scene, shader="dawntime", samples=SAMPLES, **ALONE)
    np.testing.assert_array_equal(result.picture.mask, mask)
    assert result.noise_levels < 0.02


@pytest.mark.usefixtures("single_precision")
def test_light_and_object_are_found_again(host):
    host.setattr(placement, "PLACEMENTS", 30)
    scene = stage()
    image, truth = target(scene, drawn_mask(scene, True))
    start = scene.replaced(
        {
            "light.position": jnp.array([1.2, -0.3, -3.2]),
            "object[0].position": jnp.array([-0.3, 0.7, 0.1]),
        }
    )
    free = ("light.position", "object[0].position")
    result = godfit.fit(image, scene=start, free=free, shader="dawntime", samples=SAMPLES, **ALONE)
    assert result.converged, result.message
    assert list(result.params)[4:] == [f"{name}.{axis}" for name in free for axis in "xyz"]
    for name in free:
        for axis, value in zip("xyz", np.asarray(scene.value(name)), strict=True):
            estimate = result.params[f"{name}.{axis}"]
            assert abs(estimate.value - value) < max(5 * estimate.stderr, 2e-3)
    off = np.abs(np.asarray(result.model.light[0]) - [truth["light_x"], truth["light_y"]])
    assert off.max() * SIZE < 0.05


FREE = ("light.position", "light.radius", "camera.position", "object[0].rotation")


def on_stage(scene):
    shading = Mitchell(0.1, 0.965, 0.85, 0.6, [[0.5, 0.5]], "dawntime", 12)
    return Staged(shading, scene, FREE)


def test_derivatives_of_the_picture_by_the_scene():
    """Against central differences of a smooth function of the whole picture."""
    scene = stage(48)
    model = on_stage(scene)
    held = np.full(14, np.nan)
    y, x = np.mgrid[:48, :48] / 48
    weight = jnp.asarray(np.sin(5 * x + 2) * np.cos(4 * y + 1) + x)

    # As in scenes/test_raster.py: optimised code would take longer to make than it saves.
    compiled = functools.partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})

    # The mask is rounded to bytes, which only differences of the unrounded one can follow.
    @compiled
    def smooth(z):
        at = model.moved(z, held)
        lit = eqx.tree_at(lambda m: m.light, at.shading, at.light)
        return (lit(rasterise(at.staged())) * weight).sum()

    def picture(z):
        return (model.moved(z, held)(jnp.zeros((48, 48))) * weight).sum()

    z = model.coordinates()
    slope = np.asarray(compiled(jax.grad(picture))(z))
    for i in range(len(z)):
        step = np.zeros(14)
        step[i] = 1e-4
        difference = float(smooth(z + step) - smooth(z - step)) / 2e-4
        assert slope[i] == pytest.approx(difference, rel=0.02, abs=0.01 * np.abs(slope).max())


def test_coordinates_and_parameters_go_to_and_fro():
    scene = stage()
    model = on_stage(scene)
    names = list(model.parameters)
    assert names[4:8] == [f"light.position.{a}" for a in "xyz"] + ["light.radius"]
    z = np.asarray(model.coordinates()) + np.linspace(0, 0.02, len(names))
    there = model.moved(jnp.asarray(z))
    # What trades with the radius is left out: the light keeps its distance along the view.
    away = np.asarray(scene.camera_axes()[2])
    z[4:7] -= away * (away @ z[4:7])
    np.testing.assert_allclose(np.asarray(there.coordinates()), z, rtol=1e-6)
    depth = away @ np.asarray(there.staged().light.position - scene.light.position)
    assert depth == pytest.approx(0, abs=1e-9)
    held = np.array([float(v) for v in there.values().values()])
    back = model.moved(model.coordinates(), jnp.asarray(held))
    for name, value in back.values().items():
        assert float(value) == pytest.approx(float(there.values()[name]), rel=1e-6)
    np.testing.assert_allclose(
        there.staged().value("light.radius"), there.values()["light.radius"], rtol=1e-12
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"free": ("light.colour",)}, "expected one of camera.position"),
        ({"free": ("light.radius", "light.radius")}, "expected each name once"),
        ({"free": ("light.radius",), "lights": 2}, "expected 1 with a scene"),
        ({"pass_scale": 1.5}, "at most 1"),
    ],
)
def test_scenes_that_cannot_be_fitted(options, words):
    with pytest.raises(InputError, match=words):
        godfit.fit(np.zeros((96, 96), np.uint8), scene=stage(), shader="dawntime", **options)


def test_scene_of_another_aspect():
    with pytest.raises(InputError, match="aspect 96:48"):
        godfit.fit(np.zeros((48, 96), np.uint8), scene=stage(), shader="dawntime")


def test_mask_and_scene_together():
    image = np.zeros((96, 96), np.uint8)
    with pytest.raises(InputError, match="got both"):
        godfit.fit(image, scene=stage(), mask=image)

import math
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from jax.test_util import check_grads
from scipy.spatial.transform import Rotation

from godfit.errors import InputError
from godfit.scenes import mesh
from godfit.scenes.mesh import edges
from godfit.scenes.scene import OBJECT_FIELDS, Scene, read_scene
from tests.support.gltf_files import CORNERS, glb, gltf, uri
from tests.support.paths import SHARED

MODELS = SHARED / "models"
SECTIONS = {
    "image": "width = 8\nheight = 6",
    "camera": "position = [0, 0, 5]",
    "light": "position = [0, 1, -2]\nradius = 0.5",
}
BOX = {"object": 'primitive = "box"'}
PLY = (
    b"ply\nformat ascii 1.0\nelement vertex 3\n"
    b"property float x\nproperty float y\nproperty float z\n"
    b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n"
)


def write(folder: Path, *objects: str, **sections: str) -> Path:
    """A scene file of the sections given and SECTIONS."""
    text = "".join(f"[{name}]\n{body}\n" for name, body in (SECTIONS | sections).items())
    path = folder / "scene.toml"
    path.write_text(text + "".join(f"[[object]]\n{body}\n" for body in objects))
    return path


def triangles(shape) -> set:
    """A mesh as what it covers: the set of its triangles, each a set of corners."""
    corners = np.asarray(shape.vertices, np.float32).round(5) + 0.0
    return {frozenset(map(tuple, corners[f].tolist())) for f in np.asarray(shape.faces)}


def refused(action, *parts: object) -> None:
    """``action()`` raises one line which holds every one of ``parts``."""
    with pytest.raises(InputError) as caught:
        action()
    message = str(caught.value)
    assert "\n" not in message
    for part in parts:
        assert str(part) in message, message


# The file.


def test_a_short_file_has_the_defaults_of_three_js(tmp_path):
    scene = read_scene(write(tmp_path))
    assert scene.size == (6, 8)
    assert scene.objects == scene.scattering == scene.notes == ()
    np.testing.assert_array_equal(scene.camera.target, [0, 0, 0])
    np.testing.assert_array_equal(scene.camera.up, [0, 1, 0])
    assert (float(scene.camera.fov_y), scene.camera.near, scene.camera.far) == (75, 0.1, 2000)
    assert scene.light.colour == (1, 1, 1)
    assert scene.background == (0, 0, 0)


def test_everything_that_a_file_can_say(tmp_path):
    (tmp_path / "a.gltf").write_bytes(gltf())
    scene = read_scene(
        write(
            tmp_path,
            'mesh = "a.gltf"\nposition = [1, 2, 3]\nrotation = [10, 20, 30]\nscale = 2\n'
            "colour = [0, 0.5, 1]\nalbedo = [1, 0.5, 0]\nmask = false",
            'primitive = "plane"\nwidth = 2\nheight = 4\nordinary = false',
            image="width = 8\nheight = 6\nantialias = false",
            camera="position = [0, 0, 5]\ntarget = [0, 1, 0]\nup = [1, 0, 0]\nfov_y = 40\n"
            "near = 1\nfar = 9",
            light='position = [0, 0, 0]\nradius = 1\ncolour = "#fff"',
            background='colour = "#111111"',
            ordinary='colour = "#000033"\nambient = 0\ndiffuse = 1',
            scattering='shader = "dawntime"\nsamples = 200\npass_scale = 0.5\ntransfer = "srgb"\n'
            "exposure = 0.1\ndecay = 1\ndensity = 0.9\nweight = 2",
        )
    )
    first, second = scene.objects
    np.testing.assert_array_equal(first.position, [1, 2, 3])
    np.testing.assert_array_equal(first.rotation, [10, 20, 30])
    assert (float(first.scale), first.colour, second.colour) == (2, (0, 0.5, 1), (0, 0, 0))
    assert (first.albedo, second.albedo) == ((1, 0.5, 0), (0.5, 0.5, 0.5))
    assert (first.in_mask, first.in_ordinary) == (False, True)
    assert (second.in_mask, second.in_ordinary) == (True, False)
    assert scene.shading == ((0, 0, 0.2), 0, 1)
    np.testing.assert_array_equal(np.ptp(second.vertices, axis=0), [2, 4, 0])
    assert scene.background == (17 / 255,) * 3  # not decoded as sRGB
    assert scene.antialias is False
    assert (scene.camera.near, scene.camera.far) == (1, 9)
    assert scene.settings["shader"] == "dawntime"
    assert scene.settings["decay"] == 1
    assert list(scene.settings)[-1] == "weight"
    hash((scene.size, scene.background, scene.scattering, scene.notes))  # static under jit


@pytest.mark.parametrize(
    ("sections", "parts"),
    [
        ({"image": "width = 8"}, ("image.height", "expected a whole number", "add it")),
        ({"image": "width = 0\nheight = 8"}, ("image.width", "from 1 to 16384", "got 0")),
        ({"image": "width = 16385\nheight = 8"}, ("image.width", "got 16385")),
        ({"image": "width = 8.0\nheight = 8"}, ("image.width", "got 8.0")),
        ({"image": "width = true\nheight = 8"}, ("image.width", "got True")),
        ({"image": "width = 8\nheight = 8\nantialias = 1"}, ("image.antialias", "true or false")),
        ({"camera": ""}, ("camera.position", "three finite numbers", "got nothing")),
        ({"camera": "position = [0, 0]"}, ("camera.position", "got [0, 0]")),
        ({"camera": "position = 3"}, ("camera.position", "got 3")),
        ({"camera": "position = [0, 0, true]"}, ("camera.position", "True")),
        ({"camera": 'position = [0, 0, "5"]'}, ("camera.position", "'5'")),
        ({"camera": "position = [0, 0, nan]"}, ("camera.position", "nan")),
        ({"camera": "position = [0, 0, -inf]"}, ("camera.position", "inf")),
        ({"camera": f"position = [0, 0, 1{400 * '0'}]"}, ("camera.position", "finite")),
        ({"camera": "position = [0, 0, 1e39]"}, ("camera.position", "1e+39")),
        ({"camera": "position = [0, 0, 5]\nposition = [0, 0, 5]"}, ("expected TOML",)),
        ({"camera": "position = [0, 0, 5]\nfov = 75"}, ("camera.fov", "did you mean 'fov_y'?")),
        ({"camera": "position = [0, 0, 5]\nfov_y = 0"}, ("camera.fov_y", "above 0 and below 180")),
        ({"camera": "position = [0, 0, 5]\nfov_y = 180"}, ("camera.fov_y", "got 180")),
        ({"camera": "position = [0, 0, 5]\nnear = 0"}, ("camera.near", "above 0", "got 0")),
        (
            {"camera": "position = [0, 0, 5]\nnear = 9\nfar = 9"},
            ("camera.near", "near 9 and far 9"),
        ),
        ({"camera": "position = [0, 0, 5]\ntarget = [0, 0, 5]"}, ("camera.target", "position")),
        ({"camera": "position = [0, 0, 5]\nup = [0, 0, -1]"}, ("camera.up", "the view's")),
        ({"camera": "position = [0, 0, 5]\nup = [0, 0, 0]"}, ("camera.up", "[0.0, 0.0, 0.0]")),
        ({"camera": "position = [0, 5, 0]"}, ("camera.up", "give another up")),
        ({"light": "radius = 1"}, ("light.position", "got nothing")),
        ({"light": "position = [0, 0, 0]"}, ("light.radius", "above 0", "got nothing")),
        ({"light": "position = [0, 0, 0]\nradius = 0"}, ("light.radius", "above 0", "got 0")),
        ({"light": "position = [0, 0, 0]\nradius = -1"}, ("light.radius", "got -1")),
        ({"light": "position = [0, 0, 0]\nradius = 5"}, ("light.radius", "inside the light")),
        ({"light": "position = [0, 0, 9]\nradius = 1"}, ("light.position", "depth -4", "mirrored")),
        ({"light": "position = [3, 0, 5]\nradius = 1"}, ("light.position", "depth 0")),
        (
            {"light": "position = [0, 0, 4.95]\nradius = 0.01"},
            ("light.position", "nearer than near"),
        ),
        (
            {"light": SECTIONS["light"] + '\ncolour = "#12345"'},
            ("light.colour", '"#rrggbb"', "#12345"),
        ),
        ({"light": SECTIONS["light"] + '\ncolour = "red"'}, ("light.colour", "red")),
        ({"light": SECTIONS["light"] + "\ncolour = [0, 0, 2]"}, ("light.colour", "0 to 1")),
        ({"light": SECTIONS["light"] + "\ncolor = [0, 0, 1]"}, ("light.color", "'colour'")),
        ({"background": "colour = 1"}, ("background.colour", "got 1")),
        ({"ordinary": "ambient = 1.5"}, ("ordinary.ambient", "from 0 to 1", "got 1.5")),
        ({"ordinary": "difuse = 1"}, ("ordinary.difuse", "did you mean 'diffuse'?")),
        ({"lights": "a = 1"}, ("lights", "did you mean 'light'?")),
        ({"object": 'primitive = "box"'}, ("object", "[[object]]")),
        ({"scattering": 'shader = "daentime"'}, ("scattering.shader", "'dawntime'?")),
        ({"scattering": "shader = 3"}, ("scattering.shader", "expected text", "got 3")),
        ({"scattering": "samples = 1"}, ("scattering.samples", "from 2", "got 1")),
        ({"scattering": "samples = 20.0"}, ("scattering.samples", "a whole number")),
        ({"scattering": "samples = true"}, ("scattering.samples", "got True")),
        ({"scattering": "decay = 1.1"}, ("scattering.decay", "from 0 to 1", "got 1.1")),
        ({"scattering": "weight = nan"}, ("scattering.weight", "got nan")),
        ({"scattering": "pass_scale = 2"}, ("scattering.pass_scale", "got 2")),
        ({"scattering": 'transfer = "gamma"'}, ("scattering.transfer", "'srgb'", "'gamma'")),
        ({"scattering": "sample = 20"}, ("scattering.sample", "did you mean 'samples'?")),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(tmp_path, sections, parts):
    path = write(tmp_path, **sections)
    refused(lambda: read_scene(path), path, *parts)


@pytest.mark.parametrize(
    ("body", "parts"),
    [
        ("position = [0, 0, 0]", ("mesh or primitive", "neither")),
        ('mesh = "a.ply"\nprimitive = "box"', ("mesh or primitive", "both")),
        ("mesh = 3", ("object[1].mesh", "expected text")),
        ('mesh = "no.ply"', ("no.ply", "no such file")),
        ('primitive = "cube"', ("object[1].primitive", "box, icosphere", "'cube'")),
        ('primitive = "box"\nradius = 2', ("object[1].radius", "did you mean")),
        ('primitive = "box"\nsize = [1, 0, 1]', ("object[1].size", "above 0")),
        ('primitive = "icosphere"\nsubdivisions = 9', ("object[1].subdivisions", "from 0 to 8")),
        ('primitive = "icosphere"\nsubdivisions = 1.0', ("subdivisions", "whole number")),
        ('primitive = "cylinder"\nsegments = 2', ("object[1].segments", "from 3")),
        ('primitive = "torus"\ntube = -1', ("object[1].tube", "above 0", "got -1")),
        ('primitive = "plane"\nwidth = "2"', ("object[1].width", "'2'")),
        ('primitive = "box"\nscale = 0', ("object[1].scale", "above 0")),
        ('primitive = "box"\nrotate = [0, 0, 0]', ("object[1].rotate", "'rotation'")),
        ('primitive = "box"\ncolour = "#0000"', ("object[1].colour", "#0000")),
        ('primitive = "box"\nalbedo = 0.5', ("object[1].albedo", "got 0.5")),
        ('primitive = "box"\nmask = 0', ("object[1].mask", "true or false")),
        (
            'primitive = "box"\nmask = false\nordinary = false',
            ("object[1].mask", "false for both"),
        ),
    ],
)
def test_a_wrong_object_is_refused_by_its_number(tmp_path, body, parts):
    path = write(tmp_path, 'primitive = "box"', body)
    refused(lambda: read_scene(path), *parts)


def test_a_file_that_cannot_be_read(tmp_path):
    refused(lambda: read_scene(tmp_path / "no.toml"), "no.toml", "no such file")
    refused(lambda: read_scene(tmp_path), tmp_path, "expected TOML")
    refused(lambda: read_scene("a\0b.toml"), "expected TOML", "null")
    (tmp_path / "a.toml").write_bytes(b"\xff\xfe")
    refused(lambda: read_scene(tmp_path / "a.toml"), "a.toml", "expected TOML")
    (tmp_path / "a.toml").write_text("image = 3")
    refused(lambda: read_scene(tmp_path / "a.toml"), "image", "expected a table", "got 3")


@pytest.mark.parametrize(
    ("colour", "expected"),
    [('"#fff"', 3 * [1]), ('"#1aF"', [17, 170, 255]), ('"#0a0B0c"', [10, 11, 12])],
)
def test_colours_in_hexadecimal_are_bytes(tmp_path, colour, expected):
    found = read_scene(write(tmp_path, background=f"colour = {colour}")).background
    np.testing.assert_allclose(found, np.array(expected) / max(1, 255 * (max(expected) > 1)))


def test_arrays_are_in_the_precision_of_the_program(tmp_path, single_precision):
    scene = read_scene(write(tmp_path, 'primitive = "box"'))
    floats = (scene.camera.position, scene.light.radius, scene.objects[0].vertices)
    assert {x.dtype for x in floats} == {jnp.dtype("float32")}
    assert {scene.objects[0].faces.dtype, scene.objects[0].edges.dtype} == {jnp.dtype("int32")}


# Names of its numbers.


@pytest.fixture
def scene(tmp_path) -> Scene:
    return read_scene(write(tmp_path, *2 * ['primitive = "box"\nposition = [0, 0, -3]']))


def test_every_name_can_be_asked_for_and_replaced(scene):
    assert {"light.position", "light.radius", "camera.fov_y", "object[1].scale"} < set(scene.names)
    assert len(scene.names) == 6 + 2 * len(OBJECT_FIELDS)
    values = {name: scene.value(name) + i + 1 for i, name in enumerate(scene.names)}
    changed = scene.replaced(values)
    for name in scene.names:
        np.testing.assert_array_equal(changed.value(name), values[name])
        assert (changed.value(name) != scene.value(name)).all()
    assert changed.objects[0].faces is scene.objects[0].faces
    assert changed.size == scene.size


def test_replacing_goes_through_jit_and_grad(scene):
    @jax.jit
    def loss(x):
        moved = scene.replaced({"object[1].position": x, "light.radius": x[0] ** 2})
        return moved.objects[1].world().sum() + moved.value("light.radius")

    np.testing.assert_allclose(jax.grad(loss)(jnp.array([3.0, 0.0, 0.0])), [8 + 6, 8, 8])


@pytest.mark.parametrize(
    "name", ["light.positon", "object[2].position", "position", "light.colour"]
)
def test_an_unknown_name_is_refused_with_the_known_ones(scene, name):
    refused(lambda: scene.value(name), name, "camera.position", "object[1].scale", "did you mean")
    refused(lambda: scene.replaced({name: jnp.zeros(3)}), name, "did you mean")


# Pose.


def test_rotation_is_that_of_three_js(scene):
    vertices = np.asarray(scene.objects[0].vertices)
    for angles in np.random.default_rng(1).uniform(-360, 360, (20, 3)):
        posed = scene.replaced(
            {
                "object[0].rotation": jnp.asarray(angles),
                "object[0].scale": jnp.asarray(2.5),
                "object[0].position": jnp.array([1.0, 2.0, 3.0]),
            }
        )
        turn = Rotation.from_euler("XYZ", angles, degrees=True)
        expected = turn.apply(2.5 * vertices) + np.array([1, 2, 3])
        np.testing.assert_allclose(posed.objects[0].world(), expected, atol=1e-12)


def test_a_quarter_turn_about_y_takes_z_to_x(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 1\nv 0 1 0\nv 0 0 0\nf 1 2 3\n")
    thing = read_scene(write(tmp_path, 'mesh = "a.obj"\nrotation = [0, 90, 0]')).objects[0]
    np.testing.assert_allclose(thing.world()[0], [1, 0, 0], atol=1e-15)


def test_the_pose_is_differentiable(scene):
    def world(position, rotation, scale):
        values = {"position": position, "rotation": rotation, "scale": scale}
        values = {f"object[0].{key}": jnp.asarray(value) for key, value in values.items()}
        return scene.replaced(values).objects[0].world()

    at = (jnp.array([1.0, 2.0, 3.0]), jnp.array([0.0, 40.0, -70.0]), jnp.asarray(1.5))
    check_grads(world, at, order=1, modes=("fwd", "rev"))


# Notes.


@pytest.mark.parametrize(
    ("body", "inside"),
    [
        ('primitive = "box"\nposition = [0.2, 0.1, 5.3]', True),
        ('primitive = "box"\nposition = [0.9, 0, 5]', False),
        ('primitive = "box"\nposition = [0.9, 0, 5]\nscale = 2', True),
        ('primitive = "icosphere"\nradius = 9', True),
        ('primitive = "torus"\nposition = [1, 0, 5]', True),
        ('primitive = "torus"\nposition = [-7, 7, 5]\nscale = 10', True),
        ('primitive = "torus"\nposition = [0, 0, 5]', False),  # in the hole
        ('primitive = "torus"\nposition = [0, 0, 5]\nscale = 30\ntube = 0.99', False),
        ('primitive = "cylinder"\nposition = [0, 0.6, 5]', False),
        ('primitive = "plane"\nposition = [0, 0, 5]\nrotation = [10, 20, 30]', False),  # not closed
    ],
)
def test_a_camera_inside_an_object_is_noted(tmp_path, body, inside):
    scene = read_scene(write(tmp_path, 'primitive = "plane"', body))
    notes = [note for note in scene.notes if "not in view" not in note]
    assert notes == (["the camera is inside object[1]"] if inside else [])


def test_what_is_inside_a_torus():
    torus = mesh.primitive("torus", radial_segments=40, tubular_segments=60)
    points = np.random.default_rng(2).uniform(-1.5, 1.5, (300, 3)) * [1, 1, 0.4]
    away = np.hypot(np.hypot(points[:, 0], points[:, 1]) - 1, points[:, 2])
    clear = abs(away - 0.4) > 0.01  # of the facets
    found = [mesh.contains(torus, point) for point in points[clear]]
    np.testing.assert_array_equal(found, away[clear] < 0.4)
    assert 0.1 < np.mean(found) < 0.9


def test_a_light_beyond_far_is_noted(tmp_path):
    camera = SECTIONS["camera"] + "\nfar = 6.4"
    assert "beyond camera.far" in read_scene(write(tmp_path, camera=camera)).notes[0]
    # The sphere's near side is still drawn.
    assert read_scene(write(tmp_path, camera=camera.replace("6.4", "6.6"))).notes == ()


def test_a_light_off_the_screen_is_allowed(tmp_path):
    assert read_scene(write(tmp_path, light="position = [90, 0, 4]\nradius = 1")).notes == ()


def test_notes_on_a_mesh_are_the_scene_s(tmp_path):
    (tmp_path / "a.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nf 1 2 3\nf 1 2 4\nf 1 1 2\n"
    )
    (note,) = read_scene(write(tmp_path, 'mesh = "a.obj"')).notes
    assert "a.obj" in note
    assert "2 of 3 triangles without area" in note


# Mesh files.


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "glb", "gltf"])
def test_round_trips(tmp_path, suffix):
    import trimesh

    shape = mesh.primitive("torus", radial_segments=5, tubular_segments=7)
    path = tmp_path / f"a.{suffix}"
    made = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
    if suffix == "gltf":
        for name, data in trimesh.exchange.gltf.export_gltf(trimesh.Scene(made)).items():
            (tmp_path / name).write_bytes(data)
        (tmp_path / "model.gltf").rename(path)
    else:
        made.export(path)
    found = mesh.load(path)
    assert found.vertices.shape == (35, 3)
    assert found.faces.shape == (70, 3)
    assert found.notes == ()
    assert triangles(found) == triangles(shape)


@pytest.mark.parametrize("kind", ["ply", "stl_ascii"])
def test_text_formats(tmp_path, kind):
    import trimesh

    made = trimesh.creation.box()
    path = tmp_path / f"a.{kind[:3]}"
    data = made.export(file_type=kind, **({"encoding": "ascii"} if kind == "ply" else {}))
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    assert triangles(mesh.load(path)) == triangles(made)


def test_a_scene_graph_is_loaded_whole_with_its_transforms(tmp_path):
    import trimesh

    box = trimesh.creation.box()
    graph = trimesh.Scene()
    outer = trimesh.transformations.translation_matrix([0, 10, 0])
    inner = np.diag([2.0, 3.0, -4.0, 1.0])  # mirrored: a negative determinant
    graph.graph.update(frame_from="world", frame_to="outer", matrix=outer)
    graph.add_geometry(box, node_name="a", geom_name="box", parent_node_name="outer")
    graph.add_geometry(
        box, node_name="b", geom_name="box", parent_node_name="outer", transform=inner
    )
    graph.export(tmp_path / "a.glb")
    found = mesh.load(tmp_path / "a.glb")
    expected = [box.copy().apply_transform(outer), box.copy().apply_transform(outer @ inner)]
    assert triangles(found) == triangles(expected[0]) | triangles(expected[1])
    assert len(found.faces) == 24


def test_seams_are_closed_and_positions_kept_in_order(tmp_path):
    # Two triangles of a glTF that share an edge but no vertex, as where a texture has a seam.
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, -0.0], [1, 1, 0], [-0.0, 1, 0], [9, 9, 9]]
    (tmp_path / "a.gltf").write_bytes(gltf(corners, range(6)))
    found = mesh.load(tmp_path / "a.gltf")
    np.testing.assert_array_equal(found.vertices, np.array(corners)[[0, 1, 2, 4]])
    np.testing.assert_array_equal(found.faces, [[0, 1, 2], [1, 3, 2]])
    assert found.faces.dtype == np.int32
    np.testing.assert_array_equal(edges(found.faces)[:, 3] >= 0, [False, False, True, False, False])


def test_faces_without_area_and_twice_there(tmp_path):
    text = (
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nv 0 0 0\nf 1 2 3\nf 3 1 2\nf 2 1 3\nf 1 2 4\nf 1 5 3\n"
    )
    (tmp_path / "a.obj").write_text(text)
    found = mesh.load(tmp_path / "a.obj")
    assert found.faces.tolist() == [[0, 1, 2]]
    assert found.vertices.tolist() == CORNERS
    assert len(found.notes) == 1
    assert "2 of 5 triangles without area" in found.notes[0]


def test_textures_that_are_missing_are_noted(tmp_path):
    (tmp_path / "my picture.png").write_bytes(b"")
    images = [{"uri": "no.png"}, {"uri": "my%20picture.png"}, {"uri": uri(b"")}, {"bufferView": 0}]
    material = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    textured = gltf(
        primitive={"material": 0}, images=images, textures=[{"source": 0}], materials=[material]
    )
    (tmp_path / "a.gltf").write_bytes(textured)
    found = mesh.load(tmp_path / "a.gltf")
    assert triangles(found) == {frozenset(map(tuple, CORNERS))}
    (note,) = found.notes
    assert "a.gltf" in note
    assert "1 textures are missing" in note


def test_the_name_of_a_buffer_is_decoded(tmp_path):
    data = np.array(CORNERS, "<f4").tobytes() + np.arange(3, dtype="<u4").tobytes()
    (tmp_path / "my buffer.bin").write_bytes(data)
    buffers = [{"byteLength": len(data), "uri": "my%20buffer.bin"}]
    (tmp_path / "a.gltf").write_bytes(gltf(buffers=buffers))
    assert triangles(mesh.load(tmp_path / "a.gltf")) == {frozenset(map(tuple, CORNERS))}


def test_relative_indices_of_an_obj_count_from_the_line_they_are_on(tmp_path):
    first, second = "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "v 0 0 1\nv 1 0 1\nv 0 1 1\n"
    texture = "vt 0 0\n"
    for name, text in {
        "plain": f"{first}{texture}f 1/1 2/1 3/1\n{second}f 4 5 6\n",
        "relative": f"{first}{texture}f -3/-1 -2/-1 -1/-1\n{second}f -3 -2 -1 # the last three\n",
        "continued": f"{first}f -3 \\\r\n-2 -1\r\n{second}f 4 -2 6\r\n",
        "latin": f"# Würfel\n{first}f -3 -2 -1\n{second}f 4 5 6\n",
    }.items():
        path = tmp_path / f"{name}.obj"
        path.write_bytes(text.encode("latin-1"))
        shape = mesh.load(path)
        assert shape.vertices.tolist() == [*CORNERS, [0, 0, 1], [1, 0, 1], [0, 1, 1]], name
        assert shape.faces.tolist() == [[0, 1, 2], [3, 4, 5]], name


OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
SOLID = (
    "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 {} 0\nendloop\n"
)
SOLID += "endfacet\nendsolid x"


@pytest.mark.parametrize(
    ("name", "data", "parts"),
    [
        ("a.fbx", b"1", (".gltf, .glb, .obj, .ply, .stl", "'.fbx'")),
        ("a", b"1", ("expected one of", "''")),
        ("a.obj", b"", ("empty file",)),
        ("a.glb", b"", ("empty file",)),
        ("a.obj", b"no mesh at all", ("expected triangles", "none")),
        ("a.stl", b"no mesh at all", ("expected triangles", "none")),
        ("a.ply", b"no mesh at all", ("expected a mesh", "Not a ply")),
        ("a.glb", b"no mesh at all", ("expected a glTF 2.0 header",)),
        ("a.gltf", b"no mesh at all", ("expected a glTF 2.0 header",)),
        ("a.gltf", b"[]", ("expected a glTF 2.0 header",)),
        ("a.gltf", b"\xef\xbb\xbf" + gltf(), ("expected a glTF 2.0 header", "BOM")),
        ("a.gltf", gltf(images={"a": 1}), ("expected a glTF 2.0 header",)),
        ("a.obj", OBJ.encode(), ("expected triangles", "points")),
        ("a.ply", PLY[:100] + PLY[180:], ("expected",)),
        ("a.gltf", gltf(primitive={"mode": 0}), ("expected triangles", "points")),
        ("a.gltf", gltf(primitive={"mode": 1}), ("expected triangles", "none")),
        ("a.gltf", gltf(accessor={"sparse": {"count": 1}}), ("expected a mesh", "indices")),
        ("a.gltf", gltf(accessor={"count": 1000}), ("cut or damaged",)),
        (
            "a.gltf",
            gltf(extensionsRequired=["KHR_draco_mesh_compression"]),
            ("KHR_draco_mesh_compression", "export it without"),
        ),
        ("a.gltf", gltf(asset={"version": "1.0"}), ("only GLTF 2",)),
        ("a.gltf", gltf(scenes=[{"nodes": []}]), ("expected triangles", "none")),
        ("a.gltf", gltf(buffers=[{"byteLength": 48, "uri": "no.bin"}]), ("no.bin",)),
        ("a.gltf", gltf(buffers=[{"byteLength": 48, "uri": uri(b"1")}]), ("cut or damaged",)),
        ("a.obj", (OBJ + "f 1 2 9").encode(), ("index 8 is out of bounds",)),
        ("a.obj", (OBJ + "v 7 8 9\nf 0 1 2").encode(), ("indices from 1", "f 0 1 2")),
        ("a.obj", (OBJ + "f -4 -2 -1").encode(), ("indices from 1", "after 3 vertices")),
        ("a.obj", (OBJ + "f 1 2 x").encode(), ("expected a mesh",)),
        ("a.ply", PLY + b"3 0 1 3\n", ("indices from 0 to 2", "got 0 to 3")),
        ("a.ply", PLY + b"3 0 1 -1\n", ("indices from 0 to 2", "got -1 to 1")),
        ("a.gltf", gltf(faces=[0, 1, 70000]), ("indices from 0 to 2", "got 0 to 70000")),
        ("a.ply", PLY, ("1 of the element face", "cut short")),
        (
            "a.ply",
            PLY.replace(b"face 1", b"face 2") + b"3 0 1 2\n",
            ("2 of the element face", "cut"),
        ),
        ("a.obj", (OBJ + "f 1 2 3").replace("1 0 0", "nan 0 0").encode(), ("finite", "1 with NaN")),
        ("a.ply", PLY.replace(b"0 1 0\n", b"0 inf 0\n") + b"3 0 1 2\n", ("finite vertices",)),
        ("a.stl", SOLID.format("nan").encode(), ("finite vertices",)),
        ("a.stl", SOLID.format("?").encode(), ("expected a mesh", "unmatched data")),
        ("a.gltf", gltf([*CORNERS[:2], [0, math.nan, 0]]), ("finite vertices",)),
        ("a.obj", (OBJ + "f 1 2 3").replace("1 0 0", "1e300 0 0").encode(), ("below 1e18",)),
        ("a.obj", (OBJ + "f 1 2 2").encode(), ("triangles with an area", "none")),
        ("a.gltf", gltf(nodes=[{"mesh": 0, "scale": [0, 0, 0]}]), ("with an area",)),
    ],
)
def test_a_bad_mesh_is_refused_in_one_line(tmp_path, name, data, parts):
    (tmp_path / name).write_bytes(data)
    refused(lambda: mesh.load(tmp_path / name), tmp_path / name, *parts)


def test_a_mesh_that_is_not_there(tmp_path):
    refused(lambda: mesh.load(tmp_path / "no.obj"), "no.obj", "no such file")
    refused(lambda: mesh.load(tmp_path), "no such file")


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "glb"])
def test_a_damaged_file_is_refused_or_loaded_but_raises_nothing_else(tmp_path, suffix):
    import trimesh

    path = tmp_path / f"a.{suffix}"
    whole = trimesh.creation.box().export(file_type=suffix)
    whole = whole.encode() if isinstance(whole, str) else whole
    rng = np.random.default_rng(5)
    for _ in range(40):
        data = bytearray(whole[: rng.integers(1, len(whole))])
        if rng.random() < 0.5:
            data = bytearray(whole)
            data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        path.write_bytes(data)
        try:
            found = mesh.load(path)
        except InputError:
            pass
        else:
            assert np.isfinite(found.vertices).all()
            assert 0 <= found.faces.min() <= found.faces.max() < len(found.vertices)


@pytest.mark.skipif(not MODELS.is_dir(), reason="needs the meshes in ../shared")
@pytest.mark.parametrize(
    ("name", "faces", "missing"),
    [("skull", 31016, 2), ("icosahedron", 36582, 0), ("satellite", 908, 6)],
)
def test_meshes_that_nobody_made_for_it(name, faces, missing):
    found = mesh.load(MODELS / name / "scene.gltf")
    assert len(found.faces) == faces
    assert [str(missing) in note for note in found.notes] == [True] * bool(missing)
    e = edges(found.faces)
    # Every face lies beside each of its edges.
    assert (e[:, 2] >= 0).sum() + (e[:, 3] >= 0).sum() == 3 * faces
    if name == "skull":  # a closed surface once its seams are merged
        assert (e >= 0).all()
        assert not mesh.contains(found, found.vertices.max(0) + 1)


# Primitives.


def test_primitives_lie_as_those_of_three_js():
    box = mesh.primitive("box", size=[1.0, 2.0, 3.0])
    np.testing.assert_allclose(np.ptp(box.vertices, axis=0), [1, 2, 3])

    # CylinderGeometry: corners at (r sin, +-h/2, r cos), whatever the number of segments.
    for n in (3, 5, 8):
        found = mesh.primitive("cylinder", radius=2.0, height=3.0, segments=n)
        angle = 2 * np.pi * np.arange(n) / n
        ring = np.stack([2 * np.sin(angle), np.full(n, 1.5), 2 * np.cos(angle)], 1)
        expected = np.concatenate([ring, ring * [1, -1, 1], [[0, 1.5, 0], [0, -1.5, 0]]])
        same_points(found.vertices, expected)

    # TorusGeometry: ((R + r cos v) cos u, (R + r cos v) sin u, r sin v).
    found = mesh.primitive("torus", radius=2.0, tube=0.5, radial_segments=4, tubular_segments=6)
    u, v = (x.ravel() for x in np.meshgrid(np.arange(6) * np.pi / 3, np.arange(4) * np.pi / 2))
    ring = 2 + 0.5 * np.cos(v)
    same_points(found.vertices, np.stack([ring * np.cos(u), ring * np.sin(u), 0.5 * np.sin(v)], 1))

    # IcosahedronGeometry with no detail.
    t = (1 + 5**0.5) / 2
    corners = [[0, a, b * t] for a in (-1, 1) for b in (-1, 1)]
    corners = np.array([np.roll(c, k) for c in corners for k in range(3)])
    found = mesh.primitive("icosphere", radius=2.0, subdivisions=0)
    same_points(found.vertices, 2 * corners / np.sqrt(1 + t * t))

    plane = mesh.primitive("plane", width=2.0, height=4.0)
    assert len(plane.faces) == 2
    same_points(plane.vertices, [[x, y, 0] for x in (-1, 1) for y in (-2, 2)])
    a, b, c = np.moveaxis(plane.vertices[plane.faces], 1, 0)
    assert (np.cross(b - a, c - a) @ [0, 0, 1] > 0).all()


def same_points(found, expected):
    found, expected = np.asarray(found), np.asarray(expected, float)
    assert found.shape == expected.shape
    apart = np.linalg.norm(found[:, None] - expected[None], axis=-1)
    assert apart.min(0).max() < 1e-9
    assert apart.min(1).max() < 1e-9


@pytest.mark.parametrize("kind", mesh.PRIMITIVES)
def test_primitives_are_closed_or_have_one_border(kind):
    shape = mesh.primitive(kind)
    e = edges(shape.faces)
    assert shape.notes == ()
    assert (e[:, 2] >= 0).all()
    assert (e[:, 3] < 0).sum() == (4 if kind == "plane" else 0)


# Edges.


@pytest.mark.parametrize(
    ("faces", "expected"),
    [
        ([[0, 1, 2]], [[0, 1, 2, -1], [0, 2, 1, -1], [1, 2, 0, -1]]),
        (
            [[0, 1, 2], [2, 1, 3]],
            [[0, 1, 2, -1], [0, 2, 1, -1], [1, 2, 0, 3], [1, 3, 2, -1], [2, 3, 1, -1]],
        ),
        # A tetrahedron.
        (
            [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]],
            [[0, 1, 2, 3], [0, 2, 1, 3], [0, 3, 1, 2], [1, 2, 0, 3], [1, 3, 0, 2], [2, 3, 0, 1]],
        ),
        # Three faces about one edge.
        (
            [[0, 1, 2], [0, 1, 3], [1, 0, 4]],
            [[0, 1, -1, -1]] + [[a, k, 1 - a, -1] for a in (0, 1) for k in (2, 3, 4)],
        ),
    ],
)
def test_edges(faces, expected):
    found = edges(np.array(faces))
    assert found.dtype == np.int32
    assert in_order(found) == sorted(expected)


def in_order(found) -> list[list[int]]:
    """Sorted, and the corners across from an edge as well, where there are two."""
    return sorted([a, b, *sorted((c, d), reverse=d < 0)] for a, b, c, d in found.tolist())


def test_edges_of_a_box():
    found = edges(mesh.primitive("box").faces)
    assert found.shape == (18, 4)
    assert (found >= 0).all()


@given(st.integers(0, 4), st.integers(3, 9), st.integers(3, 9))
@settings(max_examples=20, deadline=None)
def test_euler(subdivisions, radial, tubular):
    for shape, characteristic in (
        (mesh.primitive("icosphere", subdivisions=subdivisions), 2),
        (mesh.primitive("torus", radial_segments=radial, tubular_segments=tubular), 0),
        (mesh.primitive("cylinder", segments=tubular), 2),
    ):
        count = len(shape.vertices) - len(edges(shape.faces)) + len(shape.faces)
        assert count == characteristic


@given(hnp.arrays(np.int64, st.tuples(st.integers(1, 30), st.just(3)), elements=st.integers(0, 6)))
@settings(max_examples=60, deadline=None)
def test_edges_hold_every_pair_of_a_face_once(faces):
    faces = np.unique(np.sort(faces, axis=1), axis=0)
    faces = faces[(np.diff(faces, axis=1) > 0).all(1)]
    if not len(faces):
        return
    across: dict[tuple[int, int], list[int]] = {}
    for a, b, c in faces.tolist():
        for pair, other in (((a, b), c), ((b, c), a), ((a, c), b)):
            across.setdefault(pair, []).append(other)
    expected = [
        [*pair, *sorted(others), *(2 - len(others)) * [-1]] if len(others) < 3 else [*pair, -1, -1]
        for pair, others in sorted(across.items())
    ]
    assert in_order(edges(faces)) == expected


@given(
    hnp.arrays(np.float64, st.tuples(st.integers(1, 40), st.just(3)), elements=st.integers(0, 2))
)
@settings(max_examples=60, deadline=None)
def test_merging_keeps_every_triangle_in_its_place(corners):
    corners = corners[: len(corners) // 3 * 3]
    soup = np.arange(len(corners)).reshape(-1, 3)
    a, b, c = (corners[k::3] for k in range(3))
    solid = {
        frozenset(map(tuple, t))
        for t in np.stack([a, b, c], 1)[(np.cross(b - a, c - a) != 0).any(-1)].tolist()
    }
    if not solid:
        refused(lambda: mesh.clean(corners, soup, "soup"), "soup")
        return
    found = mesh.clean(corners, soup, "soup")
    assert len(found.faces) == len(solid)
    assert triangles(found) == solid
    assert len(np.unique(found.vertices, axis=0)) == len(found.vertices)
    assert set(found.faces.ravel().tolist()) == set(range(len(found.vertices)))


def test_the_header_of_a_glb_is_read(tmp_path):
    (tmp_path / "a.glb").write_bytes(glb(gltf(extensionsRequired=["EXT_none"])))
    refused(lambda: mesh.load(tmp_path / "a.glb"), "EXT_none")

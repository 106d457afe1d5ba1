"""Geometry that files describe in other ways than by plain triangles."""

import json
import struct

import imageio.v3 as imageio
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from godfit.errors import InputError
from godfit.io.image import Image
from godfit.scenes import mesh, raster
from godfit.scenes.ply import strip_triangles
from godfit.scenes.polygons import triangulated
from godfit.scenes.scene import Camera, Light, Object, Scene, read_scene
from godfit.scenes.view import scene_at_pass_size
from tests.support.gltf_files import CORNERS, gltf

U = [[0, 0], [3, 0], [3, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3]]
"""A concave polygon with the area 7; the fan around its first corner has other."""
SQUARE = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]


def area(shape) -> float:
    a, b, c = (shape.vertices[shape.faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=-1).sum() / 2)


def moved(*by: float) -> np.ndarray:
    return np.array(CORNERS) + np.array(by)


def inside(polygon, point) -> bool:
    """Whether a point lies in a polygon (k, 2), by the crossings of a ray."""
    odd = False
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, 0), strict=True):
        if (y0 > point[1]) != (y1 > point[1]):
            odd ^= point[0] < x0 + (point[1] - y0) / (y1 - y0) * (x1 - x0)
    return bool(odd)


def save(folder, data: bytes, name="a.gltf"):
    path = folder / name
    path.write_bytes(data)
    return mesh.load(path)


@pytest.mark.parametrize("seed", range(4))
def test_triangles_cover_a_polygon_once(seed):
    rng = np.random.default_rng(seed)
    k = 4 + 3 * seed
    angle = np.sort(rng.uniform(0, 2 * np.pi, k)) * (1 if seed % 2 else -1)
    flat = rng.uniform(0.2, 1, k)[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    turn = Rotation.random(random_state=seed).as_matrix()
    vertices = np.pad(flat, ((0, 0), (0, 1))) @ turn.T + [5, 6, 7]
    faces, crossed = triangulated(vertices, [np.arange(k)])
    assert crossed == 0
    for point in rng.uniform(-1, 1, (200, 2)):
        covering = sum(inside(flat[face], point) for face in faces)
        assert covering == inside(flat, point)
    # Every triangle is turned as the polygon is.
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    turned = np.cross(b - a, c - a) @ turn[:, 2] * (1 if seed % 2 else -1)
    assert (turned > 0).all()


def test_convex_polygons_stay_fans_and_crossed_ones_are_counted():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    assert triangulated(square, [np.arange(4)])[0].tolist() == [[0, 1, 2], [0, 2, 3]]
    assert triangulated(square, [np.array([0, 2, 1, 3])])[1] == 1
    dart = np.array([[0, 0, 0], [2, -1, 0], [0.5, 0, 0], [2, 1, 0]], float)
    assert triangulated(dart, [np.arange(4)])[0].tolist() == [[0, 1, 2], [0, 2, 3]]
    assert triangulated(dart, [np.array([3, 0, 1, 2])])[0].tolist() == [[0, 1, 2], [0, 2, 3]]
    five = 2 * np.pi * np.arange(0, 10, 2) / 5
    star = np.stack([np.cos(five), np.sin(five), 0 * five], 1)
    assert triangulated(star, [np.arange(5)])[1] == 1


def test_concave_polygons_of_every_format(tmp_path):
    rows = "".join(f"v {x} {y} 2\n" for x, y in U)
    shape = save(tmp_path, f"{rows}f 1 2 3 4 5 6 7 8 # a U\n".encode(), "a.obj")
    assert area(shape) == pytest.approx(7)
    shape = save(
        tmp_path, f"{rows}f -8//1 -7//1 -6//1 -5//1 -4//1 -3//1 -2//1 -1//1".encode(), "b.obj"
    )
    assert area(shape) == pytest.approx(7)
    header = (
        "ply\nformat {} 1.0\ncomment a U\nelement vertex 8\nproperty float x\nproperty float y\n"
        "property double z\nelement face 2\nproperty uchar red\n"
        "property list uchar int vertex_index\nend_header\n"
    )
    text = "".join(f"{x} {y} 2\n" for x, y in U) + "7 8 0 1 2 3 4 5 6 7\n9 3 0 1 2\n"
    assert area(save(tmp_path, (header.format("ascii") + text).encode(), "a.ply")) == 7 + 4.5
    for order, sign in (("little", "<"), ("big", ">")):
        binary = b"".join(struct.pack(sign + "ffd", x, y, 2) for x, y in U)
        binary += struct.pack(sign + "BB8i", 7, 8, *range(8)) + struct.pack(
            sign + "BB3i", 9, 3, 0, 1, 2
        )
        data = header.format(f"binary_{order}_endian").encode() + binary
        assert area(save(tmp_path, data, "b.ply")) == 7 + 4.5
    crossed = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 2 0\nf 1 3 2 4\nf 1 2 3\n"
    (note,) = save(tmp_path, crossed.encode(), "c.obj").notes
    assert "1 polygons cross themselves" in note


def test_a_hole_that_a_bridge_joins_to_the_rim_stays_open(tmp_path):
    rim = [[0, 0], [4, 0], [4, 4], [0, 4]]
    hole = [[1, 1], [1, 3], [3, 3], [3, 1]]
    rows = "".join(f"v {x} {y} 0\n" for x, y in rim + hole)
    shape = save(tmp_path, f"{rows}f 1 2 3 4 1 5 6 7 8 5\n".encode(), "a.obj")
    assert area(shape) == pytest.approx(12)
    corners = shape.vertices[shape.faces][..., :2]
    assert not any(inside(triangle, [1.9, 2.2]) for triangle in corners)
    assert shape.notes == ()


def test_free_form_surfaces_are_refused(tmp_path):
    with pytest.raises(InputError, match="free-form surfaces"):
        save(tmp_path, b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nsurf 0 1 0 1 1 2 3\n", "a.obj")


def test_strips_of_triangles(tmp_path):
    strips = strip_triangles(np.array([0, 1, 2, 3, -1, 4, 5, 6]))
    assert strips.tolist() == [[0, 1, 2], [2, 1, 3], [4, 5, 6]]
    header = (
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
        "property float z\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    )
    text = header + "0 0 0\n1 0 0\n0 1 0\n1 1 0\n4 0 1 2 3\n"
    assert area(save(tmp_path, text.encode(), "a.ply")) == 1
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    strip = save(tmp_path, gltf(corners, range(4), {"mode": 5}))
    assert strip.faces.tolist() == [[0, 1, 2], [1, 3, 2]]
    fan = save(tmp_path, gltf([corners[i] for i in (0, 1, 3, 2)], range(4), {"mode": 6}))
    assert area(fan) == 1


def test_positions_in_other_numbers(tmp_path):
    # Two sparse corners replace the second and the third.
    more = [(np.array([1, 2]), "u1"), (np.array([[2, 0, 0], [0, 2, 0]]), "f4")]
    sparse = {"count": 2, "indices": {"bufferView": 2, "componentType": 5121},
              "values": {"bufferView": 3}}  # fmt: skip
    assert area(save(tmp_path, gltf(accessor={"sparse": sparse}, more=more))) == 2
    # KHR_mesh_quantization: normalised shorts.
    data = gltf(
        primitive={"attributes": {"POSITION": 2}},
        more=[(np.array([[0, 0, 0], [32767, 0, 0], [0, -32768, 0]]), "i2")],
        extensionsRequired=["KHR_mesh_quantization"],
    )
    tree = json.loads(data)
    tree["accessors"][2]["normalized"] = True
    shape = save(tmp_path, json.dumps(tree).encode())
    assert shape.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, -1, 0]]


def test_morph_targets_have_their_default_weights(tmp_path):
    more = [(np.array([[0, 0, 4.0]] * 3), "f4"), (np.array([[0, 8.0, 0]] * 3), "f4")]
    part = {"attributes": {"POSITION": 0}, "indices": 1,
            "targets": [{"POSITION": 2}, {"POSITION": 3}]}  # fmt: skip
    meshes = [{"primitives": [part], "weights": [0.25, 0.5]}]
    shape = save(tmp_path, gltf(more=more, meshes=meshes))
    np.testing.assert_array_equal(shape.vertices, moved(0, 4, 1))
    # A node's weights replace those of its mesh.
    shape = save(tmp_path, gltf(more=more, meshes=meshes, nodes=[{"mesh": 0, "weights": [1, 0]}]))
    np.testing.assert_array_equal(shape.vertices, moved(0, 0, 4))


def pose(node) -> np.ndarray:
    found = np.eye(4)
    found[:3, :3] = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix()
    found[:3, :3] *= node.get("scale", [1, 1, 1])
    found[:3, 3] = node.get("translation", [0, 0, 0])
    return found


def test_a_skin_moves_by_its_joints_alone(tmp_path):
    rng = np.random.default_rng(3)
    spins = Rotation.random(2, random_state=5).as_quat().tolist()
    nodes = [
        {"mesh": 0, "skin": 0, "translation": [100, 0, 0]},
        {"translation": [1, 2, 3], "rotation": spins[0], "children": [2]},
        {"scale": [1, 2, 1], "rotation": spins[1]},
    ]
    bind = np.stack([pose({"translation": rng.normal(size=3), "scale": [2, 1, 1]}) for _ in "ab"])
    which = np.array([[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0]])
    weight = np.array([[0.5, 0.5, 0, 0], [0.25, 0.25, 0, 0], [1, 0, 0, 0]])
    joints = [pose(nodes[1]), pose(nodes[1]) @ pose(nodes[2])]
    expected = []
    for corner, j, w in zip(CORNERS, which, weight, strict=True):
        moved = sum(w[k] * (joints[j[k]] @ bind[j[k]] @ [*corner, 1]) for k in range(4))
        expected.append((moved / w.sum())[:3])
    more = [(which, "u1"), (weight, "f4"), (bind.transpose(0, 2, 1).reshape(2, 16), "f4")]
    part = {"attributes": {"POSITION": 0, "JOINTS_0": 2, "WEIGHTS_0": 3}}
    data = gltf(
        more=more, primitive=part, nodes=nodes, scenes=[{"nodes": [0, 1]}],
        skins=[{"joints": [1, 2], "inverseBindMatrices": 4}],
    )  # fmt: skip
    np.testing.assert_allclose(save(tmp_path, data).vertices, expected, atol=1e-6)


def test_every_instance_is_drawn(tmp_path):
    spin = Rotation.from_euler("z", 90, degrees=True).as_quat()
    more = [
        (np.array([[0, 0, 0], [5, 0, 0]]), "f4"),
        (np.array([[0, 0, 0, 1], spin]), "f4"),
        (np.array([[1, 1, 1], [2, 2, 2]]), "f4"),
    ]
    columns = {"TRANSLATION": 2, "ROTATION": 3, "SCALE": 4, "_ID": 3}
    instancing = {"EXT_mesh_gpu_instancing": {"attributes": columns}}
    data = gltf(
        more=more, extensionsRequired=["EXT_mesh_gpu_instancing"],
        nodes=[{"mesh": 0, "translation": [0, 0, 1], "extensions": instancing}],
    )  # fmt: skip
    second = [[5, 0, 1], [5, 2, 1], [3, 0, 1]]
    first = moved(0, 0, 1).tolist()
    np.testing.assert_allclose(save(tmp_path, data).vertices, first + second, atol=1e-6)


@pytest.mark.parametrize(
    ("tree", "words"),
    [
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "KHR_draco_mesh_compression"),
        ({"extensionsRequired": ["EXT_meshopt_compression"]}, "EXT_meshopt_compression"),
        ({"extensionsRequired": ["MSFT_lod"]}, "MSFT_lod"),
        ({"nodes": [{"mesh": 0, "children": [0]}], "scenes": [{"nodes": [0]}]}, "parent"),
        ({"buffers": [{"byteLength": 48}]}, "cut or damaged"),
        (
            {"primitive": {"material": 0}, "materials": [{"alphaMode": "MASK", "name": "leaf",
             "extensions": {"KHR_materials_pbrSpecularGlossiness": {"diffuseTexture": {"index": 0}}}
             }], "textures": [{"source": 0}], "images": [{"uri": "leaf.png"}]},
            "alphaMode MASK in the material 'leaf'",
        ),
        (
            {"primitive": {"material": 0}, "materials": [{"alphaMode": "MASK", "name": "leaf",
             "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
             "textures": [{"source": 0}], "images": [{"uri": "leaf.png"}]},
            "cut by alpha, got alphaMode MASK in the material 'leaf'",
        ),
    ],
)  # fmt: skip
def test_what_is_not_implemented_is_refused(tmp_path, tree, words):
    leaf = np.full((2, 2, 4), 255, np.uint8)
    leaf[0, 0, 3] = 0
    imageio.imwrite(tmp_path / "leaf.png", leaf)
    with pytest.raises(InputError, match=words):
        save(tmp_path, gltf(**tree))


def test_holes_in_the_materials_of_an_obj_are_refused(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl leaf\nmap_Kd a.png\nmap_d b.png\nnewmtl wood\nd 1\n")
    corners = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\n"
    assert save(tmp_path, f"{corners}usemtl wood\nf 1 2 3\n".encode(), "a.obj").notes == ()
    with pytest.raises(InputError, match="map_d in the material 'leaf'"):
        save(tmp_path, f"{corners}usemtl leaf\nf 1 2 3\n".encode(), "a.obj")


def test_animations_are_noted(tmp_path):
    (note,) = save(tmp_path, gltf(animations=[{"channels": [], "samplers": []}])).notes
    assert "animations are not played" in note


def test_alpha_that_cuts_nothing_or_everything(tmp_path):
    imageio.imwrite(tmp_path / "full.png", np.full((2, 2, 4), 255, np.uint8))
    surface = {"baseColorTexture": {"index": 0}}
    texture = {"textures": [{"source": 0}], "images": [{"uri": "full.png"}]}
    material = {"alphaMode": "MASK", "pbrMetallicRoughness": surface}
    extension = {"extensionsRequired": ["KHR_materials_unlit", "KHR_texture_transform"]}
    whole = gltf(primitive={"material": 0}, materials=[material], **texture, **extension)
    assert save(tmp_path, whole).notes == ()
    surface["baseColorFactor"] = [1, 1, 1, 0.4]
    gone = gltf(primitive={"material": 0}, materials=[material], **texture)
    with pytest.raises(InputError, match="expected triangles, got none"):
        save(tmp_path, gone)
    material["alphaMode"] = "BLEND"
    (note,) = save(tmp_path, gltf(primitive={"material": 0}, materials=[material], **texture)).notes
    assert "blended" in note


def share_drawn(shape, antialias: bool, turned: bool = False) -> float:
    """The share of a picture that a shape covers, from +z or, ``turned``, from -z."""
    eye = jnp.array([0, 0, -4.0 if turned else 4.0])
    single = None if shape.single_sided is None else jnp.asarray(shape.single_sided)
    thing = Object(
        jnp.asarray(shape.vertices), jnp.asarray(shape.faces),
        jnp.asarray(mesh.edges(shape.faces, shape.single_sided)),
        jnp.zeros(3), jnp.zeros(3), jnp.ones(()), (0.0,) * 3, single_sided=single,
    )  # fmt: skip
    scene = Scene(
        Camera(eye, jnp.zeros(3), jnp.array([0, 1.0, 0]), jnp.array(60.0), 0.1, 50.0),
        Light(-2 * eye, jnp.array(0.001), (1.0,) * 3), (thing,), (1.0,) * 3, (32, 32),
    )  # fmt: skip
    return 1 - float(raster.rasterise(scene, antialias=antialias, still=True).mean())


@pytest.mark.parametrize("antialias", [False, True])
def test_single_sided_faces_are_not_drawn_from_behind(tmp_path, antialias):
    whole = (2 / (8 * np.tan(np.pi / 6))) ** 2
    close = 1e-6 if antialias else 0.03

    def shares(data):
        shape = save(tmp_path, data)
        return [share_drawn(shape, antialias, turned) for turned in (False, True)]

    both = [0, 1, 2, 0, 2, 3]
    assert shares(gltf(SQUARE, both)) == pytest.approx([whole, 0], abs=close)
    double = {"materials": [{"doubleSided": True}], "primitive": {"material": 0}}
    assert shares(gltf(SQUARE, both, **double)) == pytest.approx([whole, whole], abs=close)
    # Faces in both orientations, as where a program knows no double-sided materials.
    assert shares(gltf(SQUARE, [*both, 2, 1, 0, 3, 2, 0])) == pytest.approx([whole] * 2, abs=close)
    # A mirror turns a mesh inside out, and its triangles with it.
    mirrored = [{"mesh": 0, "scale": [-1, 1, 1]}]
    assert shares(gltf(SQUARE, both, nodes=mirrored)) == pytest.approx([whole, 0], abs=close)
    # Two triangles that share an edge and face opposite ways: one is drawn from either side.
    halves = shares(gltf(SQUARE, [0, 1, 2, 0, 3, 2]))
    assert halves == pytest.approx([whole / 2] * 2, abs=close)


# Scenes.

CAMERA = {"type": "perspective", "perspective": {"yfov": np.pi / 3, "znear": 0.5, "aspectRatio": 1}}
LIGHTS = {"KHR_lights_punctual": {"lights": [{"type": "point"}, {"type": "directional"}]}}


def lit(number: int) -> dict:
    return {"extensions": {"KHR_lights_punctual": {"light": number}}}


def stage(**tree) -> bytes:
    """A square in front of a camera at (0, 0, 4), and a light behind it."""
    nodes = [
        {"mesh": 0},
        {"translation": [0, 3, 4], "children": [2]},
        {"translation": [0, -3, 0], "camera": 0},
        {"translation": [0, 1, -6], **lit(0)},
    ]
    whole = {"nodes": nodes, "scenes": [{"nodes": [0, 1, 3]}], "cameras": [CAMERA],
             "extensions": LIGHTS}  # fmt: skip
    return gltf(SQUARE, [0, 1, 2, 0, 2, 3], **(whole | tree))


def read(folder, data: bytes, name="a.gltf") -> Scene:
    (folder / name).write_bytes(data)
    return read_scene(folder / name)


def test_a_gltf_file_is_a_scene_by_itself(tmp_path):
    scene = read(tmp_path, stage())
    text = """
[image]
width = 1080
height = 1080
[camera]
position = [0, 0, 4]
target = [0, 0, 3]
fov_y = 60
near = 0.5
far = 1e6
[light]
position = [0, 1, -6]
radius = {}
[[object]]
mesh = "a.gltf"
"""
    radius = np.sqrt(101) / 10
    (tmp_path / "scene.toml").write_text(text.format(radius))
    expected = read_scene(tmp_path / "scene.toml")
    for name in scene.names:
        np.testing.assert_allclose(scene.value(name), expected.value(name), atol=1e-6)
    assert scene.size == expected.size
    assert (scene.camera.near, scene.camera.far) == (0.5, 1e6)
    (note,) = scene.notes
    assert "no radius; 1 is assumed" in note


def test_the_picture_of_a_gltf_scene_has_the_target_s_size(tmp_path):
    target = Image(np.zeros((30, 40), np.float32), None, "none", "", "")
    assert scene_at_pass_size(read(tmp_path, stage()), target, 0.5).size == (15, 20)


def test_a_directional_light_lies_against_its_direction(tmp_path):
    turned = Rotation.from_euler("y", 180, degrees=True).as_quat().tolist()
    nodes = json.loads(stage())["nodes"]
    nodes[3] = {"rotation": turned, **lit(1)}
    camera = {"type": "perspective", "perspective": {"yfov": 1, "znear": 0.5, "zfar": 100}}
    scene = read(tmp_path, stage(nodes=nodes, cameras=[camera]))
    np.testing.assert_allclose(scene.light.position, [0, 0, 4 - 50], atol=1e-5)
    assert scene.size == (1080, 1920)
    assert len(scene.notes) == 1


@pytest.mark.parametrize(
    ("tree", "words"),
    [
        ({"scenes": [{"nodes": [0]}]}, "no camera and no light; export them, or write"),
        ({"scenes": [{"nodes": [0, 1]}]}, "got no light"),
        ({"cameras": [{"type": "orthographic"}]}, "got an orthographic camera"),
        ({"cameras": [{"type": "perspective", "perspective": {}}]}, "KeyError"),
        ({"cameras": []}, "IndexError"),
        ({"extensions": {}}, "KHR_lights_punctual"),
    ],
)
def test_a_gltf_file_without_a_view_is_refused(tmp_path, tree, words):
    with pytest.raises(InputError, match=words) as caught:
        read(tmp_path, stage(**tree))
    assert "\n" not in str(caught.value)


def test_a_mesh_is_no_scene(tmp_path):
    with pytest.raises(InputError, match=r"no camera; write a \.toml"):
        read(tmp_path, b"v 0 0 0", "a.obj")
    with pytest.raises(InputError, match="no such file"):
        read_scene(tmp_path / "no.glb")


@pytest.mark.parametrize(
    ("move", "words"),
    [
        ({"translation": [0, 0, 9]}, "behind the camera"),
        ({"translation": [0, 0, -96.5]}, "beyond camera.far"),
        ({"translation": [0, -4, 0]}, "outside the frame"),
        ({"rotation": [0, 1, 0, 0]}, "single-sided"),
        ({"translation": [0, -3, 0]}, None),
        ({"translation": [0, 0, -95.5]}, None),
    ],
)
def test_what_is_not_in_view_is_noted(tmp_path, move, words):
    (tmp_path / "a.gltf").write_bytes(gltf(SQUARE, [0, 1, 2, 0, 2, 3], nodes=[{"mesh": 0, **move}]))
    (tmp_path / "scene.toml").write_text(
        "[image]\nwidth = 8\nheight = 8\n[camera]\nposition = [0, 0, 4]\nfov_y = 60\nfar = 100\n"
        '[light]\nposition = [0, 0, -3]\nradius = 0.5\n[[object]]\nmesh = "a.gltf"\n'
    )
    notes = read_scene(tmp_path / "scene.toml").notes
    assert [words in note and "object[0] is not in view" in note for note in notes] == (
        [True] if words else []
    )

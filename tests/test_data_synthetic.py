"""The committed synthetic targets are what data_synthetic/make.py draws."""

import json
import re
import tomllib

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image, ImageSequence

from godfit.__main__ import main
from godfit.flatland import Sky, read_canvas, render
from godfit.io.image import read_image, read_layer
from godfit.io.sidecar import read_sidecar
from godfit.models.mitchell import Mitchell
from godfit.scenes.raster import on_screen
from godfit.scenes.scene import read_scene
from godfit.scenes.view import drawn_mask
from tests.support.paths import DATA_SYNTHETIC as FOLDER
from tests.support.synthetic import bodies, make, stages, steering

MANIFEST = json.loads((FOLDER / "manifest.json").read_text())
TARGETS, SCENES, CANVASES, SCREENS = (
    MANIFEST[key] for key in ("targets", "scenes", "canvases", "screenshots")
)
SEQUENCES = ("icosahedra", "flight")
SUFFIXES = (".png", ".jpg", ".toml", ".json")
COMMITTED = sorted(p.name for p in FOLDER.iterdir() if p.suffix in SUFFIXES)


def _levels(path):
    return np.rint(read_image(path).values * 255).astype(int)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """All files made again. Masks and pictures of scenes and of canvases, which take long, are
    those that lie there: that they are what scene and canvas make is tested below, one by one."""
    folder = tmp_path_factory.mktemp("data_synthetic")

    def lying(name):
        return read_image(FOLDER / name).values.astype(float)

    def render_stage(path, stage):
        path.write_text(stage.text())
        name = path.name.removesuffix(".scene.toml")
        return read_scene(path), lying(f"{name}_mask.png"), lying(f"{name}.png")

    names = iter(CANVASES)
    with pytest.MonkeyPatch.context() as patch, jax.enable_x64(True):
        patch.setattr(make, "render_stage", render_stage)
        patch.setattr(make, "render_plane", lambda *_: lying(CANVASES[next(names)]["target"]))
        make.make(folder)
    return folder


def test_the_same_files_are_made(made):
    assert sorted(p.name for p in made.iterdir()) == COMMITTED


@pytest.mark.parametrize("name", COMMITTED)
def test_made_again_it_is_the_same(made, name):
    if not name.endswith((".png", ".jpg")):
        assert (made / name).read_bytes() == (FOLDER / name).read_bytes()
        return
    new, old = _levels(made / name), _levels(FOLDER / name)
    assert new.shape == old.shape
    if name.endswith(".jpg"):
        # Where one value is rounded the other way its block is coded a little differently.
        assert np.mean(new != old) <= 0.01
        return
    apart = np.abs(new - old).reshape(*old.shape[:2], -1).max(-1)
    # Another processor may round a value that lies between two levels the other way.
    assert apart.max() <= 1
    assert np.count_nonzero(apart) <= 1e-4 * apart.size


def test_manifest_names_every_file():
    kinds = TARGETS, SCENES, CANVASES, SCREENS
    everything = {name: truth for kind in kinds for name, truth in kind.items()}
    assert len(everything) == sum(map(len, kinds))
    named = {"manifest.json"} | {f"{name}.toml" for name in everything}
    for truth in everything.values():
        keys = ("target", "mask", "scene", "background", "canvas")
        named |= {truth[key] for key in keys if key in truth}
    assert sorted(named) == COMMITTED
    assert MANIFEST["schema"] == 1
    assert len(TARGETS) >= 8


@pytest.mark.parametrize("name", TARGETS)
def test_side_file_agrees_with_the_manifest(name):
    truth, beside = TARGETS[name], tomllib.loads((FOLDER / f"{name}.toml").read_text())
    assert {k: beside[k] for k in ("mask", "background") if k in beside} == {
        k: truth[k] for k in ("mask", "background") if k in truth
    }
    lights = sum(key.startswith("light") for key in truth["params"]) // 2
    scattering = {"shader": truth["shader"], "samples": truth["samples"], "arithmetic": "exact"}
    assert beside["scattering"] == scattering | ({"lights": lights} if lights > 1 else {})


@pytest.mark.parametrize("name", SCREENS)
def test_a_screenshot_is_named_with_what_made_it_and_comes_without_a_mask(name):
    truth, beside = SCREENS[name], tomllib.loads((FOLDER / f"{name}.toml").read_text())
    assert beside == {"scattering": {key: truth[key] for key in ("shader", "samples")}}
    picture = _levels(FOLDER / truth["target"])
    (x, y, w, _), *_ = truth["panels"]
    # A panel's own grey, whatever lies under it, but for what a JPEG makes of it.
    rows = picture[y : y + 2, x + 4 : x + w - 4]
    assert np.median(np.abs(rows - np.median(rows))) < 4
    assert truth["params"]["density"] <= 1
    assert 0 < np.mean(picture.min(-1) >= 255) < 0.11
    assert truth["pass_scale"] in (0.5, 1.0)


@pytest.mark.parametrize("name", TARGETS)
def test_target_has_something_to_say(name):
    assert len(np.unique(_levels(FOLDER / TARGETS[name]["target"]))) >= 20


def test_what_the_notes_promise():
    """A tenth clipped, a light outside, a smaller mask, a truth on the bounds."""
    clipped = np.mean(_levels(FOLDER / "clipped.png") == 255)
    assert 0.08 < clipped < 0.12
    light = TARGETS["offscreen"]["params"]
    assert not (0 <= light["light_x"] <= 1 and 0 <= light["light_y"] <= 1)
    assert _levels(FOLDER / "halfres_mask.png").shape == (128, 128)
    assert _levels(FOLDER / "coloured_mask.png").shape[2:] == (3,)
    assert TARGETS["decay_one"]["params"]["decay"] == TARGETS["decay_one"]["params"]["density"] == 1


@pytest.mark.parametrize("name", SCENES)
def test_scene_side_file_agrees_with_the_manifest(name):
    truth = SCENES[name]
    assert read_sidecar(str(FOLDER / truth["target"])) == {
        "scene": str(FOLDER / truth["scene"]),
        "shader": truth["shader"],
        "samples": truth["samples"],
        "arithmetic": "exact",
    }


@eqx.filter_jit
def _reference(model, mask):
    return model(mask, None, method="reference")


# Between the first and the last frame of a sequence, the files are those that are made.
@pytest.mark.parametrize(
    "name", [name for name in SCENES if not re.fullmatch("(flight|icosahedra)_[1-4]", name)]
)
def test_scene_has_the_truth_and_gives_mask_and_target(name):
    truth = SCENES[name]
    scene = read_scene(FOLDER / truth["scene"])
    # One craft of the pursuit leaves the frame.
    assert all("is not in view" in note for note in scene.notes)
    assert scene.antialias is not None
    settings = dict(truth["params"])
    light = settings.pop("light_x"), settings.pop("light_y")
    known = {key: truth[key] for key in ("shader", "samples")} | {"pass_scale": 1}
    assert scene.settings == known | settings
    np.testing.assert_allclose(on_screen(scene), light, atol=1e-8)
    for key, value in truth["known"].items():
        np.testing.assert_allclose(scene.value(key), value, atol=1e-9)

    levels = _levels(FOLDER / truth["mask"])
    mask = np.floor(drawn_mask(scene, scene.antialias).astype(float) * 255 + 0.5).astype(int)
    assert levels.shape == mask.shape
    assert np.abs(levels - mask).max() <= 1
    assert np.mean(levels != mask) < 1e-3
    # Of a hard mask there are no values between those of the scene.
    assert (len(np.unique(levels)) > 20) == scene.antialias

    model = Mitchell(**settings, light=[light], shader=truth["shader"], samples=truth["samples"])
    image = np.asarray(_reference(model, jnp.asarray(levels / 255)))
    target = _levels(FOLDER / truth["target"])
    apart = np.abs(np.floor(image.clip(0, 1) * 255 + 0.5) - target)
    assert apart.max() <= 1
    assert np.mean(apart > 0) < 1e-4


@pytest.mark.parametrize("name", SCENES)
def test_scene_shows_rays_and_is_not_clipped(name):
    levels = _levels(FOLDER / SCENES[name]["target"])
    assert np.mean(levels == 255) < 0.07
    assert 10 < np.median(levels) < 80
    assert len(np.unique(levels)) >= 100


def test_scenes_are_not_all_alike():
    assert {SCENES[name]["shader"] for name in SCENES} == {"dawntime", "vesper"}
    stills = [name for name in SCENES if name.startswith("stage_")]
    assert len({tuple(SCENES[name]["params"].values()) for name in stills}) == len(stills) == 5
    icosahedra = SCENES["icosahedra_0"]["params"]
    assert list(icosahedra.values())[:4] == [0.08, 0.975, 0.8, 0.6]
    assert SCENES["stage_warehouse"]["params"]["exposure"] == 0.2
    assert _levels(FOLDER / SCENES["stage_ship"]["mask"]).shape == (180, 320, 3)


@pytest.mark.parametrize("name", ["stage_skull", "stage_ship", "stage_table", "flight_0"])
def test_scenes_have_the_numbers_of_their_source(name):
    vesper = name in ("stage_table", "flight_0")
    truth, scene = SCENES[name], read_scene(FOLDER / SCENES[name]["scene"])
    assert (truth["shader"], truth["samples"]) == (("dawntime", 200), ("vesper", 150))[vesper]
    params = {"exposure": 0.05, "decay": 0.99, "density": 0.8, "weight": 0.8}
    assert {key: truth["params"][key] for key in params} == params
    if name != "stage_ship":
        assert scene.background == ((16 if vesper else 17) / 255,) * 3


# A coloured mask, the other shader, and a scene that moves: the others go the same ways.
@pytest.mark.parametrize("name", ["stage_ship", "stage_table", "icosahedra_0"])
def test_the_light_pass_is_the_composite_without_the_ordinary_pass(name, tmp_path):
    """Through the command line, on a small copy."""
    text = (FOLDER / SCENES[name]["scene"]).read_text()
    text = re.sub(r"(width|height) = \d+\n", r"\1 = 32\n", text, count=2)
    (tmp_path / "scene.toml").write_text(text)

    def drawn(*options):
        command = ["render", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "a.npy")]
        with jax.enable_x64(False):
            assert main([*command, *options]) == 0
        return np.atleast_3d(read_image(tmp_path / "a.npy").values)

    light, composite = drawn(), drawn("--composite")
    ordinary = drawn("--composite", "--exposure", "0")
    open_ = (composite < 1) & (light < 1)
    assert open_.mean() > 0.8
    off = np.where(open_, composite - ordinary - light, 0)
    assert np.abs(off).max() < 1 / 255
    assert np.mean(ordinary.max(-1) > 0.02) > 0.02
    assert ordinary.max() < 0.9


def test_icosahedron_moves_as_in_the_source():
    for i in range(6):
        truth = SCENES[f"icosahedra_{i}"]
        a = 0.009 * truth["update"]
        known, turn = truth["known"], np.rad2deg(truth["update"])
        at = [4 * np.sin(a), 0, 4 * np.cos(a)]
        np.testing.assert_allclose(known["object[0].position"], at, atol=1e-5)
        np.testing.assert_allclose(
            known["object[0].rotation"], [0.01 * turn, 0.005 * turn, 0], atol=1e-5
        )


def test_flight_is_a_closed_path_through_its_points_and_is_pursued():
    flight = stages.lap()
    assert len(flight.leader) == len(flight.pursuer) == stages.FLIGHT_UPDATES
    for places, speed in zip((flight.leader, flight.pursuer), stages.FLIGHT_SPEEDS, strict=True):
        # The step from the last place to the first is one like all others.
        steps = np.linalg.norm(np.roll(places, -1, axis=0) - places, axis=1)
        assert steps.max() <= 1.01 * speed * steering.UPDATE_SECONDS
        assert steps.min() > 0.3 * steps.max()
    for point in stages.FLIGHT_PATH:
        nearest = np.linalg.norm(flight.leader - point, axis=1).min()
        assert nearest < stages.NEAR_POINT
    distance = np.linalg.norm(flight.pursuer - flight.leader, axis=1)
    assert distance.min() > 0.4
    assert distance.max() < 2.5


def test_the_pursuer_flies_to_where_its_target_will_be():
    """After the time in which the two cover their distance; one that comes head on is met where it
    is."""
    leader = steering.Craft(np.array([0.0, 3, 0]), np.array([1.0, 0, 0]), 1.0)
    pursuer = steering.Craft(np.zeros(3), np.array([0.0, 1, 0]), 2.0)
    np.testing.assert_allclose(steering.predicted(pursuer, leader), [3 / (2 + 1), 3, 0])
    coming = steering.Craft(np.array([0.0, 3, 0]), np.array([0.0, -1, 0]), 1.0)
    np.testing.assert_allclose(steering.predicted(pursuer, coming), [0, 3, 0])


def test_a_craft_keeps_its_speed_limit():
    craft = steering.Craft(np.zeros(3), np.zeros(3), 1.5)
    for _ in range(600):
        craft.steer(np.array([1e3, 0, 0]))
        assert np.linalg.norm(craft.velocity) <= 1.5 + 1e-12
    np.testing.assert_allclose(craft.velocity, [1.5, 0, 0], atol=1e-3)
    at, path = 0, np.array([[0.0, 0, 0], [1, 0, 0]])
    assert steering.next_point(steering.Craft(path[1], path[0], 1.0), path, at, 0.5) == 0
    assert steering.next_point(steering.Craft(path[1], path[0], 1.0), path, 1, 0.5) == 0
    assert steering.next_point(steering.Craft(path[0], path[0], 1.0), path, at, 0.5) == 1


def test_flight_truth_is_where_they_are():
    flight = stages.lap()
    for i in range(6):
        truth = SCENES[f"flight_{i}"]
        leader, pursuer = (truth["known"][f"object[{k}].position"] for k in (0, 5))
        np.testing.assert_allclose(leader, flight.leader[truth["update"]], atol=1e-5)
        np.testing.assert_allclose(pursuer, flight.pursuer[truth["update"]], atol=1e-5)


@pytest.mark.parametrize("turn", [(10, 20, 30), (-170, 60, 5), (20, 90, 0), (0, -90, 35)])
def test_angles_are_those_of_the_matrix(turn):
    matrix = bodies.rotation_matrix(turn)
    angles = bodies.rotation_angles(matrix)
    np.testing.assert_allclose(bodies.rotation_matrix(angles), matrix, atol=1e-7)


@pytest.mark.parametrize("end", [(0, 1, 0), (2, -1, 0.5), (-1, 0, 0), (0, 0, 3)])
def test_strut_ends_where_it_should(end):
    part = bodies.strut(0.1, (0, 0, 0), end)
    tip = part["position"] + bodies.rotation_matrix(part["rotation"]) @ [0, part["height"] / 2, 0]
    np.testing.assert_allclose(tip, end, atol=1e-12)


@pytest.mark.parametrize("name", CANVASES)
def test_canvas_and_truth_give_the_target(made, name):
    truth = CANVASES[name]
    assert read_sidecar(str(FOLDER / truth["target"])) == {
        "canvas": str(FOLDER / truth["canvas"]),
        "model": "flatland",
        "rays": truth["rays"],
    }
    params = truth["params"]
    sun, sky = (tuple(params[f"{key}_{c}"] for c in "rgb") for key in ("sun", "sky"))
    around = Sky(params["sun_angle"], params["sun_width"], sun, sky)
    image = render(read_canvas(FOLDER / truth["canvas"]), around, rays=truth["rays"],
                   exposure=params["exposure"])  # fmt: skip
    target = _levels(FOLDER / truth["target"])
    # Sums of bytes over 128 rays often lie on a half itself, which rounds either way: no byte is
    # farther from its value than a half.
    assert np.abs(np.asarray(image).clip(0, 1) * 255 - target).max() < 0.5 + 1e-4
    assert len(np.unique(target)) >= 60
    new, old = (read_layer(folder / truth["canvas"])[1] for folder in (made, FOLDER))
    np.testing.assert_array_equal(new, old)


def test_animation_of_sand(tmp_path):
    make.make_sand_gif(tmp_path / "x.gif", frames=4)
    with Image.open(tmp_path / "x.gif") as animation:
        assert animation.info["loop"] == 0
        frames = [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(animation)]
    assert np.shape(frames) == (4, 384, 384, 3)
    assert all((a != b).any() for a, b in zip(frames[1:], frames, strict=False))


@pytest.mark.parametrize("name", SEQUENCES)
def test_animation(tmp_path, name):
    make.make_gif(tmp_path / "x.gif", name, frames=2)
    with Image.open(tmp_path / "x.gif") as animation:
        assert animation.info["loop"] == 0
        assert animation.info["duration"] == 2000
        frames = [np.asarray(frame.convert("L")) for frame in ImageSequence.Iterator(animation)]
    assert np.shape(frames) == (2, 256, 256)
    assert (frames[0] != frames[1]).any()


def test_the_folder_is_small():
    assert sum(p.stat().st_size for p in FOLDER.iterdir() if p.is_file()) < 1_500_000

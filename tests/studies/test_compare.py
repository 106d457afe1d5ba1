"""Two models against each other: the one that made the picture is preferred."""

import json
from pathlib import Path

import numpy as np
import pytest

from godfit.__main__ import main
from godfit.io.image import write_image
from godfit.studies.compare import compare
from tests.support import daylight_targets, random_targets

SIZE = 96


@pytest.fixture(scope="module")
def sunny():
    """A target of Hoffman and Preetham's, and how the world was seen."""
    view, image, truth = daylight_targets.draw(11, "bars", SIZE)
    found = compare(
        random_targets.to_bytes(image),
        mask=view["mask"],
        light=(truth["light_x"], truth["light_y"]),
        fov=view["fov"],
        distance=view["distance"],
        samples=daylight_targets.SAMPLES,
        shader="dawntime",
    )
    return found, truth


def test_daylight_is_preferred_where_it_is_true(sunny):
    found, _ = sunny
    assert found.best.result.model.name == "hoffman-preetham"
    assert found.best.result.converged
    assert "hoffman-preetham" in found.sentence
    assert "is preferred" in found.sentence


def test_a_light_that_is_given_right_needs_fewer_parameters(sunny):
    """Schwarz's criterion takes the light for known where that costs nothing."""
    rows = {row.name: row for row in sunny[0].rows}
    assert next(iter(rows)) == "hoffman-preetham"
    assert (
        rows["hoffman-preetham, light free"].parameters == rows["hoffman-preetham"].parameters + 2
    )
    assert rows["hoffman-preetham"].result.params["light_x"].fixed


def test_criteria_are_those_of_the_likelihood(sunny):
    for row in sunny[0].rows:
        values = row.result.pixels * 3
        cost = -2 * row.result.log_likelihood
        assert row.aic == pytest.approx(cost + 2 * row.parameters)
        assert row.bic == pytest.approx(cost + np.log(values) * row.parameters)


def test_mitchell_is_preferred_where_it_is_true():
    mask, image, truth = random_targets.draw(12, "terrain", SIZE)
    found = compare(
        random_targets.to_bytes(image), mask=mask, shader="dawntime", samples=int(truth["samples"])
    )
    assert [row.name for row in found.rows] == [
        "mitchell, light free",
        "hoffman-preetham, light free",
    ]
    assert "is preferred" in found.sentence
    assert any("distance" in note for note in found.rows[1].result.notes)


def test_command_writes_a_table_and_two_files(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    view, _, truth = daylight_targets.draw(11, "bars", SIZE)
    view["distance"] = np.ones_like(view["mask"])
    image = daylight_targets.radiance64(truth, view)
    write_image("sky.png", view["mask"])
    write_image("frame.png", random_targets.to_bytes(image * (0.9 / image.max())) / 255)
    light = f"{truth['light_x']},{truth['light_y']}"
    options = [
        "compare", "frame.png", "--mask", "sky.png", "--fov", str(view["fov"]), "--distance", "1",
        "--light", light, "--shader", "dawntime", "--samples", "60",
    ]  # fmt: skip
    assert main(options) == 0
    out, err = capsys.readouterr()
    assert "BIC" in out
    assert "hoffman-preetham" in out
    record = json.loads(Path("frame.godfit/compare.json").read_text())
    assert record["preferred"].startswith("hoffman-preetham")
    assert [fit["fit"]["model"] for fit in record["fits"]].count("mitchell") == 2
    assert Path("frame.godfit/compare.png").stat().st_size > 10_000
    assert "Traceback" not in err


def test_command_needs_a_mask_or_a_scene(tmp_path, capsys):
    write_image(tmp_path / "frame.png", np.zeros((8, 8)))
    assert main(["compare", str(tmp_path / "frame.png")]) == 2
    assert "expected --mask IMAGE or --scene" in capsys.readouterr().err


SCENE = """
[image]
width = 40
height = 30
[camera]
position = [0, 0, 0]
target = [0, 0, -1]
far = 20
[light]
position = [0, 30, -100]
radius = 4
[[object]]
primitive = "box"
position = [0.5, 1, -5]
"""


@pytest.fixture
def stage(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    return tmp_path / "scene.toml"


@pytest.mark.parametrize("model", ["hoffman-preetham", "volume"])
def test_daylight_is_rendered_from_a_scene(stage, model):
    out = stage.parent / "out.npy"
    air = ["--e-sun", "8", "--scale", "2e4", "--turbidity", "3", "--g", "0.7"]
    assert main(["render", str(stage), "--model", model, *air, "-o", str(out)]) == 0
    image = np.load(out)
    assert image.shape == (30, 40, 3)
    # A low sun is red, and the box takes light away.
    assert image[..., 0].mean() > image[..., 2].mean()
    assert image[2, 2].sum() > 1.5 * image[12:15, 22:24].min(axis=(0, 1)).sum()


def test_lamp_lights_the_air_around_it(stage):
    stage.write_text(
        SCENE.replace("[0, 30, -100]", "[0.2, -0.5, -4]").replace("radius = 4", "radius = 0.1")
    )
    out = stage.parent / "out.npy"
    options = ["--e-sun", "2", "--scale", "5e3", "--source", "lamp", "--steps", "64"]
    assert main(["render", str(stage), "--model", "volume", *options, "-o", str(out)]) == 0
    image = np.load(out).mean(-1)
    row, column = np.unravel_index(image.argmax(), image.shape)
    assert abs(row - 17) <= 2
    assert abs(column - 21) <= 2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--model", "volume", "--scale", "1"], "e_sun: expected a value, got none; give --e-sun"),
        (["--model", "hoffman-preetham", "--e-sun", "1"], "give --scale"),
        (["--model", "fog"], "model: expected one of mitchell, hoffman-preetham"),
        (["--model", "volume", "--e-sun", "1", "--scale", "1", "--source", "moon"], "sun or lamp"),
        (["--model", "volume", "--e-sun", "1", "--scale", "1", "--phase", "mie"], "normalised"),
        (["--model", "volume", "--e-sun", "1", "--scale", "1", "--g", "1"], "expected g from"),
    ],
)
def test_bad_air_is_one_line(stage, capsys, options, words):
    out = stage.parent / "out.png"
    assert main(["render", str(stage), *options, "-o", str(out)]) == 1
    err = capsys.readouterr().err
    assert words in err
    assert err.count("\n") == 1
    assert not out.exists()


def test_fit_of_daylight_is_rendered_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    view, _, _ = daylight_targets.draw(11, "bars", SIZE)
    write_image("sky.png", view["mask"])
    flat = daylight_targets.radiance64(
        dict(zip(daylight_targets.NAMES, (12.0, 4e4, 3.0, 0.6, 0.4, 0.8), strict=True)),
        view | {"distance": np.ones_like(view["mask"]), "fov": 50.0},
    )
    write_image("frame.png", np.clip(random_targets.to_bytes(flat) / 255, 0, 1))
    given = ["--model", "hoffman-preetham", "--fov", "50", "--distance", "1", "--samples", "60"]
    assert main(["fit", "frame.png", "--mask", "sky.png", *given]) == 0
    record = json.loads(Path("frame.godfit/fit.json").read_text())
    assert record["model"] == "hoffman-preetham"
    assert record["params"]["turbidity"]["value"] == pytest.approx(3, rel=0.02)
    fit_json = "frame.godfit/fit.json"
    assert main(["render", "sky.png", "--params", fit_json, "-o", "again.npy"]) == 0
    np.testing.assert_allclose(255 * np.load("again.npy"), 255 * np.clip(flat, 0, 1), atol=1.0)

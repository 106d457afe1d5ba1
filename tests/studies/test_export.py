"""A fit's numbers for other engines, from its file, as the command prints them."""

import json

import numpy as np
import pytest

from godfit.__main__ import main
from godfit.io.image import write_image
from godfit.models.mitchell import Mitchell
from godfit.report.engines.export import EXACT_LEVELS
from godfit.report.record import Recorded
from godfit.scattering.engines import ENGINES
from godfit.studies.export import engine_named, for_engine
from tests.support import random_targets

LIGHT = (0.55, 0.62)
POINT = {"exposure": 0.12, "decay": 0.95, "density": 0.8, "weight": 0.5}
SIZE = 48


@pytest.fixture(scope="module")
def mask():
    drawn = random_targets.ellipses(np.random.default_rng(3), SIZE, np.array(LIGHT))
    return np.round(255 * drawn.clip(0, 1)).astype(np.uint8) / np.float32(255)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, mask):
    """A fit.json and its mask, written by hand."""
    folder = tmp_path_factory.mktemp("export")
    write_image(folder / "mask.png", mask)
    params = POINT | {"light_x": LIGHT[0], "light_y": LIGHT[1]}
    record = {
        "schema": 1, "model": "mitchell", "shader": "dawntime", "samples": 20,
        "params": {name: {"value": value} for name, value in params.items()},
        "inputs": {"mask": {"path": str(folder / "mask.png")}}, "size": [SIZE, SIZE],
    }  # fmt: skip
    (folder / "fit.json").write_text(json.dumps(record))
    return folder


def exported(folder, capsys, *options):
    status = main(["export", str(folder / "fit.json"), "-q", *options])
    said = capsys.readouterr()
    return status, said.out, said.err


def test_the_list_names_every_engine(capsys):
    assert main(["export", "--to", "list"]) == 0
    printed = capsys.readouterr().out
    assert all(f"\n  {name} " in printed for name in ENGINES)


def test_an_exact_engine_has_its_own_names_and_no_difference(folder, capsys):
    status, printed, _ = exported(folder, capsys, "--to", "Babylon.js")
    assert status == 0
    assert "the same picture" in printed
    for line in ("rays.exposure = 0.3;", "rays.decay = 0.95;", "rays.density = 0.76;"):
        assert line.rstrip(";0") in printed
    assert '"rays", 1.0, camera, mesh, 19,' in printed


def test_what_the_own_pixel_changes_is_said_in_levels(folder, capsys):
    status, printed, _ = exported(folder, capsys, "--to", "glsl-godrays")
    assert status == 0
    assert "levels rms" in printed
    assert "pixel's own value has a factor of 0, in the fit 0.12" in printed.replace("\n// ", " ")


def test_v_runs_down_where_the_engine_has_it_so(folder, capsys):
    for name, v in (("dawntime", 0.62), ("mitchell", 0.38)):
        assert f"0.55, {v}" in exported(folder, capsys, "--to", name)[1].replace("0000", "")


def test_another_look_is_refused_with_its_levels(folder, capsys):
    status, printed, error = exported(folder, capsys, "--to", "three")
    assert (status, printed) == (1, "")
    assert "within 10 levels rms, got" in error
    assert error.count("\n") == 1


def test_files(folder, capsys, tmp_path):
    out = tmp_path / "rays.frag"
    status, printed, _ = exported(folder, capsys, "--to", "glsl", "-o", str(out))
    assert (status, printed.startswith(str(out))) == (0, True)
    assert out.read_text().startswith("#version 300 es\n//")
    (tmp_path / "fit.json").write_text(
        (folder / "fit.json").read_text().replace("mask.png", "gone.png")
    )
    # Algebra needs no mask; a refit does, and names what is missing.
    assert main(["export", str(tmp_path / "fit.json"), "--to", "vesper", "-q"]) == 0
    assert "not rendered" in capsys.readouterr().out
    assert main(["export", str(tmp_path / "fit.json"), "--to", "blender", "-q"]) == 1
    assert "gone.png" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "status", "names"),
    [
        (["--to", "babylom"], 1, "babylon"), (["--to", "unity"], 1, "did you mean"),
        (["--to", "glsl", "-o", "nowhere/rays.frag"], 1, "nowhere"),
        (["--to", "glsl", "--mask"], 2, "--mask"),
    ],
)  # fmt: skip
def test_bad_requests_are_one_line(folder, capsys, options, status, names):
    found, printed, error = exported(folder, capsys, *options)
    assert (found, printed, error.count("\n")) == (status, "", 1)
    assert names in error


def test_a_fit_of_a_users_file_is_self_contained(folder, capsys, tmp_path):
    record = json.loads((folder / "fit.json").read_text())
    record |= {"shader": "mine", "shader_definition": {"name": "mine", "gain": 0.4, "drop": 1}}
    (tmp_path / "fit.json").write_text(json.dumps(record))
    assert main(["export", str(tmp_path / "fit.json"), "--to", "babylon", "-q"]) == 0
    printed = capsys.readouterr().out
    assert "the same picture" in printed
    assert "rays.exposure = 0.12" in printed
    record["shader_definition"]["gain"] = -1
    (tmp_path / "fit.json").write_text(json.dumps(record))
    assert main(["export", str(tmp_path / "fit.json"), "--to", "babylon", "-q"]) == 1
    assert "gain" in capsys.readouterr().err


def test_a_refit_finds_its_own_picture(single_precision, mask):
    """The picture of a mean, as a sum with decay: no algebra, and a refit that ends near it."""
    model = Mitchell(0.5, 1.0, 0.6, 0.05, LIGHT, "mitchell", 24)
    images = Recorded(model, mask, None, (SIZE, SIZE), "none", ())
    found = for_engine(model, engine_named("natron"), images)
    assert found.difference.rms < 10
    assert found.difference.worst > EXACT_LEVELS

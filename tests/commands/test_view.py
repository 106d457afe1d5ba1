"""Pages without a fit: view makes one from a fit.json, and render from a mask."""

import json
import os
import shutil
from pathlib import Path

import pytest

from godfit.__main__ import main

FOLDER = Path(__file__).parents[2] / "data_synthetic"
NUMBERS = {
    "exposure": 0.08, "decay": 0.97, "density": 0.9, "weight": 0.6, "light_x": 0.56, "light_y": 0.6,
}  # fmt: skip


@pytest.fixture
def record(tmp_path, monkeypatch):
    """A fit.json with the numbers that disc.png was made with, and its images."""
    for name in ("disc.png", "disc_mask.png"):
        shutil.copy(FOLDER / name, tmp_path)
    inputs = {"target": {"path": "disc.png"}, "mask": {"path": "disc_mask.png"}}
    params = {name: {"value": value, "stderr": 1e-3} for name, value in NUMBERS.items()}
    found = {
        "schema": 2, "converged": True, "message": "converged", "model": "mitchell",
        "shader": "dawntime", "samples": 20, "params": params, "inputs": inputs,
    }  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("fit.json").write_text(json.dumps(found))
    return found


def test_view_makes_the_page_once(record, capsys, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    assert main(["view", "fit.json", "--no-open"]) == 0
    assert capsys.readouterr().out == "report.html\n"
    page = Path("report.html")
    assert '"exposure", "value": 0.08' in page.read_text(encoding="utf-8")
    assert opened == []
    page.write_text("as it was")
    assert main(["view", os.curdir]) == 0
    assert opened == [page.resolve().as_uri()]
    assert page.read_text() == "as it was"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"inputs": {"mask": {"path": "disc_mask.png"}}}, "expected the path of a target"),
        ({"model": "hoffman-preetham"}, "expected a fit of mitchell"),
    ],
)
def test_view_says_what_is_missing(record, capsys, change, words):
    Path("fit.json").write_text(json.dumps(record | change))
    assert main(["view", "fit.json", "--no-open"]) == 1
    shown = capsys.readouterr().err
    assert words in shown
    assert shown.count("\n") == 1
    assert not Path("report.html").exists()
    assert main(["view", "nothing.json"]) == 1
    assert "expected a fit.json or a folder" in capsys.readouterr().err


def test_render_makes_a_page_of_a_mask(record, capsys):
    given = ["--shader", "dawntime", "--samples", "20", "--light", ".5,.6"]
    assert main(["render", "disc_mask.png", "--html", "page.html", *given]) == 0
    assert '"light_x", "value": 0.5' in Path("page.html").read_text(encoding="utf-8")
    assert main(["render", "disc_mask.png"]) == 2
    assert "expected -o IMAGE or --html FILE" in capsys.readouterr().err
    model = ["--model", "hoffman-preetham", "--e-sun", "1", "--scale", "1", "--light", ".5,.6"]
    assert main(["render", "disc_mask.png", "--html", "other.html", *model]) == 2
    assert "--html: expected --model mitchell" in capsys.readouterr().err
    assert not Path("other.html").exists()

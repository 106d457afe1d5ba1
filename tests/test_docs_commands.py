"""Every godfit command line in README.md and the pages that teach is one that the program takes.

Each is run on tiny pictures of the names that the pages use, up to the search itself: files are
read, options are checked, and the problem is posed. What does not search runs to its end, but for
the rasteriser. Whole searches of such pictures are tested elsewhere, and would take minutes here.
"""

import contextlib
import json
import re
import shlex
from pathlib import Path

import click
import numpy as np
import pytest

import godfit.blind.bare_fit
import godfit.blind.two_screenshots
import godfit.fitting
import godfit.fitting.found
import godfit.fitting.posing
import godfit.scenes.view
import godfit.studies.clip
import godfit.studies.simplify
from godfit.__main__ import cli, main
from godfit.io.image import write_image
from godfit.scattering.conventions import CONVENTIONS
from godfit.scattering.conventions.shader_file import shader_text

ROOT = Path(__file__).parents[1]
PAGES = ("README", "docs/tutorial", "docs/howto", "docs/engines", "docs/troubleshooting")
COMMAND = re.compile(
    r"^\s*(?:[^`\n]*&& )?(?:\S*python3? -m )?godfit "
    r"((?:fit|mask|render|select|simplify|compare|shaders)\b[^`\n]*)$",
    re.MULTILINE,
)
BATCH = re.compile(r"^\s+python -m godfit batch ((?:[^`\n\\]|\\\n)*)$", re.MULTILINE)
FRAMES = ["frame_1.png", "frame_2.png"]
"""What a shell puts in place of frame_*.png."""
SCENE = """
[image]
width = 24
height = 24
[camera]
position = [0, 0, 7]
[light]
position = [0, 0, 0]
radius = 0.8
[[object]]
primitive = "icosphere"
position = [0.5, 0, 3]
"""
SAVED = {
    "model": "mitchell",
    "shader": "dawntime",
    "samples": 100,
    "params": {
        name: {"value": value, "stderr": None}
        for name, value in {
            "exposure": 0.08, "decay": 0.97, "density": 0.9, "weight": 0.6, "light_x": 0.56,
            "light_y": 0.6,
        }.items()
    },
    "inputs": {"mask": {"path": "mask.png"}},
}  # fmt: skip


class Reached(BaseException):
    """The search would begin here."""


def written():
    """(page, arguments) of every command line, variables of the shell replaced by a name."""
    for page in PAGES:
        text = (ROOT / f"{page}.md").read_text(encoding="utf-8")
        for line in COMMAND.findall(text):
            line = line.split("#")[0].replace('masks/$(basename "$frame")', "masks/frame_1.png")
            yield page, shlex.split(line.replace('"$frame"', "frame_1.png"))


COMMANDS = [
    pytest.param(args, id=f"{page.split('/')[-1]}: {' '.join(args)}") for page, args in written()
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    for name in ("data_synthetic", "masks", "frame.godfit", "disc.godfit"):
        (folder / name).mkdir()
    rng = np.random.default_rng(0)
    names = (
        "frame", "frame_1", "frame_2", "mask", "ordinary", "screenshot", "photograph",
        "data_synthetic/disc", "data_synthetic/disc_mask", "masks/frame_1", "masks/frame_2",
    )  # fmt: skip
    for name in names:
        write_image(folder / f"{name}.png", rng.random((24, 24)))
    (folder / "photograph.png").rename(folder / "photograph.jpg")
    (folder / "scene.toml").write_text(SCENE)
    (folder / "mine.toml").write_text(shader_text(CONVENTIONS["dawntime"]))
    (folder / "data_synthetic" / "disc.toml").write_text('mask = "disc_mask.png"\n')
    for name in ("frame", "disc"):
        (folder / f"{name}.godfit" / "fit.json").write_text(json.dumps(SAVED))
    return folder


@pytest.fixture
def without_search(monkeypatch):
    def reached(*args, **options):
        raise Reached

    monkeypatch.setattr(godfit.fitting.found, "search", reached)
    monkeypatch.setattr(
        godfit.fitting.posing, "refined_mask", lambda _, problem, *rest: problem.picture
    )
    # The rasteriser takes ten seconds to compile, and has tests of its own.
    for module in (godfit.fitting.posing, godfit.scenes.view):
        monkeypatch.setattr(module, "drawn_mask", lambda scene, *rest: np.eye(*scene.size))
    for module in (godfit.blind.bare_fit, godfit.blind.two_screenshots):
        monkeypatch.setattr(module, "found_in", reached)
    monkeypatch.setattr(godfit.fitting.found.conventions, "identified", reached)
    monkeypatch.setattr(godfit.studies.simplify, "simplify", reached)


def test_commands_are_found():
    kinds = {args[0] for _, args in written()}
    assert {"fit", "mask", "select", "simplify", "compare", "shaders"} <= kinds
    assert len(COMMANDS) >= 20


@pytest.mark.parametrize("args", COMMANDS)
def test_command(args, folder, without_search, monkeypatch, capsys, single_precision):
    monkeypatch.chdir(folder)
    if "frame_*.png" in args:
        at = args.index("frame_*.png")
        args = [*args[:at], *FRAMES, *args[at + 1 :]]
    searches = args[0] in ("fit", "select", "compare", "simplify")
    with pytest.raises(Reached) if searches else contextlib.nullcontext():
        status = main(args)
        assert status == 0, capsys.readouterr().err
    assert "error" not in capsys.readouterr().err


@pytest.mark.parametrize("page", ["docs/howto", "docs/batch"])
def test_lines_of_batches_are_taken(page):
    """What they do to frames, alone, in shards and on a cluster of the loopback, is tested with the
    batches."""
    lines = BATCH.findall((ROOT / f"{page}.md").read_text(encoding="utf-8"))
    assert len(lines) >= 2
    command = cli.get_command(click.Context(cli), "batch")
    for line in lines:
        given = shlex.split(line.replace("\\\n", " "))
        assert command.make_context("batch", given).params["output"] == "run"

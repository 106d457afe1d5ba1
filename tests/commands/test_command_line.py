"""The command line: what it prints, writes and returns, above all when it is given nonsense."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from godfit import InputError, read_image, write_image
from godfit.__main__ import main
from godfit.commands import progress
from godfit.io.sidecar import read_sidecar
from godfit.io.sources import shrink_mask
from godfit.report.text import number
from tests.support.paths import DATA_SYNTHETIC as FOLDER

MANIFEST = json.loads((FOLDER / "manifest.json").read_text())


@pytest.fixture
def disc(tmp_path):
    """The example target with its mask and side file, in a folder of its own."""
    for name in ("disc.png", "disc_mask.png", "disc.toml"):
        shutil.copy(FOLDER / name, tmp_path)
    return tmp_path / "disc.png"


def held(**changes):
    """The example's truth, or ``changes``, as options of a fit: nothing is searched for."""
    values = MANIFEST["targets"]["disc"]["params"] | changes
    return [word for name, value in values.items() for word in ("--fix", f"{name}={value}")]


def fails(capsys, status, *arguments):
    """The one line that a failing command leaves on stderr."""
    assert main([str(a) for a in arguments]) == status
    printed = capsys.readouterr()
    assert printed.out == ""
    lines = [line for line in printed.err.splitlines() if "warning" not in line]
    assert len(lines) == 1, printed.err
    assert lines[0].startswith("godfit: error: ")
    return lines[0]


def leftovers(folder):
    return sorted(p.name for p in folder.rglob("*") if p.is_file())


def test_fit_writes_its_files_and_prints_a_table(disc, capsys):
    folder = disc.with_suffix(".godfit")
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    (folder / "fit.json").write_text("{old")
    assert main(["fit", str(disc)]) == 0
    printed = capsys.readouterr()
    assert "exposure" in printed.out
    assert "converged" in printed.out
    names = ["fit.json", "fit.png", "notes.txt", "render.png", "report.html"]
    assert leftovers(folder) == names
    record = json.loads((folder / "fit.json").read_text())
    assert record["schema"] == 2
    assert record["shader"] == "dawntime"
    assert record["inputs"]["target"]["sha256"] == read_image(disc).sha256
    assert set(record["timing_s"]) == {"import", "compile", "solve", "total"}
    rendered, target = read_image(folder / "render.png"), read_image(disc)
    assert np.abs(rendered.values - target.values).max() < 1.01 / 255
    assert read_image(folder / "fit.png").values.ndim == 3


def test_a_fit_renders_again(disc, capsys):
    """fit.json feeds render, in 8 bits, 16 bits and floats, and these agree."""
    assert main(["fit", str(disc), "-q", "-o", str(disc.parent / "out"), "--no-html"]) == 0
    assert leftovers(disc.parent / "out") == ["fit.json", "fit.png", "render.png"]
    for name, bits in (("a.png", "8"), ("b.png", "16"), ("c.npy", "8")):
        arguments = ["render", str(disc.parent / "disc_mask.png"), "-o", str(disc.parent / name)]
        arguments += ["--params", str(disc.parent / "out" / "fit.json"), "--bits", bits]
        assert main(arguments) == 0
    eight, sixteen, floats = (read_image(disc.parent / n) for n in ("a.png", "b.png", "c.npy"))
    assert eight.quantum == pytest.approx(1 / 255)
    assert sixteen.quantum == pytest.approx(1 / 65535)
    assert np.abs(eight.values - floats.values).max() < 0.51 / 255
    assert np.abs(sixteen.values - floats.values).max() < 0.51 / 65535
    assert np.abs(eight.values - read_image(disc).values).max() < 1.01 / 255


def test_render_with_defaults_background_and_size(disc):
    mask, out = disc.parent / "disc_mask.png", disc.parent / "out.png"
    arguments = ["render", str(mask), "-o", str(out), "--shader", "babylon", "--light", "0.5,0.6"]
    assert main([*arguments, "--background", str(disc)]) == 0
    lit, under = read_image(out).values, read_image(disc).values
    assert (lit >= under - 1 / 255).all()
    assert (lit - under).mean() > 0.05
    assert main([*arguments, "--size", "64x32"]) == 0
    assert read_image(out).values.shape == (32, 64)


def test_the_light_pass_has_the_shader_s_size_unless_something_else_is_known(disc):
    mask, folder = str(disc.parent / "disc_mask.png"), disc.parent
    low = shrink_mask(read_image(mask).values, 0.5)
    write_image(folder / "low.png", low)

    def drawn(*arguments):
        assert main(["render", *arguments, "-o", str(folder / "a.npy")]) == 0
        return read_image(folder / "a.npy").values

    for shader in ("dawntime", "vesper"):
        half = drawn(mask, "--shader", shader)
        np.testing.assert_array_equal(half, drawn(mask, "--shader", shader, "--pass-scale", "0.5"))
        whole = drawn(mask, "--shader", shader, "--pass-scale", "1")
        assert np.abs(half - whole).max() > 0.02
        small = drawn(str(folder / "low.png"), "--shader", shader, "--size", "256x256")
        assert np.abs(small - half).max() < 0.01
    given = ("--exposure", "0.1", "--decay", "0.97", "--density", "0.9", "--weight", "0.6")
    plain = drawn(mask, *given)
    np.testing.assert_array_equal(plain, drawn(mask, *given, "--pass-scale", "1"))


def test_a_fit_of_a_smaller_light_pass_renders_again(disc):
    """Whatever the shader's default, as fit.json has it, an older one without the scale as well."""
    mask, folder = str(disc.parent / "disc_mask.png"), disc.parent
    side_file = disc.with_suffix(".toml")
    side_file.write_text(side_file.read_text() + "pass_scale = 0.5\n")
    arguments = [*held(), "-q", "-o", str(folder / "out")]
    assert main(["fit", str(disc), *arguments]) == 3
    fitted = read_image(folder / "out" / "render.png").values
    record = json.loads((folder / "out" / "fit.json").read_text())
    assert (record["pass_scale"], record["pass_size"]) == (0.5, [128, 128])
    old = {key: value for key, value in record.items() if key != "pass_scale"}
    (folder / "out" / "old.json").write_text(json.dumps(old))
    for name in ("fit.json", "old.json"):
        params = ["--params", str(folder / "out" / name)]
        assert main(["render", mask, "-o", str(folder / "again.png"), *params]) == 0
        np.testing.assert_array_equal(read_image(folder / "again.png").values, fitted)


def test_render_within_a_tolerance(disc, capsys):
    mask, folder = disc.parent / "disc_mask.png", disc.parent
    arguments = ["render", str(mask), "--shader", "dawntime", "--light", "0.5,0.6"]
    arguments += ["--light", "0.1,0.2", "--exposure", "0.02"]
    assert main([*arguments, "-o", str(folder / "exact.npy"), "--tolerance", "0"]) == 0
    exact = read_image(folder / "exact.npy").values
    for levels in (0.3, 30):
        out = str(folder / "near.npy")
        assert main([*arguments, "-o", out, "--tolerance", str(levels)]) == 0
        assert np.abs(read_image(out).values - exact).max() <= levels / 255
    assert np.abs(read_image(out).values - exact).max() > 0
    for bad in ("-1", "nan", "inf", "few"):
        capsys.readouterr()
        assert main([*arguments, "-o", str(folder / "x.npy"), "--tolerance", bad]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    assert not (folder / "x.npy").exists()


def test_shaders_lists_every_convention(capsys):
    from godfit import CONVENTIONS

    assert main(["shaders"]) == 0
    printed = capsys.readouterr().out
    assert all(f"\n{name}\n" in printed for name in CONVENTIONS)
    assert "exposure 0.05, decay 0.99, density 0.8, weight 0.8, samples 200" in printed


def test_help_does_not_wait_for_jax():
    program = "import sys; from godfit.__main__ import main; main(['fit', '--help']);"
    program += "sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True).returncode == 0


@pytest.mark.parametrize(("asked", "had"), [(None, "cpu"), ("cuda,cpu", "cuda,cpu")])
def test_commands_run_on_the_cpu_unless_asked_otherwise(asked, had, monkeypatch):
    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    if asked:
        monkeypatch.setenv("JAX_PLATFORMS", asked)
    program = "import os, godfit.__main__ as it; "
    program += "it.main = lambda: print(os.environ['JAX_PLATFORMS']) or 0; it.run()"
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (ran.returncode, ran.stdout.strip()) == (0, had)


def test_a_fit_does_not_wait_for_what_it_does_not_use():
    program = "import sys, godfit.fitting; "
    program += "sys.exit(bool({'scipy.stats', 'matplotlib', 'trimesh'} & {*sys.modules}))"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True).returncode == 0


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("missing.png", None, "No such file"),
        ("empty.png", b"", "empty.png"),
        ("text.png", b"hello, I am a text file", "expected PNG"),
        ("cut.png", "cut", "cut short"),
    ],
)
def test_unreadable_targets(disc, capsys, name, content, words):
    path = disc.parent / name
    if content == "cut":
        content = disc.read_bytes()[:3000]
    if content is not None:
        path.write_bytes(content)
    before = leftovers(disc.parent)
    line = fails(capsys, 1, "fit", path, "--mask", disc.parent / "disc_mask.png")
    assert words in line
    assert name in line
    assert leftovers(disc.parent) == before


def test_a_folder_is_no_target(disc, capsys):
    assert "directory" in fails(capsys, 1, "fit", disc.parent, "--mask", disc)


def test_nan_is_refused(disc, capsys):
    np.save(disc.parent / "nan.npy", np.full((8, 8), np.nan, np.float32))
    line = fails(capsys, 1, "fit", disc.parent / "nan.npy", "--mask", disc)
    assert "NaN or infinity" in line


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["--samples", "abc"], 2, "not a valid integer"),
        (["--samples", "-1"], 1, "samples: expected a whole number"),
        (["--sampels", "3"], 2, "did you mean --samples"),
        (["--shader", "dawntimes"], 1, "did you mean 'dawntime'"),
        (["--fix", "expsure=1"], 1, "did you mean 'exposure'"),
        (["--fix", "exposure=bright"], 2, "expected NAME=VALUE"),
        (["--start", "density=2.5"], 1, "expected density from 0 to 2"),
        (["--start", "density"], 2, "expected NAME=VALUE"),
        (["--ignore", "1,2,3"], 1, "1,2,3"),
        (["--ignore", "0,0,256,256"], 1, "ignore less"),
        (["--pass-scale", "2"], 1, "pass scale: expected"),
        (["--transfer", "gamma"], 2, "gamma"),
        (["-o", "FILE"], 1, "expected a folder"),
    ],
)
def test_bad_options(disc, capsys, arguments, status, words):
    arguments = [str(disc) if a == "FILE" else a for a in arguments]
    before = leftovers(disc.parent)
    assert words in fails(capsys, status, "fit", disc, *arguments)
    assert leftovers(disc.parent) == before


def test_long_work_says_what_it_does(capsys, monkeypatch):
    """Without a terminal, a stage that lasts is a line; one that is over is none."""
    monkeypatch.setattr(progress, "QUIET_SECONDS", 0.05)
    with progress.Progress(quiet=False, verbose=False) as say:
        say(progress.LOADING)
        time.sleep(0.2)
        say("over at once")
        say("all pixels")
        time.sleep(0.2)
    assert capsys.readouterr().err == "godfit: all pixels\n"
    with progress.Progress(quiet=True, verbose=False) as say:
        say("all pixels")
        time.sleep(0.2)
    assert capsys.readouterr().err == ""


def test_compare_needs_a_mask(disc, capsys):
    (disc.parent / "disc.toml").unlink()
    assert "expected --mask IMAGE" in fails(capsys, 2, "compare", disc)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--model", "hoffman-preetham"], "expected --mask or --scene"),
        (["--background", "SMALL"], "background: expected the target's 256x256 pixels, got 16x16"),
        (["--occluder", "SMALL"], "expected the target's 256x256 pixels, got 16x16"),
        (["--ignore", "0,0,256,255"], "expected some open background"),
    ],
)
def test_what_a_fit_without_a_mask_does_not_do(disc, capsys, arguments, words):
    (disc.parent / "disc.toml").unlink()
    write_image(disc.parent / "small.png", np.ones((16, 16), np.float32))
    files = {"FILE": str(disc), "SMALL": str(disc.parent / "small.png")}
    arguments = [files.get(a, a) for a in arguments]
    before = leftovers(disc.parent)
    assert words in fails(capsys, 1, "fit", disc, *arguments)
    assert leftovers(disc.parent) == before


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["FILE", "--canvas", "FILE"], 2, "--canvas: expected one picture"),
        (["FILE", "--profile", "density"], 2, "--profile: expected one picture"),
        (["FILE", "--light-px", "1,2"], 2, "--light-px: expected one picture"),
        (["FILE", "--every", "0"], 2, "--every"),
        (["--every", "2"], 2, "--every: expected several frames or a video"),
        (["none.png"], 1, "'none.png': expected an image or a video"),
    ],
)
def test_what_several_frames_do_not_do(disc, capsys, arguments, status, words):
    arguments = [str(disc) if a == "FILE" else a for a in arguments]
    before = leftovers(disc.parent)
    assert words in fails(capsys, status, "fit", disc, *arguments)
    assert leftovers(disc.parent) == before


@pytest.mark.parametrize("asked", [["--profile", "decay"], ["--posterior"]])
def test_intervals_of_a_picture_that_comes_with_nothing_are_refused_at_once(disc, capsys, asked):
    disc.with_suffix(".toml").unlink()
    line = fails(capsys, 2, "fit", disc, *asked)
    assert f"{' '.join(asked)}: expected --mask, --scene or --canvas with it, got none" in line


def test_mask_of_a_scene_or_of_a_picture(disc, capsys):
    assert "got neither" in fails(capsys, 2, "mask", "-o", disc)
    assert "got both" in fails(capsys, 2, "mask", disc, "--from-image", disc, "-o", disc)


def test_mask_of_another_aspect(disc, capsys):
    write_image(disc.parent / "wide.png", np.ones((64, 128), np.float32))
    line = fails(capsys, 1, "fit", disc, "--mask", disc.parent / "wide.png")
    assert "aspect 256:256, got 128:64" in line


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("mask = 3", "mask: expected text"),
        ("mask = 'a.png'\nmaks = 'b.png'", "maks: expected one of mask"),
        ("[scattering]\nsamples = 'many'", "scattering.samples: expected a whole number"),
        ("[scattering]\nshadr = 'x'", "scattering.shadr: expected one of"),
        ("scattering = 1", "expected a table"),
        ("mask = ", "expected TOML"),
    ],
)
def test_side_file_errors_name_file_and_key(disc, capsys, text, words):
    (disc.parent / "disc.toml").write_text(text)
    line = fails(capsys, 1, "fit", disc)
    assert words in line
    assert "disc.toml" in line


def test_options_override_the_side_file(disc, capsys, monkeypatch):
    """Those that are given, and no other."""
    given = {}

    def fit(target, **options):
        given.update(options)
        raise InputError("stopped")

    monkeypatch.setattr("godfit.fitting.fit", fit)
    beside = read_sidecar(str(disc))
    assert (beside["shader"], beside["samples"]) == ("dawntime", 100)
    assert "stopped" in fails(capsys, 1, "fit", disc, "--shader", "vesper")
    assert (given["shader"], given["samples"]) == ("vesper", 100)
    assert Path(given["mask"]) == disc.parent / "disc_mask.png"


WAYS = (
    ["--light", "0.5625,0.75"],
    ["--light-px", "144,64"],
    ["--light-origin", "top", "--light", "0.5625,0.25"],
)
"""One place in a picture of 256x256 pixels: v up, in pixels, and v down as in HLSL."""


def test_pixels_and_v_from_the_top_render_the_same_picture(disc):
    mask, out = disc.parent / "disc_mask.png", disc.parent / "out.npy"
    arguments = ["render", str(mask), "-o", str(out), "--shader", "article-hlsl"]
    pictures = []
    for way in (*WAYS, ["--light-px", "143,64"]):
        assert main([*arguments, *way]) == 0
        pictures.append(read_image(out).values)
    assert np.array_equal(pictures[0], pictures[1])
    assert np.array_equal(pictures[0], pictures[2])
    assert not np.array_equal(pictures[0], pictures[3])


def test_pixels_are_those_of_the_picture(disc):
    """Not the mask's, where these differ; a repeated option gives several lights."""
    mask, out = disc.parent / "disc_mask.png", disc.parent / "out.npy"
    arguments = ["render", str(mask), "-o", str(out), "--shader", "dawntime", "--size", "128x64"]
    pictures = []
    for way in (
        ["--light", "0.5625,0.75", "--light", "0.25,-0.5"],
        ["--light-px", "72,16", "--light-px", "32,96"],
    ):
        assert main([*arguments, *way]) == 0
        pictures.append(read_image(out).values)
    assert np.array_equal(*pictures)


@pytest.mark.parametrize("way", WAYS)
def test_a_light_starts_a_fit_and_is_held_by_select(disc, capsys, monkeypatch, way):
    given = {}

    def study(target, **options):
        given.update(options)
        raise InputError("stopped")

    monkeypatch.setattr("godfit.fitting.fit", study)
    monkeypatch.setattr("godfit.studies.select.select", study)
    assert "stopped" in fails(capsys, 1, "fit", disc, *way)
    assert given["start"] == {"light_x": 0.5625, "light_y": 0.75}
    assert given["lights"] == 1
    assert "stopped" in fails(capsys, 1, "fit", disc, *way, *way, "--start", "decay=.9")
    assert given["start"]["light2_y"] == 0.75
    assert given["start"]["decay"] == 0.9
    assert given["lights"] == 2
    assert "stopped" in fails(capsys, 1, "fit", disc, *way, "--lights", "3")
    assert given["lights"] == 3
    assert "stopped" in fails(capsys, 1, "select", disc, *way)
    assert given["light"] == (0.5625, 0.75)


@pytest.mark.parametrize(
    ("command", "arguments", "words"),
    [
        ("fit", ["--light", "1,2", "--light-px", "1,2"], "got both; give one"),
        ("fit", ["--light-origin", "top"], "--light-origin: expected --light U,V with it"),
        ("fit", ["--light-px", "1"], "expected X,Y, got '1'"),
        ("fit", ["--light-near", "1"], "expected U,V, got '1'"),
        ("fit", ["--light-near", "1,inf"], "expected two finite numbers U,V, got '1,inf'"),
        ("fit", ["--light", "nan,1"], "expected two finite numbers U,V"),
        ("fit", ["--light", "1,2", "--start", "light_y=1"], "expected no --start light_y with it"),
        ("fit", ["--light", "1,2", "--free", "light.position"], "expected no --free with it"),
        ("fit", ["--light", "1,2", "--light", "3,4", "--lights", "1"], "--light: expected at most"),
        ("select", ["--light-px", "1,2", "--light-px", "3,4"], "--light-px: expected one light"),
    ],
)
def test_bad_lights(disc, capsys, command, arguments, words):
    assert words in fails(capsys, 2, command, disc, *arguments)


def test_a_full_disk_leaves_no_half_file(disc, capsys, monkeypatch):
    """The write fails as it would with no room left: one line, the old result whole."""
    folder = disc.with_suffix(".godfit")
    folder.mkdir()
    (folder / "fit.json").write_text("{}")

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    assert main(["fit", str(disc), "-q"]) == 1
    shown = capsys.readouterr()
    assert "No space left" in shown.err
    # The numbers of a fit are not lost with its file.
    assert "density" in shown.out
    assert leftovers(folder) == ["fit.json"]
    assert (folder / "fit.json").read_text() == "{}"


def test_a_fit_is_not_lost_with_its_figure(disc, capsys, monkeypatch):
    def fails(*_):
        raise RuntimeError("latex could not be found")

    monkeypatch.setattr("godfit.report.result.sheet_of", fails)
    assert main(["fit", str(disc)]) == 0
    shown = capsys.readouterr()
    assert "warning: fit.png was not written: RuntimeError: latex could not be found" in shown.err
    assert shown.out.rstrip().endswith("fit.json, render.png, report.html")
    assert leftovers(disc.with_suffix(".godfit")) == ["fit.json", "render.png", "report.html"]


def test_interrupt_ends_with_130_and_no_file(disc):
    with subprocess.Popen(
        [sys.executable, "-m", "godfit", "fit", str(disc), "-v"],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    ) as run:
        assert run.stderr is not None
        for line in run.stderr:
            if "screening" in line:
                break
        # At once: from the cache, a fit ends within half a second of this.
        run.send_signal(signal.SIGINT)
        rest = run.stderr.read()
        assert run.wait(60) == 130
    assert "interrupted" in rest
    assert "Traceback" not in rest
    assert not disc.with_suffix(".godfit").exists()


def test_not_converged_is_3_and_writes_all_the_same(disc, capsys):
    assert main(["fit", str(disc), *held(density=0.3), "-q"]) == 3
    assert "not converged" in capsys.readouterr().out
    record = json.loads((disc.with_suffix(".godfit") / "fit.json").read_text())
    assert record["converged"] is False
    assert record["params"]["density"] == {
        "value": pytest.approx(0.3),
        "stderr": None,
        "fixed": True,
        "at_bound": False,
    }


@pytest.mark.parametrize(
    ("value", "stderr", "text"),
    [
        (0.05, 1e-5, "0.050000"),
        (0.123456789, 1e-3, "0.1235"),
        (1.0, None, "1"),
        (0.0, 1e-3, "0"),
        (-0.12, 2e-6, "-0.1200000"),
    ],
)
def test_values_have_the_digits_of_their_errors(value, stderr, text):
    assert number(value, stderr) == text


SCENE = """
[image]
width = 96
height = 64
[camera]
position = [0.5, 1, 6]
[light]
position = [0.6, 0.4, -3]
radius = 1.2
[background]
colour = "#222222"
[[object]]
primitive = "torus"
tube = 0.25
position = [0.2, 0.3, 0]
rotation = [20, 30, 10]
[scattering]
shader = "dawntime"
samples = 40
"""


@pytest.fixture
def torus(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("torus.toml").write_text(SCENE)
    return tmp_path


def test_mask_of_a_scene_hard_and_smooth(torus, capsys):
    assert main(["mask", "torus.toml", "-o", "smooth.png"]) == 0
    assert main(["mask", "torus.toml", "-o", "hard.png", "--hard"]) == 0
    smooth, hard = read_image("smooth.png").values, read_image("hard.png").values
    assert smooth.shape == hard.shape == (64, 96)
    assert set(np.unique(np.round(255 * hard))) == {0, 34, 255}
    assert len(np.unique(smooth)) > 20
    assert abs(smooth.mean() - hard.mean()) < 0.005
    assert capsys.readouterr() == ("", "")


def test_a_scene_is_rendered_and_fitted(torus, capsys):
    # As large as the pictures of other tests, whose programs its fit shares.
    Path("torus.toml").write_text(SCENE.replace("height = 64", "height = 96"))
    arguments = ["render", "torus.toml", "-o", "frame.png", "--exposure", "0.1"]
    assert main([*arguments, "--pass-scale", "1"]) == 0
    assert main(["fit", "frame.png", "--scene", "torus.toml", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["shader"], found["samples"]) == ("dawntime", 40)
    assert (found["pass_scale"], found["pass_size"], found["notes"]) == (1, [96, 96], [])
    assert found["params"]["exposure"]["value"] == pytest.approx(0.1, rel=0.05)
    assert found["params"]["density"]["value"] == pytest.approx(0.8, abs=5e-3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("tube = 0.25", "tubes = 0.25"), "object[0].tubes: expected one of"),
        (("radius = 1.2", "radius = 0"), "light.radius: expected a finite number above 0"),
        (("[0.6, 0.4, -3]", "[0.6, 0.4, 9]"), "light.position: expected it before the camera"),
        (('primitive = "torus"', 'mesh = "no.obj"'), "expected a mesh, got no such file"),
        (("width = 96", "width = 0"), "image.width: expected a whole number from 1"),
    ],
)
def test_bad_scenes_end_in_one_line(torus, capsys, change, words):
    text = SCENE.replace("tube = 0.25\n", "") if "mesh" in change[1] else SCENE
    Path("torus.toml").write_text(text.replace(*change))
    assert main(["mask", "torus.toml", "-o", "mask.png"]) == 1
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not Path("mask.png").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--mask", "m.png", "--scene", "torus.toml"], "got both"),
        (["--mask", "m.png", "--free", "light.position"], "expected --scene"),
        (["--scene", "torus.toml", "--free", "light.size"], "did you mean"),
        (["--scene", "none.toml"], "no such file"),
    ],
)
def test_bad_scene_options(torus, capsys, arguments, words):
    write_image("frame.png", np.zeros((64, 96)))
    write_image("m.png", np.zeros((64, 96)))
    assert main(["fit", "frame.png", *arguments]) in (1, 2)
    error = capsys.readouterr().err
    assert words in error
    assert not Path("frame.godfit").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["m.png"], "expected a SCENE.toml with it, got a mask"),
        (["torus.toml", "--background", "m.png"], "expected no --background with it"),
        (["torus.toml", "--model", "volume"], "expected --model mitchell with it, got volume"),
    ],
)
def test_what_cannot_be_blended_with_an_ordinary_pass(torus, capsys, arguments, words):
    write_image("m.png", np.zeros((64, 96)))
    assert words in fails(capsys, 2, "render", *arguments, "--composite", "-o", "a.png")
    assert not Path("a.png").exists()


def test_the_ordinary_pass_is_as_large_as_the_picture(torus, capsys):
    Path("torus.toml").write_text(SCENE + "[ordinary]\ncolour = '#000040'\n")
    arguments = ["render", "torus.toml", "--composite", "--size", "192x128"]
    assert main([*arguments, "-o", "a.png", "--exposure", "0"]) == 0
    ordinary = np.round(read_image("a.png").values * 255)
    assert ordinary.shape == (128, 192, 3)
    assert ordinary[0, 0].tolist() == [0, 0, 64]
    assert main([*arguments, "-o", "b.png", "--exposure", "0.01"]) == 0
    assert (np.round(read_image("b.png").values * 255) - ordinary).mean() > 5

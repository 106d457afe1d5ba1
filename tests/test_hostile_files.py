"""Damaged and hostile files, command lines and folders end in one line."""

import os
import resource
import signal
import subprocess
import sys

import numpy as np
import pytest

from godfit.__main__ import main
from godfit.errors import LONGEST_SHOWN, InputError, plain
from godfit.io.image import MAX_PIXELS, limit_pixels, read_image
from godfit.io.sources import read_source
from godfit.runtime import memory
from godfit.runtime.checked_files import write_checked
from godfit.runtime.files import atomic_write, forget_written, remove_temporaries, written_files
from tests.support import hostile_files

SEEDS = range(1000, 1200)
"""Not those of experiments/stability/fuzz.py, which tries 3,000."""


@pytest.fixture(scope="module")
def files():
    return hostile_files.valid_files()


@pytest.fixture
def folder(files, tmp_path):
    """Where every file finds those that it names."""
    (tmp_path / "mask.png").write_bytes(files["grey.png"])
    (tmp_path / "part.obj").write_bytes(files["part.obj"])
    return tmp_path


def test_valid_files_are_read(files, folder):
    for name, data in files.items():
        (folder / name).write_bytes(data)
        assert (name, hostile_files.attempt(folder / name)) == (name, "read")


def test_mutated_files_are_read_or_refused(files, folder):
    wrong = []
    for seed in SEEDS:
        path = hostile_files.write_hostile(folder, files, seed)
        outcome = hostile_files.attempt(path)
        if outcome not in ("read", "refused"):
            wrong.append((seed, path.name, outcome))
        (folder / "part.obj").write_bytes(files["part.obj"])
    assert wrong == []


def test_messages_are_one_plain_line():
    assert plain("a\x1b[31mb\x07\nc \u202e\udcff") == "a\\x1b[31mb\\x07 c \\u202e\\udcff"
    long = str(InputError(f"'{'x' * 5000}': expected less"))
    assert len(long) < LONGEST_SHOWN + 30
    assert long.endswith("... expected less")


def test_devices_and_pipes_are_not_opened(folder):
    os.mkfifo(folder / "pipe.png")
    for name in ("/dev/zero", str(folder / "pipe.png")):
        with pytest.raises(InputError, match="device or a pipe"):
            read_image(name)


def test_a_limit_of_pixels_is_said_and_can_be_raised(folder, capsys):
    assert main(["render", str(folder / "mask.png"), "-o", str(folder / "a.png"),
                 "--shader", "dawntime", "--max-pixels", "100"]) == 1  # fmt: skip
    assert "--max-pixels raises the limit" in capsys.readouterr().err
    # The next command has the usual limit again.
    try:
        limit_pixels(MAX_PIXELS)
        assert read_image(folder / "mask.png").values.shape == (12, 12)
    finally:
        limit_pixels()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["fit", ""], "empty text"),
        (["fit", "mask.png", "-o", ""], "-o"),
        (["fit", "mask.png", "--model", ""], "--model: expected a value"),
        (["fit", "mask.png", "--seed", "-1"], "--seed"),
        (["fit", "mask.png", "--seed", "9" * 30], "--seed"),
        (["fit", "mask.png", "--ignore=--1,0,5,5"], "--ignore"),
        (["fit", "mask.png", "--ignore=²,0,5,5"], "--ignore"),
        (["render", "mask.png", "-o", "a.png", "--size", "²x3"], "--size"),
        (["render", "mask.png", "-o", "nowhere/a.png"], "no folder 'nowhere'"),
        (["mask", "a.toml", "-o", "a.gif"], ".png or .npy"),
        (["render", "mask.png", "-o", "a.png", "--shader", "dawntime", "--size",
          "99999999x99999999"], "out of memory: needs about"),
    ],
)  # fmt: skip
def test_hostile_command_lines(arguments, words, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    before = sorted(folder.iterdir())
    assert main(arguments) in (1, 2)
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert sorted(folder.iterdir()) == before


def test_huge_values_are_refused(folder):
    np.save(folder / "huge.npy", np.full((4, 4), 1e30, np.float32))
    with pytest.raises(InputError, match="at most 1e"):
        read_source(folder / "huge.npy", "none")


def test_an_image_is_compared_with_memory_before_it_is_decoded(folder, monkeypatch):
    monkeypatch.setattr(memory, "available_memory", lambda: 100)
    with pytest.raises(InputError, match=r"out of memory: needs about .* GiB, has"):
        read_image(folder / "mask.png")


def test_memory_under_a_limit_of_address_space():
    """A process of its own: a limit cannot be raised again."""
    program = (
        "import resource; from godfit.runtime.memory import available_memory as a;"
        "resource.setrlimit(resource.RLIMIT_AS, (1 << 31, 1 << 31)); print(a())"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert 0 < int(ran.stdout) < 1 << 31
    assert resource.getrlimit(resource.RLIMIT_AS)[0] != 1 << 31


def test_a_file_in_the_current_folder_is_not_run(tmp_path):
    """``python -m`` puts that folder on the path."""
    for name in ("click", "typing", "signal", "numpy"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('ran')")
    ran = subprocess.run(
        [sys.executable, "-m", "godfit", "--help"],
        cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip
    assert (ran.returncode, ran.stderr) == (0, "")


@pytest.mark.parametrize("ignored", [False, True])
def test_an_interrupt_of_the_start(ignored, tmp_path):
    """One line and 130, while modules are imported; nothing where the parent ignores it."""
    ignore = "trap '' INT; " if ignored else ""
    command = f"{ignore}exec {sys.executable} -X importtime -m godfit fit missing.png"
    with subprocess.Popen(
        ["sh", "-c", command], cwd=tmp_path, stderr=subprocess.PIPE, text=True
    ) as run:
        assert run.stderr is not None
        # The handler is set before this is imported.
        for line in run.stderr:
            if line.rstrip().endswith("difflib"):
                break
        run.send_signal(signal.SIGINT)
        said = [line for line in run.stderr.read().splitlines() if "import time" not in line]
        status = run.wait(60)
    expected = (1, "'missing.png': cannot be read") if ignored else (130, "interrupted; nothing")
    assert status == expected[0]
    assert len(said) == 1
    assert expected[1] in said[0]


def test_what_was_written_is_said(tmp_path, monkeypatch):
    forget_written()
    assert written_files() == "nothing was written"
    write_checked(tmp_path / "program", b"of the cache")
    assert written_files() == "nothing was written"
    atomic_write(tmp_path / "fit.json", b"{}")
    assert written_files() == f"written: {tmp_path / 'fit.json'}"
    # An interrupt while another thread writes: its temporary file goes, and is not named.
    cut, rename = [], os.replace

    def interrupted(temporary, name):
        remove_temporaries()
        cut.append(os.path.exists(temporary))
        rename(temporary, name)

    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(FileNotFoundError):
        atomic_write(tmp_path / "fit.png", b"")
    assert cut == [False]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fit.json", "program"]
    assert "fit.png" not in written_files()

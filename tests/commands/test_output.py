"""What a command prints and where its files go, when either is not as usual."""

import json
import subprocess
import sys

import pytest

from godfit.commands.streams import Output
from godfit.commands.study import folder_for
from godfit.errors import InputError


def printed(redirection: str) -> tuple[int, str]:
    """The status of ``godfit shaders``, run by a shell with its output redirected, and stderr."""
    command = f'"{sys.executable}" -m godfit shaders {redirection}'
    done = subprocess.run(["bash", "-c", command], capture_output=True)
    return done.returncode, done.stderr.decode()


@pytest.mark.parametrize(
    ("redirection", "status", "words"),
    [
        (">&-", 0, ""),
        (">&- 2>&-", 0, ""),
        ("| head -c 1; exit ${PIPESTATUS[0]}", 0, ""),
        ("> /dev/full", 1, "stdout: No space left on device; the printed result is not whole"),
    ],
)
def test_an_output_that_is_closed_or_full_raises_nothing(redirection, status, words):
    got, said = printed(redirection)
    assert got == status
    assert said == (f"godfit: error: {words}\n" if words else "")


def test_names_that_are_not_utf8_are_printed_with_their_bytes_escaped(tmp_path):
    with (tmp_path / "a").open("wb", 0) as file:
        output = Output(file, encoding="utf-8", errors="backslashreplace")
        output.write("± caf\udce9.png")
        output.flush()
        output.detach()
    assert (tmp_path / "a").read_bytes() == "± caf\\udce9.png".encode()


def fit_record(path: str) -> dict:
    return {"inputs": {"target": {"path": path}}}


@pytest.mark.parametrize(
    ("targets", "name", "record", "held"),
    [
        (["a/frame.jpg"], "fit.json", fit_record("frame.png"), "frame.png"),
        (["a/frame.png"], "fit.json", fit_record("frame.png"), None),
        (["a/frame.jpg"], "select.json", {"fit": fit_record("frame.png")}, "frame.png"),
        (
            ["a/frame.jpg"],
            "compare.json",
            {"fits": [{"fit": fit_record("b/frame.png")}]},
            "b/frame",
        ),
        (["a/frame.jpg"], "fit.json", {"frames": [{"path": "frame_1.jpg"}]}, "frame_1.jpg"),
        (["a/frame_1.png", "a/frame_2.png"], "fit.json", fit_record("frame.png"), "frame.png"),
        (["frame_2.png", "frame_3.png"], "fit.json", {"frames": [{"path": "frame_1.png"}]}, None),
        (["frame_2.jpg", "f.jpg"], "fit.json", {"frames": [{"path": "frame_1.png"}]}, "frame_1"),
        (["frame.mp4"], "fit.json", {"frames": [{"path": "frame.mp4#1"}]}, None),
        (["frame.jpg"], "fit.json", ["no record"], None),
        (["frame.jpg"], "fit.json", fit_record(""), None),
    ],
)
def test_a_folder_of_another_target_is_not_overwritten(tmp_path, targets, name, record, held):
    folder = tmp_path / "frame.godfit"
    folder.mkdir()
    (folder / name).write_text(json.dumps(record))
    targets = [str(tmp_path / target.rpartition("/")[2]) for target in targets]
    if held is None:
        assert folder_for(targets, None) == folder
    else:
        with pytest.raises(InputError, match=f"already holds the result of '{held}"):
            folder_for(targets, None)
    assert folder_for(targets, str(folder)) == folder

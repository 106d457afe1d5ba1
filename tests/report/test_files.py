"""A result's folder: the record comes first, and no picture can lose it."""

import json
import threading

import matplotlib
import pytest

from godfit.errors import InputError
from godfit.report.files import PictureNotWritten, write_result
from godfit.report.sheet import Sheet
from godfit.report.style import own_style

# The byte E9 as the name of a file, which is no UTF-8.
RECORD = {"path": "caf\udce9.png", "unit": "±"}


def small() -> Sheet:
    return Sheet("a_b", True)


def broken(*_):
    raise RuntimeError("no\nfont")


def refused(*_):
    raise InputError("a.png: cannot be written: No space left")


def test_the_record_is_written_whatever_the_pictures_do(tmp_path):
    with pytest.warns(PictureNotWritten) as caught:
        write_result(tmp_path, ("a.json", RECORD), ("a.png", broken), {"b.png": refused})
    assert [str(w.message) for w in caught] == [
        "a.png was not written: RuntimeError: no font",
        "b.png was not written: a.png: cannot be written: No space left",
    ]
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8")) == RECORD
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_figures_do_not_depend_on_the_users_settings(tmp_path):
    write_result(tmp_path, ("a.json", {}), ("plain.png", small))
    settings = {"text.usetex": True, "font.size": 31, "savefig.dpi": 7, "figure.facecolor": "red"}
    with matplotlib.rc_context(settings):
        write_result(tmp_path, ("a.json", {}), ("theirs.png", small))
        assert {name: matplotlib.rcParams[name] for name in settings} == settings
    assert (tmp_path / "plain.png").read_bytes() == (tmp_path / "theirs.png").read_bytes()


def test_settings_are_the_users_again_after_two_threads():
    entered, leave = threading.Event(), threading.Event()
    inside = []

    def first():
        with own_style(), own_style():
            entered.set()
            leave.wait(10)
            inside.append(matplotlib.rcParams["font.size"])

    def second():
        entered.wait(10)
        leave.set()
        with own_style():
            inside.append(matplotlib.rcParams["font.size"])

    default = matplotlib.rcParamsDefault["font.size"]
    with matplotlib.rc_context({"font.size": 31}):
        threads = [threading.Thread(target=work) for work in (first, second)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert matplotlib.rcParams["font.size"] == 31
    assert inside == [default, default]

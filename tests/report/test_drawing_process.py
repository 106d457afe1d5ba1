"""The process that draws: its figure is the one that is drawn here, and where it fails that one is
taken."""

import signal
import sys

import numpy as np
import pytest

from godfit.report import drawing_process
from godfit.report.sheet import INK, Grid, Panel, PanelImage, Sheet, Words
from godfit.report.style import own_style

SHEET = Sheet(
    "a title",
    True,
    (
        Grid((Panel("one", PanelImage(np.eye(5), np.array([[0.5, 0.5], [2.0, 0.5]]))),), 1.0),
        Words((("words", INK),)),
    ),
)


@pytest.fixture
def here():
    with own_style():
        return SHEET.png()


@pytest.fixture
def two_cores(monkeypatch):
    """As in a command, which has not imported matplotlib."""
    monkeypatch.setattr(drawing_process, "cores", lambda: 2)
    monkeypatch.delitem(sys.modules, "matplotlib.figure", raising=False)


def test_the_same_figure(here, two_cores):
    drawing_process.start()
    assert drawing_process.is_running()
    assert drawing_process.png(SHEET) == here
    assert not drawing_process.is_running()
    assert drawing_process.png(SHEET) == here


def test_a_process_that_ends_is_replaced(here, two_cores):
    drawing_process.start()
    process = drawing_process._process
    assert process is not None
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert drawing_process.png(SHEET) == here


def test_what_cannot_be_sent_is_drawn_here(two_cores):
    drawing_process.start()
    drawn = drawing_process.png(
        Sheet("t", True, (Grid((Panel("one", lambda axes: axes.plot([0, 1], [0, 1])),), 1.0),))
    )
    assert drawn.startswith(b"\x89PNG")


def test_one_core_has_no_process(monkeypatch):
    monkeypatch.setattr(drawing_process, "cores", lambda: 1)
    drawing_process.start()
    assert not drawing_process.is_running()

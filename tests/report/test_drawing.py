"""A companion draws a sheet as the command itself would, and loads no more for it than it needs."""

import pickle
import subprocess
import sys

import pytest

from godfit.report import drawing
from godfit.report.figure import sheet_of
from godfit.runtime.one_core import cores
from tests.support.shown_results import fit_result

WITHOUT_JAX = """
import pickle, sys
from godfit.report.drawing import _png_for
content = _png_for(sys.stdin.buffer.read)
assert not {"jax", "numba", "scipy"} & set(sys.modules)
sys.stdout.buffer.write(content)
"""


def test_a_companion_draws_the_same_without_jax():
    sheet = sheet_of(fit_result((36, 64)))
    ran = subprocess.run(
        [sys.executable, "-c", WITHOUT_JAX], input=pickle.dumps(sheet), capture_output=True
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout == drawing._drawn(sheet)


@pytest.mark.skipif(cores() < 2, reason="no core for a companion")
def test_one_that_fails_or_cannot_start_is_done_without(monkeypatch):
    sheet = sheet_of(fit_result((36, 64)))
    with monkeypatch.context() as patch:
        patch.delitem(sys.modules, "matplotlib")
        assert drawing.draw_ahead()
        (companion,) = drawing._companions
        # One waits already.
        assert drawing.draw_ahead()
    assert drawing._companions == [companion]
    companion.process.kill()
    companion.process.wait()
    assert drawing.png_of(sheet) == drawing._drawn(sheet)
    assert drawing._companions == []
    # What loads matplotlib anyway needs none.
    assert not drawing.draw_ahead()

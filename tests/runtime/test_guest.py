"""A program that uses the package finds its own settings as they were."""

import json
import os
import subprocess
import sys
import threading
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from godfit.io.image import write_image
from godfit.models.mitchell import Mitchell
from godfit.runtime.guest import own_settings
from godfit.runtime.host_state import warnings_kept
from tests.support.paths import ROOT

SCENE = """
[image]
width = 96
height = 96
[camera]
position = [0, 0, 4]
[light]
position = [0, 0, -3]
radius = 1
[[object]]
primitive = "box"
"""


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    folder = tmp_path_factory.mktemp("host")
    # The size of most fits in the tests, whose stored programs serve.
    y, x = np.mgrid[:96, :96] / 96
    mask = ((x - 0.5) ** 2 + (y - 0.4) ** 2 < 0.04).astype(np.float32)
    model = Mitchell(0.3, 0.9, 0.9, 0.5, light=(0.5, 0.5), shader="dawntime", samples=8)
    write_image(folder / "mask.png", mask)
    write_image(folder / "target.png", np.asarray(model(jnp.asarray(mask, jnp.float32))))
    (folder / "scene.toml").write_text(SCENE)
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    run = subprocess.run(
        [sys.executable, "-m", "tests.support.host_program", str(folder)],
        cwd=ROOT, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout.splitlines()[-1])


def test_nothing_is_changed_alone_and_from_threads(said):
    assert said["alone"] == []
    assert said["threads"] == []
    assert said["of_threads"] == pytest.approx([said["value"]] * 2, rel=1e-6)
    assert said["value"] == pytest.approx(0.3, rel=0.02)


def test_strict_settings_of_the_host_neither_break_nor_change_a_fit(said):
    assert said["strict"] == []
    assert said["strict_value"] == pytest.approx(said["value"], rel=1e-6)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_forked_child_is_refused_by_name(said):
    assert said["forked"].startswith("InputError: ")
    assert "spawn" in said["forked"]


def test_settings_are_of_one_thread():
    with own_settings():
        assert jnp.zeros(1).dtype == np.float32
        seen = []
        thread = threading.Thread(target=lambda: seen.append(jax.config.jax_enable_x64))
        thread.start()
        thread.join()
    assert seen == [True]
    assert jax.config.jax_enable_x64


def test_filters_of_warnings_are_restored_where_two_threads_mix_them_up():
    before = warnings.filters, list(warnings.filters)
    entered, left = threading.Event(), threading.Event()

    def first():
        with warnings_kept(), warnings.catch_warnings():
            entered.set()
            left.wait(10)

    def second():
        entered.wait(10)
        with warnings_kept():
            caught = warnings.catch_warnings()
            caught.__enter__()
            warnings.simplefilter("ignore")
            left.set()
            threads[0].join()
            # Restores the first thread's copy.
            caught.__exit__(None, None, None)
            assert warnings.filters is not before[0]

    threads = [threading.Thread(target=work) for work in (first, second)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert warnings.filters is before[0]
    assert list(warnings.filters) == before[1]

"""Where compiled programs are kept, and that it does no harm."""

import os
import subprocess
import sys

import pytest

from godfit.runtime.cache import cache_folder

SUM = """
from godfit.runtime.cache import enable_jax_cache
enable_jax_cache()
import jax, jax.numpy as jnp
from godfit.scattering.radial import radial_sum
from godfit.scattering.taps import Taps
mask = jnp.linspace(0, 1, 40 * 50).reshape(40, 50)
total = jax.jit(lambda m: radial_sum(m, jnp.array([0.3, 0.6]), Taps(0.2, 0.1, 0.9, 0.04, 20)))
print(total(mask).sum())
"""


def summing(**environment: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-W", "error", "-c", SUM],
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def outcome(process: subprocess.Popen) -> str:
    out, err = process.communicate(timeout=120)
    assert (process.returncode, err) == (0, "")
    return out


def test_folder_is_the_users_and_can_be_switched_off(monkeypatch, tmp_path):
    monkeypatch.setenv("GODFIT_CACHE", "off")
    assert cache_folder() is None
    monkeypatch.setenv("GODFIT_CACHE", str(tmp_path))
    assert cache_folder() == tmp_path
    monkeypatch.delenv("GODFIT_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "godfit"


def test_two_processes_may_start_at_once(tmp_path):
    """Both fill the same empty folder; a third reads what they left."""
    cache = {"GODFIT_CACHE": str(tmp_path)}
    both = [summing(**cache), summing(**cache)]
    first, second = (outcome(process) for process in both)
    assert first == second == outcome(summing(**cache))
    assert any(tmp_path.glob("numba-*/**/*.nbi"))
    assert any(tmp_path.glob("jit_*"))


@pytest.mark.parametrize("kind", ["off", "file"])
def test_without_a_folder_nothing_is_kept(kind, tmp_path):
    place = tmp_path / "taken"
    place.write_text("")
    assert float(outcome(summing(GODFIT_CACHE="off" if kind == "off" else str(place)))) > 0
    assert place.read_text() == ""
    assert list(tmp_path.iterdir()) == [place]

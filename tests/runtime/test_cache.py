"""Where compiled programs are kept, and that it does no harm."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

from godfit.runtime import cache
from godfit.runtime.cache import cache_folder, version_folder
from godfit.runtime.checked_files import read_checked, write_checked

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


class Touch:
    """Makes a file where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


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
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "new"))
    assert cache_folder() == tmp_path / "new" / "godfit"
    assert (tmp_path / "new" / "godfit").stat().st_mode & 0o777 == 0o700
    # Made by an earlier version, with the umask.
    (tmp_path / "new" / "godfit").chmod(0o755)
    assert cache_folder() == tmp_path / "new" / "godfit"
    assert (tmp_path / "new" / "godfit").stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("variable", ["GODFIT_CACHE", "XDG_CACHE_HOME"])
def test_a_folder_that_others_write_is_left_alone_with_one_warning(variable, monkeypatch, tmp_path):
    monkeypatch.delenv("GODFIT_CACHE")
    monkeypatch.setenv(variable, str(tmp_path))
    folder = tmp_path if variable == "GODFIT_CACHE" else tmp_path / "godfit"
    folder.mkdir(exist_ok=True)
    folder.chmod(0o777)
    with pytest.warns(RuntimeWarning, match="chmod 700") as warned:
        assert cache_folder() is None
    assert cache_folder() is None
    assert len(warned) == 1
    assert folder.stat().st_mode & 0o777 == 0o777


def test_another_users_folder_is_left_alone(monkeypatch, tmp_path):
    monkeypatch.setenv("GODFIT_CACHE", str(tmp_path))
    monkeypatch.setattr(os, "geteuid", lambda: tmp_path.stat().st_uid + 1)
    with pytest.warns(RuntimeWarning, match="another user's"):
        assert cache_folder() is None


def test_relative_paths_name_no_folder(monkeypatch, tmp_path):
    """A folder of pictures may have a cache in it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cache").mkdir(0o700)
    monkeypatch.setenv("GODFIT_CACHE", "cache")
    with pytest.warns(RuntimeWarning, match="absolute"):
        assert cache_folder() is None
    monkeypatch.delenv("GODFIT_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", "cache")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache_folder() == tmp_path / "home" / ".cache" / "godfit"
    assert list((tmp_path / "cache").iterdir()) == []


def test_folders_of_old_versions_are_removed(monkeypatch, tmp_path):
    monkeypatch.setenv("GODFIT_CACHE", str(tmp_path))
    for name in ("numba-12ab", "programs-12ab-34cd", "jax-12ab", "mine", "jit_f0-12-cache"):
        (tmp_path / name).mkdir()
    monkeypatch.setattr(cache, "newest_source_time", lambda: 0xFFF)
    assert version_folder("jax") == tmp_path / "jax-fff"
    version_folder("programs", "34cd")
    assert {path.name for path in tmp_path.iterdir()} == {"mine", "jax-fff", "programs-fff-34cd"}


def test_every_damage_to_a_file_is_found(tmp_path):
    file = tmp_path / "file"
    write_checked(file, b"some machine code")
    whole = file.read_bytes()
    assert read_checked(file) == b"some machine code"
    damaged = [whole[:n] for n in range(len(whole))]
    for i in range(len(whole)):
        flipped = bytearray(whole)
        flipped[i] ^= 1 << i % 8
        damaged.append(bytes(flipped))
    for data in (*damaged, whole + b"0", pickle.dumps(1)):
        file.write_bytes(data)
        assert read_checked(file) is None
        # It makes room for another.
        assert not file.exists()
    (tmp_path / "other").write_bytes(whole)
    assert read_checked(tmp_path / "other") is None


def test_two_processes_may_start_at_once(tmp_path):
    """Both fill the same empty folder; a third reads what they left."""
    cache = {"GODFIT_CACHE": str(tmp_path)}
    both = [summing(**cache), summing(**cache)]
    first, second = (outcome(process) for process in both)
    assert first == second == outcome(summing(**cache))
    (numba,) = tmp_path.glob("numba-*")
    (jax,) = tmp_path.glob("jax-*")
    (machine,) = tmp_path.glob("machine-*")
    files = [file for file in tmp_path.rglob("*") if file.is_file()]
    assert {file.parent for file in files} == {numba, jax, machine}
    # A pickle in place of every file is not loaded, and all is made again.
    for file in files:
        file.write_bytes(pickle.dumps(Touch(tmp_path / "ran")))
    assert first == outcome(summing(**cache))
    assert not (tmp_path / "ran").exists()
    # What compiles quickly is stored by JAX in one run and not in the next.
    assert all(read_checked(file) for file in files if file.parent == numba or file.exists())


def test_without_a_folder_nothing_is_kept(tmp_path):
    """A file in its place; that "off" is no folder either is above."""
    place = tmp_path / "taken"
    place.write_text("")
    assert float(outcome(summing(GODFIT_CACHE=str(place)))) > 0
    assert place.read_text() == ""
    assert list(tmp_path.iterdir()) == [place]

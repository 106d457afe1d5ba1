"""The committed synthetic targets are what data_synthetic/make.py draws."""

import importlib.util
import json
import tomllib
from pathlib import Path

import jax
import numpy as np
import pytest

from godfit.image import read_image

FOLDER = Path(__file__).parent.parent / "data_synthetic"
MANIFEST = json.loads((FOLDER / "manifest.json").read_text())
TARGETS = MANIFEST["targets"]
COMMITTED = sorted(p.name for p in FOLDER.iterdir() if p.suffix in (".png", ".toml", ".json"))


def _levels(path):
    return np.rint(read_image(path).values * 255).astype(int)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    spec = importlib.util.spec_from_file_location("data_synthetic_make", FOLDER / "make.py")
    make = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make)
    folder = tmp_path_factory.mktemp("data_synthetic")
    with jax.enable_x64(True):
        make.make(folder)
    return folder


def test_the_same_files_are_made(made):
    assert sorted(p.name for p in made.iterdir()) == COMMITTED


@pytest.mark.parametrize("name", COMMITTED)
def test_made_again_it_is_the_same(made, name):
    if not name.endswith(".png"):
        assert (made / name).read_bytes() == (FOLDER / name).read_bytes()
        return
    new, old = _levels(made / name), _levels(FOLDER / name)
    assert new.shape == old.shape
    apart = np.abs(new - old).reshape(*old.shape[:2], -1).max(-1)
    # Another processor may round a value that lies between two levels the other way.
    assert apart.max() <= 1
    assert np.count_nonzero(apart) <= 1e-4 * apart.size


def test_manifest_names_every_file():
    named = {"manifest.json"} | {f"{name}.toml" for name in TARGETS}
    for truth in TARGETS.values():
        named |= {truth[key] for key in ("target", "mask", "background") if key in truth}
    assert sorted(named) == COMMITTED
    assert MANIFEST["schema"] == 1
    assert len(TARGETS) >= 8


@pytest.mark.parametrize("name", TARGETS)
def test_side_file_agrees_with_the_manifest(name):
    truth, beside = TARGETS[name], tomllib.loads((FOLDER / f"{name}.toml").read_text())
    assert {k: beside[k] for k in ("mask", "background") if k in beside} == {
        k: truth[k] for k in ("mask", "background") if k in truth
    }
    lights = sum(key.startswith("light") for key in truth["params"]) // 2
    scattering = {"shader": truth["shader"], "samples": truth["samples"]}
    assert beside["scattering"] == scattering | ({"lights": lights} if lights > 1 else {})


@pytest.mark.parametrize("name", TARGETS)
def test_target_has_something_to_say(name):
    assert len(np.unique(_levels(FOLDER / TARGETS[name]["target"]))) >= 20


def test_what_the_notes_promise():
    """A tenth clipped, a light outside, a smaller mask, a truth on the bounds."""
    clipped = np.mean(_levels(FOLDER / "clipped.png") == 255)
    assert 0.08 < clipped < 0.12
    light = TARGETS["offscreen"]["params"]
    assert not (0 <= light["light_x"] <= 1 and 0 <= light["light_y"] <= 1)
    assert _levels(FOLDER / "halfres_mask.png").shape == (128, 128)
    assert _levels(FOLDER / "coloured_mask.png").shape[2:] == (3,)
    assert TARGETS["decay_one"]["params"]["decay"] == TARGETS["decay_one"]["params"]["density"] == 1


def test_the_folder_is_small():
    assert sum(p.stat().st_size for p in FOLDER.iterdir() if p.is_file()) < 1_500_000

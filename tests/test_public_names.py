"""The public names: those that the docs list, with examples that run, and nothing else."""

import contextlib
import doctest
import importlib
import inspect
import re
import sys
import tomllib
from pathlib import Path

import jax
import numpy as np
import pytest

import godfit
from godfit.io.image import Image
from tests.support.known_truth import fit, picture

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
FUNCTIONS = sorted(
    name for name in godfit.__all__ if inspect.isroutine(getattr(godfit, name)) or
    inspect.isclass(getattr(godfit, name))
)  # fmt: skip


def test_names_are_those_of_the_docs():
    listed = re.findall(r"^\.\. (?:py:data|auto\w+):: godfit\.(\w+)", PAGE, re.MULTILINE)
    assert sorted(listed) == sorted(set(listed))
    assert sorted(listed) == dir(godfit)
    assert "fitting" in vars(godfit)
    for name in listed:
        assert getattr(godfit, name) is not None


def test_version_is_that_of_the_package():
    with (ROOT / "pyproject.toml").open("rb") as file:
        assert godfit.__version__ == tomllib.load(file)["project"]["version"]
    assert (ROOT / "godfit" / "py.typed").is_file()
    assert f"version: {godfit.__version__}\n" in (ROOT / "CITATION.cff").read_text()


@pytest.fixture(scope="module")
def result():
    with jax.enable_x64(False):
        return fit(*picture(3))


SCENE = """
[image]
width = 32
height = 24
[camera]
position = [0, 0, 7]
[light]
position = [0, 0, 0]
radius = 0.8
[[object]]
primitive = "icosphere"
radius = 1
position = [0, 0, 3]
"""


@pytest.fixture(scope="module")
def folder(result, tmp_path_factory):
    """What the examples read: a frame, its mask, a scene and a saved fit."""
    folder = tmp_path_factory.mktemp("examples")
    for name, image in zip(("frame", "mask"), picture(3), strict=True):
        godfit.write_image(folder / f"{name}.png", image / np.float32(255))
    (folder / "scene.toml").write_text(SCENE)
    result.save(folder / "frame.godfit")
    return folder


@pytest.mark.parametrize("name", FUNCTIONS)
def test_examples(name, folder, single_precision):
    thing = getattr(godfit, name)
    text = inspect.getdoc(thing) or ""
    assert ">>> " in text, f"{name}: expected an example"
    test = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    with contextlib.chdir(folder):
        runner.run(test)
    assert runner.summarize(verbose=False).failed == 0


def test_a_result_prints_its_report(result, capsys):
    print(result)
    assert capsys.readouterr().out == result.summary() + "\n"
    assert len(repr(result).splitlines()) == 1
    assert len(repr(result)) < 500


def test_a_figure_shows_itself(result):
    assert result.plot()._repr_png_().startswith(b"\x89PNG")


def test_a_saved_fit_is_the_result(result, tmp_path):
    result.save(tmp_path)
    saved = godfit.load(tmp_path)
    assert saved.params == result.params
    assert saved.summary() == result.summary()
    assert saved.converged == result.converged
    assert saved.model.settings == result.model.settings
    mask = picture(3)[1]
    np.testing.assert_allclose(godfit.render(saved, mask), result.render(), atol=1e-6)
    np.testing.assert_array_equal(godfit.render(result), result.render())
    with pytest.raises(AttributeError, match="has no 'colour'"):
        _ = saved.colour


def test_models_take_images(result):
    mask = picture(3)[1]
    image = Image((mask / 255).astype(np.float32), 1 / 255, "none", "", "")
    np.testing.assert_array_equal(result.model(image), result.model(mask))


def test_modules_are_not_listed():
    importlib.import_module("godfit.studies.clip")
    assert "studies" in vars(sys.modules["godfit"])
    assert "studies" not in dir(godfit)

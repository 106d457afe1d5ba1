"""The rung that made a picture is recommended, and no more than it."""

import json
from itertools import pairwise
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from godfit.__main__ import main
from godfit.io.image import write_image
from godfit.models.mitchell import Mitchell
from godfit.studies.select import select
from tests.support import ladder_truths, random_targets

pytestmark = pytest.mark.usefixtures("single_precision")
# That of most fits in the tests, whose programs these share.
SIZE = 96


def chosen(rung, noise, seed=2, size=SIZE):
    mask, image = ladder_truths.draw(seed, rung, size)
    target = random_targets.to_bytes(image, noise, seed)
    return select(
        target, mask=mask, shader=ladder_truths.SHADER, samples=ladder_truths.SAMPLES
    ), target


@pytest.fixture(scope="module")
def whole():
    return chosen("+ own pixel", 0.0)


def test_rung_is_found(whole):
    """Others in experiments/models/selection.py: what every rung compiles takes its time."""
    found, _ = whole
    assert found.recommended.rung.name == "+ own pixel"
    assert found.recommended.like_noise


def test_models_that_are_nested_are_never_worse(whole):
    rungs = [row.rung for row in whole[0].rows]
    likelihoods = [r.settled.log_likelihood for r in rungs]
    assert all(b > a - 1 for a, b in pairwise(likelihoods))
    assert [r.parameters for r in rungs[:6]] == [2, 2, 4, 5, 6, 7]


def test_criteria_are_those_of_the_likelihood(whole):
    for row in whole[0].rows:
        cost = -2 * row.rung.settled.log_likelihood
        assert row.aic == pytest.approx(cost + 2 * row.rung.parameters)
        assert row.bic == pytest.approx(cost + np.log(SIZE**2) * row.rung.parameters)


def test_shaders_that_draw_the_same_picture_are_one(whole):
    found, target = whole
    assert {"dawntime", "vesper"} <= found.equivalent.keys()
    mask, _ = ladder_truths.draw(2, "+ own pixel", SIZE)
    numbers = ("exposure", "decay", "density", "weight")
    for shader, values in found.equivalent.items():
        light = [values["light_x"], values["light_y"]]
        model = Mitchell(*(values[n] for n in numbers), light, shader, int(values["samples"]))
        image = np.clip(np.asarray(model(jnp.asarray(mask / 255))), 0, 1)
        np.testing.assert_allclose(255 * image, target, atol=0.51)


def test_command_writes_a_table_and_two_files(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    mask, image = ladder_truths.draw(1, "shader defaults", SIZE)
    write_image("frame.png", random_targets.to_bytes(image) / 255)
    write_image("mask.png", mask / 255)
    options = ["--mask", "mask.png", "--shader", "dawntime", "--samples", "100", "-q"]
    assert main(["select", "frame.png", *options]) == 0
    out, err = capsys.readouterr()
    assert "> shader defaults" in out
    assert "it does not show where the light is" in out
    assert err == ""
    record = json.loads(Path("frame.godfit/select.json").read_text())
    assert record["recommended"] == "shader defaults"
    assert Path("frame.godfit/select.png").stat().st_size > 10_000
    assert main(["select", "frame.png"]) == 2

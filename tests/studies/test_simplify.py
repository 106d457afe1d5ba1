"""Fewer samples, the same picture: what simplify promises holds in float64, by other code."""

import json
from pathlib import Path

import numpy as np
import pytest

from godfit.__main__ import main
from godfit.errors import InputError
from godfit.io.image import write_image
from godfit.models.mitchell import Mitchell, resampled
from godfit.studies.simplify import simplify
from tests.support import random_targets, simplified


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_promise_holds_by_other_code(seed):
    found, true, tolerance = simplified.attempt(seed, None, "worst", 64)
    assert true <= tolerance
    assert found.model.samples < found.full.samples
    assert found.saving > 1.2


def test_mean_square_lets_more_go(single_precision):
    worst, _, _ = simplified.attempt(3, 1.0, "worst", 64)
    rms, true, _ = simplified.attempt(3, 1.0, "rms", 64)
    assert true <= 1.0
    assert rms.saving > worst.saving


@pytest.mark.parametrize(("density", "most"), [(0.8, 1.0), (1.5, 2.0)])
def test_resampled_taps_weigh_as_much_and_lie_as_far(density, most):
    full = Mitchell(0.1, 0.98, density, 0.6, [0.5, 0.5], "dawntime", 120)
    few = resampled(full, 30)
    (a,), (b,) = full.taps, few.taps
    np.testing.assert_allclose(b.c.sum(), a.c.sum(), rtol=1e-5)
    np.testing.assert_allclose((b.c * b.t).sum(), (a.c * a.t).sum(), rtol=1e-5)
    assert float(few.density) <= most


@pytest.mark.parametrize(
    ("tolerance", "by", "shader", "words"),
    [
        (0.0, "worst", "dawntime", "expected levels above 0"),
        (1.0, "most", "dawntime", "expected worst or rms"),
        (1.0, "worst", "three", "expected a shader with samples"),
    ],
)
def test_bad_input(tolerance, by, shader, words):
    model = Mitchell(0.1, 0.98, 0.8, 0.6, [0.5, 0.5], shader)
    with pytest.raises(InputError, match=words):
        simplify(model, np.ones((8, 8), np.float32), tolerance, by=by)


@pytest.fixture
def fitted(tmp_path, monkeypatch):
    """A folder with a fit.json written by hand, whose mask is twice as large as its pass."""
    monkeypatch.chdir(tmp_path)
    mask, _, truth = random_targets.draw(4, "clouds", 64)
    write_image("mask.png", mask / 255)
    names = ("exposure", "decay", "density", "weight", "light_x", "light_y")
    record = {
        "model": "mitchell", "shader": "dawntime", "samples": truth["samples"],
        "params": {name: {"value": truth[name]} for name in names},
        "inputs": {"mask": {"path": "mask.png"}}, "size": [64, 64], "pass_size": [32, 32],
    }  # fmt: skip
    Path("fit.json").write_text(json.dumps(record))
    return record


def test_command_prints_what_to_paste(fitted, capsys):
    assert main(["simplify", "fit.json", "--tolerance", "2", "-q"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("this picture needs ")
    assert f"not {fitted['samples']}" in text
    assert main(["simplify", "fit.json", "--tolerance", "2", "--json", "--html", "few.html"]) == 0
    assert "this picture needs" in Path("few.html").read_text(encoding="utf-8")
    record = json.loads(capsys.readouterr().out)
    assert record["worst_levels"] <= 2
    assert record["samples"] < fitted["samples"]
    assert f"  samples  = {record['samples']}\n" in text
    # What was printed is a fit.json to render.
    Path("few.json").write_text(json.dumps(record))
    assert main(["render", "mask.png", "--params", "few.json", "-o", "few.png"]) == 0


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        ({"inputs": {}}, [], "give --mask"),
        ({"inputs": {"mask": {"path": "gone.png"}}}, [], "expected 'gone.png'"),
        ({"model": "hoffman-preetham"}, [], "expected a fit of mitchell"),
        ({"params": 3}, [], "expected a fit.json"),
        ({"pass_size": [128, 128]}, [], "at least the pass's 128x128"),
        ({}, ["--mask", "mask.png", "--scene", "x.toml"], "got both"),
    ],
)
def test_command_says_what_is_wrong(fitted, capsys, change, options, words):
    Path("fit.json").write_text(json.dumps(fitted | change))
    assert main(["simplify", "fit.json", "--tolerance", "2", *options]) == 1
    err = capsys.readouterr().err
    assert words in err
    assert err.count("\n") == 1

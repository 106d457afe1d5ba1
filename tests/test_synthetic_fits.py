"""The targets of data_synthetic through the command line, from the side files alone."""

import json

import pytest

from godfit.__main__ import main
from tests.support.paths import DATA_SYNTHETIC as FOLDER

MANIFEST = json.loads((FOLDER / "manifest.json").read_text())["targets"]
TOLERANCE = {"decay": 5e-5, "density": 5e-4}


# Two lights, box passes and passes of half the size are in test_stability.py and test_fitting.py.
@pytest.mark.parametrize("name", ["offscreen", "background", "pmndrs"])
def test_truth_is_found(name, tmp_path, capsys):
    status = main(["fit", str(FOLDER / f"{name}.png"), "-o", str(tmp_path / "out"), "--json", "-q"])
    printed = capsys.readouterr()
    assert printed.err == ""
    found = json.loads(printed.out)
    assert found == json.loads((tmp_path / "out" / "fit.json").read_text())
    assert status == 0
    assert found["converged"]
    truth = MANIFEST[name]["params"]
    assert set(found["params"]) == set(truth)
    for parameter, estimate in found["params"].items():
        if name == "pmndrs" and parameter in ("exposure", "weight"):
            # No pixel shows its own value: only the product of the two is determined.
            assert estimate["stderr"] is None
            assert any("exposure*weight" in sentence for sentence in found["undetermined"])
            continue
        allowed = TOLERANCE.get(
            parameter, 3e-4 if "light" in parameter else 0.03 * truth[parameter]
        )
        assert abs(estimate["value"] - truth[parameter]) < allowed, parameter
    product = (
        found["params"]["exposure"]["value"] * found["params"].get("weight", {"value": 1})["value"]
    )
    assert product == pytest.approx(truth["exposure"] * truth.get("weight", 1), rel=2e-3)

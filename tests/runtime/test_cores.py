"""One core and two: the same fit.json, but for times and a share of the errors that is stated."""

import json
import os
import subprocess
import sys

import pytest

from godfit.io.image import write_image
from tests.support import known_truth

STATED = 0.01
"""Share of a standard error by which numbers may differ, as docs/how-it-works/inference.md says."""
APART = {"timing_s", "command", "params", "combined", "correlations", "covariance", "where"}


def fitted(cores, folder):
    """fit.json of the target in a folder, by a process that has only ``cores``."""
    # The process begins with fewer cores by itself: this one, with JAX's threads, may not fork.
    begin = (
        f"import os, runpy, sys; os.sched_setaffinity(0, {set(cores)}); "
        "sys.argv[0] = 'godfit'; runpy.run_module('godfit', run_name='__main__')"
    )
    command = [sys.executable, "-c", begin, "fit", "target.png", "--mask", "mask.png"]
    command += ["--shader", "dawntime", "--samples", str(known_truth.SAMPLES), "--json", "-q"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.skipif(
    not hasattr(os, "sched_getaffinity") or len(os.sched_getaffinity(0)) < 2,
    reason="needs two cores and a system that gives a process fewer",
)
def test_the_number_of_cores_changes_last_digits_alone(tmp_path):
    for name, values in zip(("target", "mask"), known_truth.picture(1), strict=True):
        write_image(tmp_path / f"{name}.png", values / 255)
    both = sorted(os.sched_getaffinity(0))[:2]
    one, two = (fitted(cores, tmp_path) for cores in (both[:1], both))
    for key in one["params"]:
        a, b = one["params"][key], two["params"][key]
        assert abs(a["value"] - b["value"]) <= STATED * (a["stderr"] or 0), key
        assert a["stderr"] == pytest.approx(b["stderr"], rel=STATED), key
    for key in one.keys() - APART:
        if isinstance(one[key], float):
            assert one[key] == pytest.approx(two[key], rel=STATED), key
        else:
            assert one[key] == two[key], key

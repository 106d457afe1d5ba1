"""Where methods fail: a seeded part of the promises of experiments/stability/stability.py, at one
size."""

import numpy as np
import pytest

from tests.support import basins, stability_cases

pytestmark = pytest.mark.usefixtures("single_precision")
# One of every promise, and what costs least of each.
NAMES = (
    "a scene's light", "error against n", "clamp against padding",
    "gradient sky", "decay and density at 1", "LevenbergMarquardt", "two lights",
)  # fmt: skip


def test_there_are_enough_rows():
    names = [(case.failure, case.name) for case in stability_cases.CASES]
    assert len(names) == len(set(names)) >= 24


@pytest.mark.parametrize("name", NAMES)
def test_promise_is_kept(name):
    (case,) = [c for c in stability_cases.CASES if c.name == name]
    # A second light is searched for by programs that other tests have at this size.
    kept, words = stability_cases.attempt(case, 96 if name == "two lights" else 64)
    assert kept, words


def test_what_is_raised_breaks_a_promise():
    def fails(size):
        raise ValueError("no")

    assert stability_cases.attempt(stability_cases.Case("", "", "", fails), 64) == (
        False,
        "ValueError: no",
    )


def test_one_start_arrives_from_far_away():
    light, other = basins.maps("triangles", 64, 2)
    # The light half a frame away both ways, attenuation off by a factor of four.
    assert light.all()
    assert other.any()
    near = np.zeros((5, 5), bool)
    near[1:4, 1:4] = True
    assert basins.reach(near) == pytest.approx(0.25 * np.sqrt(2))
    assert basins.reach(np.zeros((3, 3), bool)) == 0

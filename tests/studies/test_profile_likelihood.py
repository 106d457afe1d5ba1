"""Intervals: profiled, at bounds, and against the posterior."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from godfit.__main__ import main
from godfit.errors import InputError
from godfit.io.image import write_image
from godfit.studies.profile_likelihood import profile
from tests.support import profiled_truths
from tests.support.known_truth import ALONE, TRUTH, fit, picture

DRAWS, WARM_UP = 600, 100
"""Of a posterior: the answer's scale is known to 3%."""


@pytest.fixture(scope="module")
def noisy():
    return fit(*picture(3, 1.0), **ALONE)


@pytest.mark.parametrize("name", ["decay", "light_y"])
def test_where_the_problem_is_regular_the_profile_is_the_curvature(noisy, name):
    e = profile(noisy, name).params[name]
    low, high = ((end - e.value) / e.stderr for end in e.interval)
    assert low == pytest.approx(-1.96, abs=0.12)
    assert high == pytest.approx(1.96, abs=0.12)
    assert e.interval[0] <= TRUTH[name] <= e.interval[1]


def test_interval_ends_at_the_bound_of_a_truth_that_lies_there():
    result = fit(*picture(3, 1.0, decay=1.0), **ALONE)
    assert result.params["decay"].at_bound
    e = profile(result, "decay").params["decay"]
    assert e.interval[1] == 1
    # One-sided, and not as wide as the error of a parameter that knows no bound.
    assert 0.3 * e.stderr < 1 - e.interval[0] < 2.5 * e.stderr


def test_interval_of_a_density_of_1_has_two_sides():
    """1 is where the taps reach the light, and no bound."""
    result = fit(*picture(3, 1.0, density=1.0), **ALONE)
    assert not result.params["density"].at_bound
    e = profile(result, "density").params["density"]
    assert e.interval[0] < 1 < e.interval[1]
    assert 2 * e.stderr < e.interval[1] - e.interval[0] < 6 * e.stderr


@pytest.mark.parametrize("name", profiled_truths.PROFILED)
def test_truths_at_a_bound_and_inside_are_covered(name, single_precision):
    """A small run of experiments/accuracy/intervals.py."""
    found = [
        profiled_truths.attempt(seed, name, noise=1.0, size=96, at=at, arithmetic="exact", **ALONE)
        for seed in range(1000, 1002)
        for at in (1.0, None)
    ]
    assert all(one.covers for one in found)
    # What covers because it is wide is no interval.
    widths = [(one.interval[1] - one.interval[0]) / one.result.params[name].stderr for one in found]
    assert max(widths) < 6


def test_without_noise_the_truth_is_inside_a_narrow_interval():
    result = fit(*picture(3))
    e = profile(result, "density").params["density"]
    assert e.interval[0] <= TRUTH["density"] <= e.interval[1]
    assert e.interval[1] - e.interval[0] < 4 * e.stderr


def test_what_is_held_or_open_has_no_profile(noisy):
    with pytest.raises(InputError, match="expected one of exposure"):
        profile(noisy, "decays")
    held = fit(*picture(3, 1.0), fix={"weight": 0.5}, **ALONE)
    with pytest.raises(InputError, match="that is fitted, got 'weight'"):
        profile(held, "weight")


def test_command_writes_the_interval(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    target, mask = picture(3)
    write_image("frame.png", target / 255)
    write_image("mask.png", mask / 255)
    options = [
        "--mask", "mask.png", "--shader", "dawntime", "--samples", "30", "-q",
        "--arithmetic", "exact", "--pass-scale", "1",
    ]  # fmt: skip
    assert main(["fit", "frame.png", *options, "--profile", "density"]) == 0
    assert "(95%, profile)" in capsys.readouterr().out
    entry = json.loads(Path("frame.godfit/fit.json").read_text())["params"]["density"]
    assert entry["interval95"][0] < entry["value"] < entry["interval95"][1]
    assert main(["fit", "frame.png", *options, "--profile", "sharpness", "-o", "other"]) == 1
    err = capsys.readouterr().err
    assert "expected one of exposure" in err
    assert err.count("\n") == 1
    assert not Path("other").exists()


def test_posterior_agrees_with_the_profile(noisy):
    pytest.importorskip("blackjax")
    from godfit.studies.posterior import posterior, with_posterior

    drawn = posterior(noisy, draws=DRAWS, warm_up=WARM_UP)
    assert drawn.divergent == 0
    for name in ("decay", "light_x"):
        low, high = profile(noisy, name).params[name].interval
        draws = drawn.draws[:, drawn.names.index(name)]
        # So many draws know a standard deviation to 3%.
        assert np.std(draws) == pytest.approx((high - low) / 3.92, rel=0.12)
        assert np.mean(draws) == pytest.approx((high + low) / 2, abs=0.05 * (high - low))
        ends = with_posterior(noisy, drawn).params[name].posterior
        np.testing.assert_allclose(
            [np.mean(draws < end) for end in ends], [0.025, 0.975], atol=0.01
        )
    assert np.mean(drawn.noise_levels) == pytest.approx(1, abs=0.05)


def test_intervals_have_the_priors_of_the_fit(noisy, single_precision):
    """A prior as precise as the picture, and an error away from it."""
    alone = noisy.params["weight"]
    prior = {"weight": (alone.value + alone.stderr, alone.stderr)}
    both = fit(*picture(3, 1.0), prior=prior, **ALONE)
    e = both.params["weight"]
    assert e.stderr < 0.8 * alone.stderr
    for name in ("weight", "exposure"):
        e = both.params[name]
        low, high = (
            (end - e.value) / e.stderr for end in profile(both, name).params[name].interval
        )
        assert low == pytest.approx(-1.96, abs=0.15)
        assert high == pytest.approx(1.96, abs=0.15)
    pytest.importorskip("blackjax")
    from godfit.studies.posterior import posterior

    drawn = posterior(both, draws=DRAWS, warm_up=WARM_UP)
    for name in ("weight", "exposure"):
        e, draws = both.params[name], drawn.draws[:, drawn.names.index(name)]
        assert np.mean(draws) == pytest.approx(e.value, abs=0.15 * e.stderr)
        assert np.std(draws) == pytest.approx(e.stderr, rel=0.12)


def test_without_blackjax_one_line_says_so(monkeypatch, noisy):
    from godfit.studies.posterior import posterior

    monkeypatch.setitem(sys.modules, "blackjax", None)
    with pytest.raises(InputError, match=r"pip install 'godfit\[posterior\]'"):
        posterior(noisy)

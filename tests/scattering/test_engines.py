"""Names and algebra of other engines: translations against the taps that both sides have."""

import itertools

import numpy as np
import pytest

from godfit.errors import InputError
from godfit.report.engines.engine_code import TEMPLATES
from godfit.report.engines.ports import LANGUAGES
from godfit.scattering.conventions import CONVENTIONS, convention
from godfit.scattering.engines import ENGINES, TapNumbers, equivalents, translated

POINT = (0.11, 0.96, 0.83, 0.7)
FAMILY = ("mitchell", "dawntime", "vesper", "babylon", "article-hlsl", "pmndrs", "additive",
          "glsl-godrays", "moonshine")  # fmt: skip


def numbers(shader, point=POINT, samples=40):
    (taps,) = convention(shader).taps(*point, samples)
    return TapNumbers.of(taps)


def again(shader, values):
    absent = CONVENTIONS[shader].absent
    known = {"exposure": 1.0, "decay": 1.0, "density": 1.0, "weight": 1.0} | absent | values
    point = [known[name] for name in ("exposure", "decay", "density", "weight")]
    return numbers(shader, point, int(values["samples"]))


@pytest.mark.parametrize(("one", "other"), [*itertools.permutations(FAMILY, 2)])
def test_taps_are_the_same_but_for_the_own_pixel(one, other):
    before = numbers(one)
    found = translated(before, CONVENTIONS[other])
    after = again(other, found.values)
    np.testing.assert_allclose(after[1:], before[1:], rtol=1e-14)
    np.testing.assert_allclose(after.own - before.own, found.own_pixel, rtol=1e-12, atol=1e-15)
    if CONVENTIONS[one].own and CONVENTIONS[other].own:
        np.testing.assert_allclose(after.own, before.own, rtol=1e-14)


def test_panda3d_at_weight_one_is_the_same():
    before = numbers("mitchell", (0.11, 0.96, 0.83, 1.0))
    found = translated(before, CONVENTIONS["panda3d"])
    assert abs(found.own_pixel) < 1e-15
    assert "weight" not in found.values
    np.testing.assert_allclose(again("panda3d", found.values)[:5], before[:5], rtol=1e-14)


def test_a_mean_is_the_same_at_a_decay_of_one():
    before = numbers("additive", (0.02, 1.0, 0.83, 0.5))
    found = translated(before, CONVENTIONS["mean"])
    np.testing.assert_allclose(again("mean", found.values)[1:], before[1:], rtol=1e-12)


def test_reshade_reaches_what_its_limit_allows():
    """E/(1 + E S) is the first weight: it needs that weight times S below 1."""
    before = numbers("additive", (0.02, 0.95, 0.83, 0.5))
    found = translated(before, CONVENTIONS["reshade"])
    total = (1 - 0.95**40) / 0.05
    e = found.values["exposure"]
    np.testing.assert_allclose(e / (1 + e * total), 0.01, rtol=1e-12)
    with pytest.raises(InputError, match=r"reshade.* below 1"):
        translated(numbers("additive", (0.2, 0.95, 0.83, 0.5)), CONVENTIONS["reshade"])


@pytest.mark.parametrize(
    ("shader", "point", "target", "reason"),
    [
        ("mitchell", POINT, "mean", "decay of 1"),
        ("mitchell", POINT, "radial-blur", "density of 1"),
        ("mitchell", POINT, "godot3", "lag"),
        ("mitchell", POINT, "sun-beams", "composition"),
    ],
)
def test_what_algebra_cannot_give_is_said(shader, point, target, reason):
    with pytest.raises(InputError, match=reason) as caught:
        translated(numbers(shader, point), CONVENTIONS[target])
    assert "\n" not in str(caught.value)


def test_a_longer_loop_than_the_targets_is_refused():
    with pytest.raises(InputError, match="at most 100 taps"):
        translated(numbers("mitchell", samples=120), CONVENTIONS["glsl-godrays"])


def test_equivalents_draw_the_same_picture():
    dawntime = CONVENTIONS["dawntime"]
    alone = equivalents(numbers("dawntime"), dawntime, background=False)
    assert {*alone} == {"mitchell", "vesper", "article-glsl", "article-hlsl", "babylon"}
    assert {*equivalents(numbers("dawntime"), dawntime, background=True)} == {"mitchell", "vesper"}
    without = equivalents(numbers("pmndrs"), CONVENTIONS["pmndrs"], False, 0.3)
    assert {*without} == {"additive", "glsl-godrays", "moonshine"}
    assert without["additive"].values["exposure"] == pytest.approx(0.3)


def test_every_engine_has_its_code():
    for engine in ENGINES.values():
        if engine.kind == "port":
            assert engine.template in (*LANGUAGES, "tsl")
        else:
            assert engine.convention in CONVENTIONS
            assert engine.template in TEMPLATES
    assert {engine.kind for engine in ENGINES.values()} == {"exact", "near", "port"}

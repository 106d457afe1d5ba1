"""Which convention made a picture: every sum as one model with numbers held."""

import numpy as np
import pytest

import godfit
from godfit.errors import InputError
from godfit.scattering import forms as sums
from godfit.scattering.conventions import CONVENTIONS
from godfit.search import comparison
from tests.support import distortions, random_targets

SIZE = 96


@pytest.fixture(scope="module")
def picture():
    mask, truth = distortions.frame(2, SIZE, 60)
    return mask, random_targets.to_bytes(random_targets.render64(mask / 255, truth)), truth


def test_conventions_that_give_one_picture_have_one_form():
    forms = {name: sums.form_of(shader) for name, shader in CONVENTIONS.items()}
    assert forms["three"] is None
    assert forms["dawntime"] == forms["vesper"] == forms["babylon"] == sums.Form()
    assert forms["pmndrs"] == sums.Form(own=0)
    assert sum(len(group) for group in sums.forms().values()) == sum(
        form is not None for form in forms.values()
    )


def test_names_have_the_number_of_samples_that_gives_the_taps():
    names = sums.named(sums.Form(), 199)
    assert (names[0].shader, names[0].samples, names[0].default) == ("dawntime", 200, True)
    for name in names:
        assert sums.count_of(CONVENTIONS[name.shader], name.samples) == 199
    # Without a default or a round number, what the user gave comes first.
    assert sums.named(sums.Form(), 136, "vesper")[0].shader == "vesper"


@pytest.mark.usefixtures("single_precision")
def test_the_shader_is_found_and_ties_are_named(picture):
    mask, target, truth = picture
    result = godfit.fit(target, mask=mask, shader="auto", pass_scale=1.0)
    assert result.converged, result.message
    assert result.model.settings == {"shader": "dawntime", "samples": 60}
    assert result.params["density"].value == pytest.approx(truth["density"], abs=1e-3)
    (note,) = [n for n in result.notes if n.startswith("shader: ")]
    assert "does not distinguish it from vesper with 60 samples" in note
    with pytest.raises(InputError, match="shader auto: expected --mask"):
        godfit.fit(target, shader="auto")


@pytest.mark.usefixtures("single_precision")
def test_a_last_tap_that_shows_nothing_is_not_counted_on():
    """Where the mask is black about the light, 99 taps and one more give the same picture. The mean
    has 99, and fewer free numbers than the sum of 100."""
    mask, truth = distortions.frame(1, SIZE, 60)
    light = truth["light_x"], truth["light_y"]
    rows, columns = np.indices(mask.shape)
    away = np.hypot(columns + 0.5 - light[0] * SIZE, rows + 0.5 - (1 - light[1]) * SIZE)
    mask = np.where(away < 14, 0, mask).astype(np.uint8)
    linear = np.asarray(godfit.Mitchell(1.0, 1.0, 0.9, 1.0, light, "mean")(mask))
    target = random_targets.to_bytes(0.9 / np.quantile(linear, 0.99) * linear)
    result = godfit.fit(target, mask=mask, shader="auto", pass_scale=1.0)
    assert result.converged, result.message
    assert result.model.settings == {"shader": "mean", "samples": 100}


@pytest.mark.usefixtures("single_precision")
@pytest.mark.parametrize(
    ("shader", "samples", "says"),
    [("dawntime", 120, "give --samples 60")],
)
def test_another_shader_or_number_is_not_converged_and_names_what_is_right(
    picture, shader, samples, says
):
    mask, target, _ = picture
    result = godfit.fit(target, mask=mask, shader=shader, samples=samples, pass_scale=1.0)
    assert not result.converged
    assert says in result.message


@pytest.mark.usefixtures("single_precision")
def test_a_number_of_samples_whose_bands_rounding_hides_is_named():
    light = np.array([0.4, 0.55])
    mask = random_targets.MASKS["maze"](np.random.default_rng(0), SIZE, light)
    mask = np.floor(mask * 255 + 0.5).astype(np.uint8)
    linear = np.asarray(godfit.Mitchell(1.0, 0.975, 0.8, 0.6, light, "dawntime", 140)(mask))
    target = random_targets.to_bytes(0.7 / np.quantile(linear, 0.99) * linear)
    result = godfit.fit(target, mask=mask, shader="dawntime", samples=100, pass_scale=1.0)
    assert result.noise_levels < 0.1
    assert not result.converged
    assert "give --samples 140" in result.message


def test_a_translated_sum_is_the_same():
    rng = np.random.default_rng(0)
    mask = rng.random((9, 11))
    for name in ("dawntime", "vesper", "babylon"):
        model = godfit.Mitchell(0.1, 0.9, 0.7, 0.6, (0.3, 0.4), shader=name, samples=12)
        other = comparison._translated(model, CONVENTIONS["mitchell"])
        np.testing.assert_allclose(np.asarray(other(mask)), np.asarray(model(mask)), atol=1e-9)

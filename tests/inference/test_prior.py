"""Priors: a Gaussian row of the likelihood, in values, errors and the report."""

import numpy as np
import pytest

from godfit import InputError
from godfit import fit as plain_fit
from godfit.inference.allowances.prior import prior_rows
from godfit.models.mitchell import Mitchell
from tests.support import random_targets
from tests.support.known_truth import ALONE, SAMPLES, TRUTH, fit, picture


def test_rows_are_the_distance_from_the_mean_and_its_slopes():
    """Against central differences of the value by each coordinate."""
    model = Mitchell(0.06, 0.97, 0.85, 0.7, (0.4, 0.6), "dawntime", 60)
    z = np.asarray(model.coordinates())
    held, scale = np.full(6, np.nan), np.array(model.scales(z), float)
    prior = {"weight": (0.8, 0.05), "light_x": (0.41, 0.002)}
    rows = prior_rows(prior, model, held, z, scale)
    assert rows is not None
    np.testing.assert_allclose(rows.excess, [-2, -5])
    for i in range(6):
        ends = []
        for sign in (1, -1):
            at = z.copy()
            at[i] += sign * 1e-6 * scale[i]
            values = model.moved(at).values()
            ends.append([float(values[n] - m) / s for n, (m, s) in prior.items()])
        slope = np.subtract(*ends) / 2e-6
        np.testing.assert_allclose(rows.slopes[:, i], slope, rtol=1e-6, atol=1e-6)
    step = np.array([0.1, 0, 0, 0.2, 0.3, 0])
    np.testing.assert_allclose(rows.moved(step).excess, rows.excess + rows.slopes @ step)
    assert rows.log_density == pytest.approx(-14.5)
    assert prior_rows({"turbidity": (2.0, 1.0)}, model, held, z, scale) is None


def test_a_prior_is_one_more_measurement(single_precision):
    """Two measurements of weight, the picture's and the prior, are weighed by their variances."""
    target, mask = picture(3, 1.0)
    alone = fit(target, mask, **ALONE)
    known, error = alone.params["weight"].value, alone.params["weight"].stderr
    mean, sigma = known + error, error
    both = fit(target, mask, prior={"weight": (mean, sigma)}, **ALONE)
    found = both.params["weight"]
    assert found.value == pytest.approx((known + mean) / 2, abs=0.1 * error)
    # A weight's error grows with the weight, which has grown by half an error.
    assert found.stderr == pytest.approx(error / np.sqrt(2), rel=0.1)
    assert both.record()["prior"] == {"weight": {"value": mean, "sigma": sigma}}
    assert any(note.startswith("prior: weight = ") for note in both.notes)
    assert both.log_likelihood < alone.log_likelihood


def test_a_prior_determines_what_the_picture_leaves_open(single_precision):
    """pmndrs has the product of exposure and weight alone."""
    mask = picture(3)[1]
    dawn = random_targets.render64(mask / 255, TRUTH | {"samples": SAMPLES})
    target = random_targets.to_bytes(dawn - TRUTH["exposure"] * mask / 255)
    options = {"mask": mask, "shader": "pmndrs", "samples": SAMPLES - 1, "arithmetic": "exact"}
    result = plain_fit(target, prior={"exposure": (0.5, 0.01)}, inquire=False, **options)
    assert result.undetermined == ()
    exposure, weight = result.params["exposure"], result.params["weight"]
    assert exposure.value == pytest.approx(0.5, abs=1e-3)
    assert exposure.stderr == pytest.approx(0.01, rel=0.02)
    assert weight.stderr == pytest.approx(0.02 * weight.value, rel=0.05)


@pytest.mark.parametrize(
    ("prior", "message"),
    [
        ({"wieght": (1.0, 0.1)}, "expected a parameter that is fitted"),
        ({"decay": (0.97, 0.1)}, "expected a parameter that is fitted"),
        ({"weight": (1.0, 0.0)}, "a SIGMA above 0, got 1"),
        ({"weight": (float("nan"), 1.0)}, "with finite numbers"),
        ({"weight": 0.8}, "a mean and a standard deviation by name"),
    ],
)
def test_priors_that_cannot_be(prior, message):
    target, mask = picture(3)
    with pytest.raises(InputError, match=message):
        fit(target, mask, prior=prior, fix={"decay": 0.97})
    with pytest.raises(InputError, match="expected a mask, a scene or a canvas"):
        plain_fit(target, prior={"weight": (1.0, 0.1)})

"""What a target went through is taken away from the answer, and no wrong model is excused by it.

A small run of experiments/accuracy/recovery.py --made jpeg and --made upsampled."""

import numpy as np
import pytest

import godfit
from godfit.io.jpeg import compressed
from godfit.studies.posterior import posterior
from godfit.studies.profile_likelihood import profile
from tests.support import random_targets
from tests.support import stability_judges as stability

SIZE = 96
pytestmark = pytest.mark.usefixtures("single_precision")


def as_jpeg(mask, quality=80):
    levels = random_targets.to_bytes(stability.light_pass(mask)).astype(float)
    return compressed(levels[..., None], quality, 0)[..., 0].astype(np.uint8)


def as_upsampled(mask):
    low = mask.reshape(SIZE // 2, 2, SIZE // 2, 2).mean((1, 3)) / 255
    stored = random_targets.to_bytes(random_targets.render64(low, stability.TRUTH)) / 255
    return random_targets.to_bytes(random_targets.enlarged(stored, SIZE))


@pytest.mark.parametrize(("made", "scale"), [(as_jpeg, 1.0), (as_upsampled, 0.5)])
def test_the_answer_is_freed_of_what_the_target_went_through(made, scale):
    mask = stability.mask_of(SIZE, seed=4)
    target = made(mask)
    result = stability.fit(target, mask, pass_scale=scale)
    assert result.converged, result.message
    assert any("JPEG" in w for w in result.warnings) == (made is as_jpeg)
    assert result.pixels_effective < 0.5 * result.pixels
    assert result.simulated
    for ask in (lambda: profile(result, "density"), lambda: posterior(result)):
        with pytest.raises(godfit.InputError, match="whose only errors are noise and rounding"):
            ask()
    # Without asking what may be wrong, the same as if what is left were noise: its errors are too
    # small for what they miss.
    naive = stability.fit(target, mask, pass_scale=scale, inquire=False)
    assert np.max(off(result)) < 4
    assert np.linalg.norm(off(result)) < 0.7 * np.linalg.norm(off(naive))


def off(result):
    """Errors over what is quoted."""
    params = result.params.items()
    return np.abs([(e.value - stability.TRUTH[n]) / e.stderr for n, e in params])


def test_jittered_taps_are_fitted_by_their_mean_and_noise():
    mask = stability.mask_of(SIZE, seed=4)
    jitter = np.random.default_rng(5).random((SIZE, SIZE)) - 0.5
    target = random_targets.to_bytes(random_targets.render64(mask / 255, stability.TRUTH, jitter))
    result = stability.fit(target, mask)
    assert result.converged, result.message
    assert result.simulated
    assert any("jittered by 0.29 of a step" in w for w in result.warnings)
    naive = stability.fit(target, mask, inquire=False)
    assert np.max(off(result)) < 3
    assert np.linalg.norm(off(result)) < 0.5 * np.linalg.norm(off(naive))


def test_a_shifted_mask_is_named_and_not_excused_by_compression():
    """The other defects in experiments/stability/diagnostics.py: each asks for minutes of
    compiling."""
    mask = stability.mask_of(SIZE, seed=3)
    result = stability.fit(as_jpeg(mask, 75), np.roll(mask, (3, -2), (0, 1)), pass_scale=1.0)
    assert not result.converged
    assert not result.simulated
    said = [w for w in result.warnings if "shifted" in w]
    assert len(said) == 1, result.warnings
    assert "moved 2 pixels to the right and -3 down" in said[0]

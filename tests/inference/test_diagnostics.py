"""Warnings: what tells of defects; clean targets are left alone. A small, seeded run of
experiments/stability/diagnostics.py. That a defect is named is in test_indirect_inference.py."""

import itertools

import numpy as np
import pytest

from godfit.inference.diagnostics import Span, Suspect, named
from godfit.io.jpeg import was_jpeg
from godfit.search.multistart import edges_agree
from tests.support import defects, random_targets
from tests.support import scattering_oracle as oracle


@pytest.mark.parametrize("seed", [1])
def test_clean_targets_get_no_warning_and_keep_their_errors(seed):
    result = defects.warned("clean", seed, 96)
    assert result.converged
    assert result.warnings == ()
    assert result.pixels_effective == result.pixels
    assert result.starts_agreed is None


def test_the_shift_of_a_mask_is_seen_at_its_edges():
    mask, truth, rng = defects.truth_and_mask(2, 96)
    target = random_targets.render64(mask / 255, truth) + 0.005 * rng.standard_normal(mask.shape)
    for by in ((0, 0), (3, -2), (-4, 5)):
        moved = np.roll(mask, by, (0, 1)).astype(np.float64)
        assert edges_agree(target, moved) == (-by[0], -by[1])


def test_every_seed_gives_a_defect_that_is_there():
    """With what the fit is given, the truth differs from the target by more than rounding, which is
    half a level at most; in a clean target it does not."""
    for kind, seed in itertools.product([*defects.SAYS, "clean"], range(0, 8, 2)):
        target, given = defects.made(kind, seed, 64)
        _, truth, _ = defects.truth_and_mask(seed, 64)
        numbers = [truth[name] for name in ("exposure", "decay", "density", "weight")]
        light, mask = (truth["light_x"], truth["light_y"]), given["mask"] / 255
        image = oracle.light_pass(mask, given["shader"], *numbers, light, given["samples"])
        expected = 255 * image + given.get("background", 0)
        rounded = target.dtype == np.uint8
        levels = target.astype(float) if rounded else 255 * target
        off = levels - (expected.clip(0, 255) if rounded else expected)
        assert (np.sqrt(np.mean(off**2)) > 0.5) == (kind != "clean"), (kind, seed)


@pytest.mark.parametrize("quality", [60, 75, 90, 95])
def test_jpegs_are_told_from_pictures(quality):
    for seed, kind in enumerate(random_targets.FRESH):
        for noise in (0.0, 1.0):
            _, image, _ = random_targets.draw(seed, kind, 128)
            target = random_targets.to_bytes(image, noise, seed)
            assert not was_jpeg(target.astype(float)), (kind, noise)
            if not noise:
                assert was_jpeg(random_targets.encoded(target, quality).astype(float)), kind


def test_small_flat_or_clipped_pictures_are_no_jpegs():
    assert not was_jpeg(np.zeros((20, 20)))
    assert not was_jpeg(np.full((64, 64), 255.0))


def test_what_parameters_do_as_well_is_no_evidence():
    rng = np.random.default_rng(0)
    jacobian, defect, noise = rng.normal(size=(2, 500)), rng.normal(size=500), rng.normal(size=500)
    span = Span(jacobian, 3 * defect + noise)
    assert span.share([defect]) == pytest.approx(0.9, abs=0.03)
    assert span.step(defect) == pytest.approx(3, abs=0.15)
    assert span.share([jacobian[0] + jacobian[1]]) == 0
    assert Span(jacobian, noise).share([defect]) < 0.02


def test_only_what_explains_nearly_as_much_is_named():
    suspects = [Suspect(s, n, "") for s, n in ((0.8, "a"), (0.6, "b"), (0.3, "c"))]
    assert [s.name for s in named(suspects)] == ["a", "b"]
    assert named([Suspect(0.1, "a", "")]) == []
    assert named([]) == []

"""Masks from another source than their target."""

import numpy as np
import pytest
from PIL import Image

import godfit
from godfit.errors import InputError
from godfit.inference.allowances.mask_rounding import edge_blur, edge_variance
from godfit.inference.observation import Picture
from godfit.inference.settle import Settled
from godfit.io.sources import read_source
from godfit.report.record import fit_record
from godfit.search.registration.explanations import Explanation
from godfit.search.registration.maps import Map
from tests.support import distortions, random_targets

# One more than the pictures of other tests, whose programs the cropped one shares.
SIZE = 97


def test_a_map_of_whole_pixels_is_a_crop():
    rng = np.random.default_rng(0)
    mask = rng.random((12, 15)).astype(np.float32)
    crop = Map(np.ones(2), np.array([2.0, 1.0])).applied(mask, (9, 11))
    np.testing.assert_array_equal(crop, mask[2:11, 1:12])
    corners = Map(np.array([1.1, 0.9]), np.array([2.0, -1.0])).corners((9, 11))
    found = Map.of(corners, (9, 11))
    np.testing.assert_allclose([found.scale, found.shift], [[1.1, 0.9], [2, -1]])


@pytest.mark.usefixtures("single_precision")
def test_a_cropped_target_is_fitted_with_a_note():
    mask, truth = distortions.frame(2, SIZE)
    target = random_targets.to_bytes(random_targets.render64(mask / 255, truth))[1:, :-1]
    result = godfit.fit(target, mask=mask, shader="dawntime", samples=distortions.SAMPLES)
    assert result.converged, result.message
    assert any("+0 pixels to the right and +1 down" in note for note in result.notes)
    # The light, from the left and the bottom of what is left.
    light = truth["light_x"] * SIZE / (SIZE - 1), truth["light_y"] * SIZE / (SIZE - 1)
    for name, value in zip(("light_x", "light_y"), light, strict=True):
        assert result.params[name].value == pytest.approx(value, abs=1e-4)


def test_a_mask_of_another_frame_is_refused_and_the_option_is_named():
    mask = np.eye(60, 50)
    with pytest.raises(InputError, match="--register"):
        godfit.fit(np.eye(50), mask=mask, shader="dawntime")
    with pytest.raises(InputError, match="within 10% of the target's 50x50"):
        godfit.fit(np.eye(50), mask=mask, shader="dawntime", register=True)
    with pytest.raises(InputError, match="no --pass-scale"):
        godfit.fit(np.eye(60), mask=mask * 0.5, shader="dawntime", register=True, pass_scale=0.5)


@pytest.mark.usefixtures("single_precision")
def test_a_mask_that_was_made_smaller_is_fitted_as_it_was_before():
    mask, truth = distortions.frame(2, SIZE - 1)
    mask = np.where(mask > 127, 255, 0).astype(np.uint8)
    target = random_targets.to_bytes(random_targets.render64(mask / 255, truth))
    smaller = Image.fromarray(mask).resize((SIZE - 2, SIZE - 2), Image.Resampling.BILINEAR)
    result = godfit.fit(
        target, mask=np.asarray(smaller), shader="dawntime", samples=distortions.SAMPLES
    )
    assert result.converged, result.message
    assert result.noise_levels < 0.02
    (note,) = [note for note in result.notes if "registered" in note]
    assert "scale 0.989583 x 0.989583" in note
    assert abs(result.params["density"].value - truth["density"]) < 1e-4


@pytest.mark.usefixtures("single_precision")
def test_a_target_that_was_resized_is_a_light_pass_of_the_masks_size():
    mask, truth = distortions.frame(2, SIZE - 1)
    target = random_targets.to_bytes(random_targets.render64(mask / 255, truth))
    smaller = Image.fromarray(target).resize((SIZE - 2, SIZE - 2), Image.Resampling.LANCZOS)
    target = np.asarray(smaller)
    result = godfit.fit(target, mask=mask, shader="dawntime", samples=distortions.SAMPLES)
    assert result.converged, result.message
    (note,) = [note for note in result.notes if "resized" in note]
    assert f"from the mask's {SIZE - 1}x{SIZE - 1} pixels (lanczos)" in note
    assert fit_record(result)["size"] == [SIZE - 1, SIZE - 1]
    for name, one in result.params.items():
        assert abs(one.value - truth[name]) < 5 * one.stderr


@pytest.mark.usefixtures("single_precision")
@pytest.mark.parametrize("colours", ["few", "many"])
def test_edges_that_a_resize_lost_are_an_error_or_no_converged_fit(colours):
    """In few colours, an edge is known to be one of two; in many, it may be anything."""
    mask, truth = distortions.frame(2, SIZE - 1)
    if colours == "many":
        grain = np.random.default_rng(0).integers(0, 40, mask.shape)
        mask = np.where(mask > 127, mask - grain, mask + grain).astype(np.uint8)
    target = random_targets.to_bytes(random_targets.render64(mask / 255, truth))
    # Narrower alone: every row and column that is gone is one more crop to begin with.
    mask = np.asarray(Image.fromarray(mask).resize((SIZE - 6, SIZE - 1), Image.Resampling.BOX))
    result = godfit.fit(
        target, mask=mask, shader="dawntime", samples=distortions.SAMPLES, register=True,
        inquire=False,
    )  # fmt: skip
    assert result.converged == (colours == "few"), result.message
    if colours == "many":
        assert "a resize" in result.message
        assert "give the mask as the shader read it" in result.message
    for name, one in result.params.items():
        assert one.stderr is not None
        assert abs(one.value - truth[name]) < 4 * one.stderr


def test_what_a_resize_left_of_an_edge_is_known_to_its_two_sides():
    mask = np.float32([[0, 0, 0.25, 1, 1]] * 3)
    np.testing.assert_allclose(edge_variance(mask)[1], [0, 0, 0.1875, 0, 0])
    np.testing.assert_allclose(edge_blur(mask)[1], [0, 0, -np.sqrt(0.1875), 0, 0], rtol=1e-6)
    # Each channel has edges of its own.
    both = np.stack([mask, np.zeros_like(mask)], -1)
    assert edge_variance(both).any((0, 1)).tolist() == [True, False]


@pytest.mark.usefixtures("single_precision")
def test_an_explanation_makes_all_of_the_target_again():
    """Pixels that a resize leaves known may be flat, and say nothing of the rest."""
    mask, truth = distortions.frame(2, SIZE - 1)
    target = random_targets.to_bytes(random_targets.render64(mask / 255, truth))
    options = {"mask": mask, "shader": "dawntime", "samples": distortions.SAMPLES}
    problem = godfit.problem(target, **options)
    small = Image.fromarray(target).resize((SIZE - 2, SIZE - 2), Image.Resampling.BICUBIC)
    image = read_source(np.asarray(small), "none", "target")
    smaller = Picture.make(image, np.zeros(image.values.shape, np.float32), None, None)
    right = Explanation(problem, Settled(problem.point, 0.005, 0.0, True), kernel="bicubic")
    assert right.makes(smaller)
    wrong = problem.point.copy()
    wrong[problem.index("density")] *= 0.9
    assert not right._replace(settled=Settled(wrong, 0.005, 0.0, True)).makes(smaller)

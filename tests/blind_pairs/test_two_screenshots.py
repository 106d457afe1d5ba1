"""Two screenshots, the effect on and off, without a mask."""

import math

import numpy as np
import pytest

import godfit
from godfit.blind import hypotheses, pair_scene, search, two_screenshots
from godfit.blind.light_pass import ENCODINGS, light_pass
from godfit.blind.pair_scene import Place
from godfit.errors import InputError
from godfit.io.sources import read_source
from godfit.scattering.conventions import convention
from tests.support import random_targets
from tests.support.blind_search import fewer_pairs  # noqa: F401


def srgb(values):
    low = values <= 0.0031308
    return np.where(low, 12.92 * values, 1.055 * np.maximum(values, 1e-9) ** (1 / 2.4) - 0.055)


def scene(h=40, w=60):
    """(h, w, 3) a textured ordinary pass, linear."""
    return np.random.default_rng(3).uniform(0.05, 0.6, (h, w, 3))


def bytes_of(values):
    return np.floor(255 * np.clip(values, 0, 1) + 0.5).astype(np.uint8)


def pass_of(on, off, shader, encodings):
    return light_pass(
        read_source(on, "none"), read_source(off, "none"), convention(shader), encodings, None
    )


@pytest.mark.parametrize("shader", ["mitchell", "babylon"])
def test_additive_light_passes_are_differences(shader):
    off = bytes_of(scene())
    glow = np.linspace(0, 0.9, 60)[None, :, None]
    on = bytes_of(convention(shader).background_gain * off / 255 + glow)
    found = pass_of(on, off, shader, ENCODINGS[:1])
    assert found.grey
    truth = np.broadcast_to(255 * glow, (40, 60, 1))
    assert np.abs(found.values - truth)[found.known].max() < 1
    assert (found.values <= truth + 1)[~found.known].all()
    assert 0 < (~found.known).mean() < 0.5


@pytest.mark.parametrize("linear", [False, True])
def test_screens_are_undone_in_the_encoding_in_which_channels_agree(linear):
    values, glow = scene(), np.linspace(0, 0.5, 60)[None, :, None]
    on = bytes_of(srgb(values + glow - values * glow))
    off = bytes_of(values if linear else srgb(values))
    found = pass_of(on, off, "pmndrs", ENCODINGS)
    assert (found.blend.transfer, found.blend.scene) == ("srgb", "none" if linear else "srgb")
    error = (found.values - 255 * glow)[found.known]
    assert abs(error.mean()) < 0.2


def test_pictures_that_differ_in_nothing_are_refused():
    off = bytes_of(scene())
    with pytest.raises(InputError, match="with the effect off, got a picture that differs"):
        godfit.fit(off, background=off.copy(), shader="mitchell")
    with pytest.raises(InputError, match=r"background: expected the target's 60x40"):
        godfit.fit(off, background=off[:20], shader="mitchell")


@pytest.mark.parametrize(
    ("option", "value"),
    [("fix", {"density": 0.5}), ("start", {"density": 0.5}), ("pass_scale", 0.5), ("lights", 2),
     ("flip", "vertical"), ("arithmetic", "gpu")],
)  # fmt: skip
def test_options_that_need_a_mask_are_refused(option, value):
    off = bytes_of(scene())
    with pytest.raises(InputError, match=f"{option.replace('_', ' ')}: expected none with two"):
        godfit.fit(off, background=off // 2, shader="dawntime", **{option: value})


def objects_and_light(h=108, w=192):
    """An ordinary pass with dark objects, the light pass of an open ground with a disc behind them,
    in units of white, and what made it."""
    rows, columns = np.mgrid[:h, :w]
    x, y = (columns + 0.5) / w, (h - rows - 0.5) / h
    objects = np.zeros((h, w), bool)
    for left, top in ((20, 30), (60, 62), (110, 20), (140, 70), (88, 40)):
        objects[top : top + 18, left : left + 14] = True
    mask = np.where(np.hypot(x - 0.4, (y - 0.6) * h / w) < 0.04, 1.0, 0.1) * ~objects
    truth = {
        "exposure": 0.05, "decay": 0.97, "density": 0.8, "weight": 0.6, "samples": 80,
        "light_x": 0.4, "light_y": 0.6,
    }  # fmt: skip
    off = np.where(objects, 0.02, 0.2) + np.random.default_rng(3).uniform(0, 0.02, (h, w))
    return bytes_of(off), random_targets.render64(mask, truth), truth


@pytest.mark.usefixtures("fewer_pairs")
def test_the_objects_of_the_ordinary_pass_tell_light_and_density():
    off, light, truth = objects_and_light()
    images = [read_source(im, "none") for im in (bytes_of(off / 255 + light), off)]
    shader = convention("dawntime")
    found = pair_scene.scene_places(
        light_pass(*images, shader, ENCODINGS[:1], None),
        pair_scene.Scene(*images, None),
        shader,
        None,
    )
    at = pair_scene.in_levels(found[0], 1 / (0.6 * 80))
    assert (at.u, at.v) == pytest.approx((0.4, 0.6), abs=0.005)
    assert at.rho == pytest.approx(0.8, abs=0.05)
    assert at.kappa == pytest.approx(-80 * math.log(truth["decay"]), rel=0.15)
    kappa, own = -80 * math.log(0.97), 1 / (0.6 * 80)
    white = 255 * 0.05 * 0.6 * 80 * ((1 - math.exp(-kappa)) / kappa + own)
    assert at.bright == pytest.approx(white, rel=0.3)
    assert at.dim == pytest.approx(0.1 * white, rel=0.3)


@pytest.mark.usefixtures("fewer_pairs")
def test_passes_that_are_no_rays_give_the_light_alone():
    """The sum of several passes: the mask is what is not dark, and the numbers have no errors."""
    # As large as the picture of test_fitting.py whose passes these are: its programs serve.
    off, *_ = objects_and_light(96, 96)
    mask = pair_scene.not_dark(read_source(off, "none"))
    assert 0.02 < (mask == 0).mean() < 0.4
    model = godfit.Mitchell(0.4, 1.0, 1.0, 1.0, [[0.42, 0.7]], "three")
    on = bytes_of(off / 255 + np.asarray(model(mask)))
    result = godfit.fit(on, background=off, shader="three")
    assert result.params["light_x"].value == pytest.approx(0.42, abs=0.005)
    assert result.params["light_y"].value == pytest.approx(0.7, abs=0.005)
    assert not result.converged
    assert all(estimate.stderr is None for estimate in result.params.values())
    assert "not dark" in result.message


def test_mask_and_numbers_in_turn(tmp_path, monkeypatch):
    """From where a search leads, the mask to the texel, and numbers on the exact taps."""
    h, w = 72, 128
    rows, columns = np.mgrid[:h, :w]
    x, y = (columns + 0.5) / w, (h - rows - 0.5) / h
    mask = np.where(np.hypot(x - 0.4, (y - 0.6) * h / w) < 0.05, 1.0, 0.06)
    mask[40:64, 64:88] = 0
    truth = {
        "exposure": 0.05, "decay": 0.97, "density": 0.8, "weight": 0.6, "samples": 80,
        "light_x": 0.4, "light_y": 0.6,
    }  # fmt: skip
    light = random_targets.render64(mask, truth)
    off = bytes_of(np.random.default_rng(3).uniform(0.05, 0.3, (h, w)))
    on = bytes_of(off / 255 + light)
    assert (on == 255).mean() > 0.01
    kappa, own = -80 * math.log(0.97), 1 / (0.6 * 80)
    bright = 255 * 0.05 * 0.6 * 80 * ((1 - math.exp(-kappa)) / kappa + own)
    at = Place(0.4, 0.6, kappa, 0.8, own, 0.06 * bright, bright, 0.05)
    point = np.array([0.4, 0.6, kappa / 0.8, 0.8, math.log(0.05)])
    nothing = np.zeros((1, 1))
    hypothesis = hypotheses.Hypothesis("bright", nothing, nothing, *[nothing] * 4, (), nothing)
    found = search.Candidate(hypothesis, point, -1.0)
    monkeypatch.setattr(two_screenshots, "scene_places", lambda *_: [found])
    monkeypatch.setattr(two_screenshots, "in_levels", lambda *_: at)
    result = godfit.fit(on, background=off, shader="dawntime", samples=80)
    assert result.params["light_x"].value == pytest.approx(0.4, abs=1e-3)
    assert result.params["light_y"].value == pytest.approx(0.6, abs=1e-3)
    assert result.params["density"].value == pytest.approx(0.8, abs=0.01)
    assert result.params["decay"].value == pytest.approx(0.97, abs=0.001)
    # An estimated mask takes up what the numbers leave: their curvature is no error.
    assert not result.converged
    assert all(estimate.stderr is None for estimate in result.params.values())
    assert result.noise_levels < 0.5
    bright_texels, dark = result.mask > 0.5, result.mask < 0.03
    assert (bright_texels & (mask > 0.5)).sum() > 0.95 * (bright_texels | (mask > 0.5)).sum()
    assert (dark & (mask == 0)).sum() > 0.9 * (dark | (mask == 0)).sum()
    result.save(tmp_path)
    assert {"fit.json", "fit.png", "render.png", "mask.png"} <= {p.name for p in tmp_path.iterdir()}


@pytest.mark.usefixtures("fewer_pairs")
def test_a_pair_without_a_light_has_no_numbers():
    """Noise that no light explains: no errors, and what to do next."""
    rng = np.random.default_rng(5)
    off = bytes_of(rng.uniform(0.1, 0.5, (30, 40)))
    on = bytes_of(off / 255 + rng.uniform(0, 0.4, (30, 40)))
    result = godfit.fit(on, background=off, shader="dawntime", samples=40)
    assert not result.converged
    assert all(estimate.stderr is None for estimate in result.params.values())
    assert "no single light explains" in result.message
    assert "--mask" in result.message

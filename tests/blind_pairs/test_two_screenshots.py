"""Two screenshots, the effect on and off, without a mask."""

import numpy as np
import pytest

import godfit
from godfit.blind.light_pass import ENCODINGS, light_pass
from godfit.errors import InputError
from godfit.io.sources import read_source
from godfit.scattering.taps import convention
from tests.support import random_targets


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
    with pytest.raises(InputError, match="passes are boxes"):
        godfit.fit(off, background=off // 2, shader="three")


def test_a_pair_gives_its_light(tmp_path):
    h, w = 90, 160
    rows, columns = np.mgrid[:h, :w]
    x, y = (columns + 0.5) / w, (h - rows - 0.5) / h
    mask = np.where(np.hypot(x - 0.4, (y - 0.6) * h / w) < 0.05, 1.0, 0.06)
    mask[50:80, 80:110] = 0
    truth = {
        "exposure": 0.1, "decay": 0.97, "density": 0.8, "weight": 0.6, "samples": 80,
        "light_x": 0.4, "light_y": 0.6,
    }  # fmt: skip
    light = random_targets.render64(mask, truth)
    off = bytes_of(scene(h, w)[..., :1] / 2)[..., 0]
    on = bytes_of(off / 255 + light)
    result = godfit.fit(on, background=off, shader="dawntime", samples=80, light_near=(0.42, 0.57))
    assert result.params["light_x"].value == pytest.approx(0.4, abs=0.01)
    assert result.params["light_y"].value == pytest.approx(0.6, abs=0.01)
    assert result.params["exposure"].stderr is None
    if not result.converged:
        assert result.params["density"].stderr is None
        assert "--mask" in result.message
    result.save(tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {"fit.json", "fit.png", "render.png", "mask.png"}
    bright = result.mask > 0.5
    assert (bright & (mask > 0.5)).sum() > 0.6 * (bright | (mask > 0.5)).sum()

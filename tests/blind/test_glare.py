"""The light from the outline of glare, against where it was put."""

import jax.numpy as jnp
import numpy as np
import pytest

from godfit.blind import beginnings, glare, screenshot
from godfit.inference.observation import Picture
from godfit.io.image import LEVELS
from godfit.io.sources import read_source
from godfit.models.coordinates import VEIL
from godfit.models.disc_light import DiscLight
from godfit.models.mitchell import Mitchell
from tests.support.synthetic import screens

made = screens.make_screenshot

SIZE = (120, 200)


def picture_of(levels, valid=None):
    image = read_source(np.asarray(levels, np.uint8), "none")
    return Picture.make(image, np.ones(levels.shape[:2], np.float32), None, valid)


def glowing(u, v, radius):
    """(h, w, 3) levels of a glow that clips so far about a light, in picture heights; green clips a
    little farther away."""
    h, w = SIZE
    x, y = (np.arange(w) + 0.5) / h, 1 - (np.arange(h)[:, None] + 0.5) / h
    away = np.hypot(x - u * w / h, y - v) / radius
    return np.clip(np.stack([255 - 300 * (away - k) for k in (1.0, 1.2, 1.0)], -1), 40, 255)


@pytest.mark.parametrize("light", [(0.4, 0.6), (0.3, -0.1), (1.1, 0.5)])
def test_circles_are_about_the_light(light):
    """On the picture and beside it, with a third of the glow behind an object and another in
    shadow."""
    levels = glowing(*light, 0.3)
    h, w = SIZE
    x, y = (np.arange(w) + 0.5) / h, 1 - (np.arange(h)[:, None] + 0.5) / h
    turn = np.arctan2(y - light[1], x - light[0] * w / h)
    inward = np.arctan2(0.5 - light[1], (0.5 - light[0]) * w / h)
    beside = np.abs((turn - inward + np.pi) % (2 * np.pi) - np.pi)
    levels[(beside > 0.4) & (beside < 0.7)] = 40
    found = glare.circles(picture_of(levels), 0)
    off = np.abs(found[:, :2] - light).max(1)
    assert (off < 0.01).sum() >= 2
    # Of any channel, and of all of them.
    radii = found[off < 0.01][:, 2]
    assert np.abs(radii - 0.36).min() < 0.01
    assert np.abs(radii - 0.3).min() < 0.01


def test_without_glare_there_are_none():
    assert len(glare.circles(picture_of(np.full((*SIZE, 3), 90.0)), 0)) == 0
    # The outline of a line is no circle.
    levels = np.full((*SIZE, 3), 90.0)
    levels[50:53] = 255
    assert len(glare.circles(picture_of(levels), 0)) == 0


def test_starts_clip_on_the_circle():
    """Where nothing stands in the way, each start's glow reaches the limit there and ends a little
    farther away."""
    picture = picture_of(glowing(0.4, 0.6, 0.3))
    h, w = SIZE
    shading = Mitchell(0.1, 0.98, 0.8, 0.8, [[0.5, 0.5]], "dawntime", 400)
    model = DiscLight(shading, [0.1, 0.002, 0.05], np.zeros((1, 3)))
    seen = picture.observe(np.arange(h * w))
    held = np.full(len(model.coordinates()), np.nan)
    x, y = (np.arange(w) + 0.5) / h, 1 - (np.arange(h)[:, None] + 0.5) / h
    radii = {tuple(circle[:2]): circle[2] for circle in glare.circles(picture, 0)}
    room = LEVELS - 40
    begun = glare.starts(picture, 0)
    compared = 0
    for start in begun:
        z = beginnings.coordinates_of(start, model).astype(float)
        z[VEIL] = 0
        shown = np.asarray(seen.predict(model.moved(jnp.asarray(z), held)))
        shown = shown.reshape(h, w, -1)[..., 0]
        u, v = start["light_x"], start["light_y"]
        away, clips = np.hypot(x - u * w / h, y - v), radii[u, v]
        ends = start["radius"] / (1 - start["density"]) / clips
        if start["radius"] * h < 8 or ends < 1.1:
            # Of a disc of a few texels, or a rim that few taps read, no picture is to be had.
            continue
        compared += 1
        assert shown[away > 1.5 * clips].max() < 0.2 * room
        ring = np.median(shown[np.abs(away - clips) < 0.5 / h])
        assert ring == pytest.approx(room, rel=0.03)
    assert compared > 8


@pytest.mark.parametrize(
    ("background", "seed"), [("flat", 9053), ("smooth", 9061), ("flat", 9042), ("smooth", 9046)]
)
def test_light_of_a_screenshot(background, seed):
    """Two of these are lit so little beyond the glare that nothing else gives the light away."""
    screen = made(seed, background)
    valid = np.ones(screen.image.shape[:2], bool)
    for x, y, w, h in screen.panels:
        valid[y : y + h, x : x + w] = False
    reading = screenshot.read(read_source(screen.image, "none"), valid, None)
    found = glare.circles(reading.picture, 0)
    light = screen.truth["light_x"], screen.truth["light_y"]
    assert np.abs(found[:, :2] - light).max(1).min() < 0.01

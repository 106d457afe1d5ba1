"""Rows of the stability matrix without a mask that is given: bare pictures, pairs, clips, daylight,
light in the plane, scenes."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import godfit
from godfit.flatland import Canvas, Sky, render
from godfit.scenes.raster import on_screen
from godfit.scenes.scene import read_scene
from godfit.scenes.view import drawn_mask
from godfit.studies import clip
from tests.support import daylight_targets, random_targets
from tests.support.stability_judges import (
    SAMPLES,
    TRUTH,
    Outcome,
    finite,
    light_pass,
    mask_of,
    says,
)
from tests.support.synthetic import screens

NEAR = 0.02
"""Share of the picture by which a light that is called right may be off, without a mask."""
RAYS = 24
SUN = {
    "exposure": 0.8, "sun_angle": 130.0, "sun_width": 35.0, "sun_r": 1.4, "sun_g": 1.1,
    "sun_b": 0.7, "sky_r": 0.15, "sky_g": 0.25, "sky_b": 0.45,
}  # fmt: skip
STAGE = """[image]
width = {size}
height = {size}
[camera]
position = [0, 0, 6]
[light]
position = [0.4, 0.3, -2]
radius = 1.0
[[object]]
primitive = "box"
size = [0.6, 1.6, 0.4]
position = [{x}, {y}, 1]
rotation = [10, 20, 5]
[[object]]
primitive = "torus"
radius = 0.8
tube = 0.2
position = [0.9, -0.6, 0]
"""


def off_by(result: godfit.FitResult, truth: dict[str, float]) -> list[str]:
    """Names of parameters that are more than five of their errors off."""
    return [
        name
        for name, e in result.params.items()
        if name in truth and e.stderr is not None and abs(e.value - truth[name]) > 5 * e.stderr
    ]


def bare(seed: int, kind: str = "flat") -> Callable[[int], Outcome]:
    """The light of a finished picture, and no number that is wrong."""

    def run(size: int) -> Outcome:
        screen = screens.make_screenshot(seed, kind, (2 * size, 3 * size))
        valid = np.ones(screen.image.shape[:2], bool)
        for x, y, wide, high in screen.panels:
            valid[y : y + high, x : x + wide] = False
        samples = int(screen.truth["samples"])
        result = godfit.fit(screen.image, shader="dawntime", samples=samples, valid=valid)
        off = max(abs(result.params[n].value - screen.truth[n]) for n in ("light_x", "light_y"))
        wrong = off_by(result, screen.truth) if result.converged else []
        return off < NEAR and not wrong, f"{says(result)}; light off {off:.4f}; wrong: {wrong}"

    return run


def rayless(size: int) -> Outcome:
    _, image = screens.without_rays(1, (2 * size, 3 * size))
    result = godfit.fit(image, shader="dawntime")
    return not result.converged and "--background" in result.message, result.message[:70]


def two_pictures(size: int) -> tuple[np.ndarray, np.ndarray]:
    """(on, off) bytes: dark objects before a disc on a veil."""
    h, w = size, 2 * size
    rows, columns = np.mgrid[:h, :w]
    x, y = (columns + 0.5) / w, (h - rows - 0.5) / h
    objects = np.zeros((h, w), bool)
    for left, top in ((0.1, 0.28), (0.31, 0.57), (0.57, 0.18), (0.73, 0.65), (0.46, 0.37)):
        objects |= (abs(x - left) < 0.04) & (abs(1 - y - top) < 0.08)
    mask = np.where(np.hypot(x - 0.4, (y - 0.6) * h / w) < 0.04, 1.0, 0.1) * ~objects
    truth = TRUTH | {"exposure": 0.05, "light_x": 0.4, "light_y": 0.6}
    off = np.where(objects, 0.02, 0.2) + np.random.default_rng(3).uniform(0, 0.02, (h, w))
    below = random_targets.to_bytes(off)
    return random_targets.to_bytes(below / 255 + random_targets.render64(mask, truth)), below


def pair(size: int) -> Outcome:
    on, off = two_pictures(size)
    result = godfit.fit(on, background=off, shader="dawntime", samples=SAMPLES)
    light = result.params["light_x"].value - 0.4, result.params["light_y"].value - 0.6
    away = float(np.abs(light).max())
    return away < NEAR and not result.converged, f"{says(result)}; light off {away:.4f}"


def same_pair(size: int) -> Outcome:
    on, _ = two_pictures(size)
    try:
        godfit.fit(on, background=on.copy(), shader="dawntime", samples=SAMPLES)
    except godfit.InputError as error:
        return "differs" in str(error) and "\n" not in str(error), str(error)[-60:]
    return False, "not refused"


def frames(size: int, odd: bool) -> tuple[list[clip.Shot], list[tuple[float, float]]]:
    """Four frames of one shader; with ``odd`` the third has another density."""
    lights = [(0.42, 0.6), (0.5, 0.55), (0.6, 0.64), (0.68, 0.5)]
    shots = []
    for i, (x, y) in enumerate(lights):
        changes = {"light_x": x, "light_y": y} | ({"density": 0.7} if odd and i == 2 else {})
        mask = mask_of(size, "triangles", 20 + i, **changes)
        shots.append(clip.Shot(random_targets.to_bytes(light_pass(mask, **changes)), mask))
    return shots, lights


def clip_of_frames(size: int) -> Outcome:
    shots, lights = frames(size, False)
    result = clip.fit_clip(shots, shader="dawntime", samples=SAMPLES, arithmetic="exact")
    wrong = [
        name
        for name in ("decay", "density", "weight", "exposure")
        if abs(result.params[name].value - TRUTH[name]) > 5 * (result.params[name].stderr or np.inf)
    ]
    away = max(
        float(np.abs(np.subtract(f.light, at)).max())
        for f, at in zip(result.frames, lights, strict=True)
    )
    kept = result.converged and not wrong and away < 2e-3
    return kept, f"{result.message[:30]}; lights off {away:.1e}; wrong: {wrong}"


def odd_frame(size: int) -> Outcome:
    shots, _ = frames(size, True)
    result = clip.fit_clip(shots, shader="dawntime", samples=SAMPLES, arithmetic="exact")
    density = result.params["density"]
    near = abs(density.value - TRUTH["density"]) < 5 * (density.stderr or np.inf)
    left_out = [bool(frame.message) for frame in result.frames]
    return near and left_out == [False, False, True, False], " ".join(result.warnings)[:90]


def daylight(kind: str) -> Callable[[int], Outcome]:
    def run(size: int) -> Outcome:
        view, image, truth = daylight_targets.draw(100, kind, size)
        result = godfit.fit(
            random_targets.to_bytes(image), mask=view["mask"], model="hoffman-preetham",
            fov=view["fov"], distance=view["distance"], samples=daylight_targets.SAMPLES,
        )  # fmt: skip
        wrong = off_by(result, truth)
        return result.converged and not wrong, f"{says(result)}; wrong: {wrong}"

    return run


def no_sky(size: int) -> Outcome:
    """Behind a wall all air is dark: nothing is determined."""
    target = np.zeros((size, size, 3), np.uint8)
    result = godfit.fit(
        target, mask=np.zeros((size, size)), model="hoffman-preetham", fov=50.0, distance=0.5
    )
    return not result.converged and finite(result), says(result)


def drawing(size: int, walls: bool) -> np.ndarray:
    """RGBA bytes: a wall with a gap, a block, and a lamp; without ``walls`` nothing at all."""
    values = np.zeros((size, size, 4), np.uint8)
    if walls:
        part = size // 16
        values[6 * part : 7 * part, :, 3] = 255
        values[6 * part : 7 * part, 7 * part : 9 * part, 3] = 0
        values[10 * part : 12 * part, 3 * part : 5 * part, 3] = 255
        values[9 * part : 10 * part, 12 * part : 13 * part] = (240, 160, 60, 255)
    return values


def plane(walls: bool) -> Callable[[int], Outcome]:
    def run(size: int) -> Outcome:
        a = drawing(size // 2, walls) / 255
        canvas = Canvas(jnp.asarray(a[..., :3] * a[..., 3:]), jnp.asarray(a[..., 3]))
        sun, sky = (tuple(SUN[f"{name}_{c}"] for c in "rgb") for name in ("sun", "sky"))
        light = Sky(SUN["sun_angle"], SUN["sun_width"], sun, sky)
        image = np.asarray(render(canvas, light, rays=RAYS, exposure=SUN["exposure"]))
        result = godfit.fit(random_targets.to_bytes(image), canvas=canvas, rays=RAYS)
        wrong = off_by(result, SUN)
        if walls:
            return result.converged and not wrong, f"{says(result)}; wrong: {wrong}"
        return not result.converged and finite(result), says(result)

    return run


def placed(x: float, y: float, off: float) -> Callable[[int], Outcome]:
    """A box at ``x, y``, started ``off`` beside it."""

    def run(size: int) -> Outcome:
        with tempfile.TemporaryDirectory() as folder:
            scenes = []
            for name, at in (("truth", x), ("start", x + off)):
                path = Path(folder) / f"{name}.toml"
                path.write_text(STAGE.format(size=size, x=at, y=y))
                scenes.append(read_scene(path))
        scene, start = scenes
        u, v = np.asarray(on_screen(scene), float)
        image = light_pass(
            np.asarray(255 * drawn_mask(scene, True), np.float64), light_x=u, light_y=v
        )
        result = godfit.fit(
            random_targets.to_bytes(image), scene=start, free=("object[0].position",),
            shader="dawntime", samples=SAMPLES,
        )  # fmt: skip
        truth = {"object[0].position.x": x, "object[0].position.y": y, "object[0].position.z": 1.0}
        wrong = off_by(result, truth)
        if abs(x) > 3:
            open_ = all(result.params[name].stderr is None for name in truth)
            return open_ and finite(result), f"{says(result)}; {result.undetermined}"[:90]
        return result.converged and not wrong, f"{says(result)}; wrong: {wrong}"

    return run

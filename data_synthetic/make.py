"""Draws the synthetic targets: masks by formula, true parameters, and the pictures they make.

    python data_synthetic/make.py [FOLDER]
    python data_synthetic/make.py --gif FILE flight

Masks of scenes (stages.py) are the rasteriser's; canvases of the light in the plane (canvases.py)
are drawn by formula or by falling sand (sand.py). Screenshots (screens.py) come without a mask, as
the program itself draws them. With --gif what moves becomes an animation.

A mask is rounded to bytes before anything is rendered from it, so that the parameters in the table
below are exactly the picture's. Other pictures are rendered by the reference sum in float64 and
rounded once. ``x.toml`` tells the command line about ``x.png``; manifest.json holds the truth.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

import canvases
import equinox as eqx
import imagecodecs
import imageio.v3
import jax
import jax.numpy as jnp
import numpy as np
import sand
import screens
from stages import FRAMES, SEQUENCES, STAGES, Stage

from godfit.flatland import Sky, canvas, render
from godfit.io.image import write_image
from godfit.models.mitchell import Mitchell
from godfit.runtime.files import atomic_write
from godfit.scattering.parameters import light_parameters
from godfit.scattering.radial.reference import bilinear
from godfit.scenes.scene import Scene, read_scene
from godfit.scenes.view import drawn_mask, light_on_screen

MOVING = (*SEQUENCES, "sand")
PLANE_RAYS = 128
GOLDEN = (5**0.5 - 1) / 2  # its multiples, modulo 1, look scattered without being random


class Canvas:
    """A picture to paint on. x and y are in picture heights, y up, (0.5, 0.5) in the middle."""

    def __init__(self, height: int, width: int, value: float | list[float] = 0.0):
        u, v = (np.arange(width) + 0.5) / width, 1 - (np.arange(height) + 0.5) / height
        self.x, self.y = np.meshgrid((u - 0.5) * width / height + 0.5, v)
        self.values = np.broadcast_to(value, (height, width, *np.shape(value))).astype(float)

    def paint(self, distance, value: float | list[float] | np.ndarray = 0.0) -> None:
        """Paint where ``distance`` to a shape's edge (in heights) is negative; the edge is one
        pixel wide."""
        cover = np.clip(0.5 - distance * len(self.x), 0, 1)
        cover = cover.reshape(cover.shape + (1,) * (self.values.ndim - 2))
        self.values += cover * (value - self.values)

    def disc(self, x: float, y: float, radius: float | np.ndarray = 0.0):
        return np.hypot(self.x - x, self.y - y) - radius

    def glow(self, x: float, y: float, width: float):
        return np.exp(-((self.disc(x, y) / width) ** 2))

    def angle(self, x: float, y: float):
        return np.arctan2(self.y - y, self.x - x)

    def bar(self, x: float, y: float, degrees: float, width: float):
        """An endless bar through (x, y)."""
        turn = np.deg2rad(degrees)
        across = (self.x - x) * np.sin(turn) - (self.y - y) * np.cos(turn)
        return np.abs(across) - width / 2

    def upright(self, x: float, bottom: float, top: float, width: float):
        return np.maximum(np.abs(self.x - x) - width / 2, np.maximum(bottom - self.y, self.y - top))


def disc(height: int, width: int) -> np.ndarray:
    """A disc light on a faint veil behind a few bars."""
    c = Canvas(height, width, 0.04)
    c.paint(c.disc(0.56, 0.6, 0.14), 1.0)
    for x, y, degrees, thick in (
        (0.61, 0.6, 112, 0.03), (0.5, 0.55, 22, 0.035),
        (0.49, 0.6, 75, 0.02), (0.6, 0.68, 155, 0.02),
    ):  # fmt: skip
        c.paint(c.bar(x, y, degrees, thick))
    return c.values


def bars(height: int, width: int) -> np.ndarray:
    """A low sun and its glow behind a fence of uneven bars."""
    c = Canvas(height, width)
    c.values += 0.4 * c.glow(0.38, 0.52, 0.4)
    c.paint(c.disc(0.38, 0.52, 0.14), 1.0)
    for i in range(-4, 14):
        x, thick = 0.16 * i + 0.02 * np.sin(2.4 * i), 0.02 + 0.035 * (i * GOLDEN % 1)
        c.paint(c.bar(x - 0.02, 0.5, 90 + 8 * np.sin(1.7 * i), thick))
    c.paint(c.bar(0.5, 0.36, 1.5, 0.03))
    c.paint(c.bar(0.5, 0.78, -1, 0.03))
    c.paint(c.y - 0.1)
    return c.values


def window(height: int, width: int) -> np.ndarray:
    """An arched window of small panes in a dark wall, brighter towards the sun behind it."""
    c = Canvas(height, width, 0.02)
    arch = np.where(c.y > 0.62, c.disc(0.4, 0.62, 0.24), c.upright(0.4, 0.3, 0.7, 0.48))
    c.paint(arch, 0.25 + 0.75 * c.glow(0.46, 0.6, 0.14))
    for at in (-0.12, 0.0, 0.12):
        c.paint(c.bar(0.4 + at, 0.5, 90, 0.02), 0.02)
        c.paint(c.bar(0.4, 0.54 + at, 0, 0.016), 0.02)
    c.paint(c.bar(0.4, 0.78, 0, 0.016), 0.02)
    return c.values


def trees(height: int, width: int) -> np.ndarray:
    """Trunks and crowns against a bright sky with a sun."""
    c = Canvas(height, width)
    c.values += 0.05 + 0.1 * c.y
    c.paint(c.disc(0.6, 0.7, 0.11), 1.0)
    for i, x in enumerate((-0.28, -0.08, 0.1, 0.29, 0.5, 0.66, 0.9, 1.08, 1.28)):
        lean, thick = 0.04 * np.sin(3.1 * i), 0.016 + 0.016 * (i * GOLDEN % 1)
        c.paint(np.abs(c.x - x - lean * c.y) - thick * (1.2 - c.y))
        for k in range(34):  # leaves on a spiral
            turn, out = 2.4 * k + i, 0.024 * k**0.5
            up = 0.82 + 0.06 * np.sin(2 * i) + 0.8 * out * np.sin(turn)
            c.paint(c.disc(x + lean + out * np.cos(turn), up, 0.008 + 0.016 * (k * GOLDEN % 1)))
    c.paint(c.y - 0.13 - 0.025 * np.sin(5 * c.x) - 0.008 * np.sin(41 * c.x))
    return c.values


def ring(height: int, width: int) -> np.ndarray:
    """A big wheel, dark against a bright sky."""
    c = Canvas(height, width, 1.0)
    for radius in (0.33, 0.28):
        c.paint(np.abs(c.disc(0.5, 0.54, radius)) - 0.012)
    for k in range(16):
        turn = 2 * np.pi * (k + 0.3) / 16
        x, y = 0.5 + 0.33 * np.cos(turn), 0.54 + 0.33 * np.sin(turn)
        c.paint(np.maximum(c.bar(0.5, 0.54, np.rad2deg(turn), 0.01), c.disc(0.5, 0.54, 0.33)))
        c.paint(c.disc(x, y - 0.03, 0.034))
    for degrees in (68, 112):
        c.paint(np.maximum(c.bar(0.5, 0.54, degrees, 0.03), c.y - 0.54))
    c.paint(c.disc(0.5, 0.54, 0.035))
    c.paint(c.y - 0.09 - 0.012 * np.sin(19 * c.x))
    return c.values


def two_lights(height: int, width: int) -> np.ndarray:
    """Two lamps, one larger, behind crossed rods."""
    c = Canvas(height, width, 0.01)
    c.paint(c.disc(0.11, 0.6, 0.15), 1.0)
    c.paint(c.disc(0.95, 0.45, 0.11), 0.8)
    for x, degrees, thick in (
        (0.06, 80, 0.03), (0.17, 112, 0.025), (0.5, 10, 0.035), (0.9, 65, 0.025), (0.99, 100, 0.02)
    ):  # fmt: skip
        c.paint(c.bar(x, 0.53, degrees, thick))
    c.paint(c.bar(0.1, 0.63, 30, 0.02))
    c.paint(c.bar(0.95, 0.47, 140, 0.015))
    return c.values


def skyline(height: int, width: int) -> np.ndarray:
    """Broken cloud and towers; the sun is outside the frame, top left."""
    c = Canvas(height, width)
    c.values += 0.03 + 0.97 * c.glow(-0.02, 1.05, 0.5)
    for k in range(60):  # cloud: small discs in a band that slopes with the sun's side
        along = k * GOLDEN % 1
        c.paint(c.disc(1.1 * along - 0.05, 0.78 + 0.2 * (k / 60) - 0.1 * along,
                       0.012 + 0.03 * (k * k * GOLDEN % 1)))  # fmt: skip
    for i in range(-3, 12):
        thick, top = 0.05 + 0.05 * (i * GOLDEN % 1), 0.12 + 0.3 * (i * i * GOLDEN % 1)
        c.paint(c.upright(0.11 * i, -0.1, top, thick))
        c.paint(c.upright(0.11 * i, -0.1, top + 0.07, 0.012))
    return c.values


def fan(height: int, width: int) -> np.ndarray:
    """A light behind the blades of a fan in a wall."""
    c = Canvas(height, width, 0.015)
    far = c.disc(0.5, 0.5)
    c.paint(far - 0.3, 0.25 + 0.75 * c.glow(0.54, 0.56, 0.16))
    blades = -np.sin(5 * (c.angle(0.5, 0.5) + 1.4 * far)) * far / 5 - 0.01
    c.paint(np.maximum(blades, far - 0.27))
    c.paint(far - 0.055)
    return c.values


def land(c: Canvas):
    """Mountains and three tall rocks: distance to their edge, negative inside."""
    edge = c.y - 0.34
    for height, period, at in ((0.2, 0.52, 0.3), (0.06, 0.17, 0.02), (0.02, 0.061, 0.0)):
        edge = edge - height * np.abs((c.x - at) / period % 1 - 0.5) * 2
    for x, top, slope in ((0.53, 0.64, 0.1), (0.61, 0.6, 0.12), (0.45, 0.61, 0.08)):
        rough = 0.004 * np.sin(70 * c.y + 9 * x) + 0.012 * np.sin(13 * c.y)
        edge = np.minimum(edge, np.abs(c.x - x + rough) - slope * (top - c.y))
    return edge


def peaks(height: int, width: int) -> np.ndarray:
    """A sun setting behind mountains, as the light pass sees it: without the sky."""
    c = Canvas(height, width)
    c.values += 0.4 * c.glow(0.55, 0.56, 0.16)
    c.paint(c.disc(0.55, 0.56, 0.09), 1.0)
    c.paint(land(c))
    return c.values


def dusk(height: int, width: int) -> np.ndarray:
    """The ordinary picture for ``peaks``: an evening sky, the sun and two ranges, in colour."""
    c = Canvas(height, width, [0.0, 0.0, 0.0])
    up = np.clip((c.y - 0.35) / 0.65, 0, 1)[..., None]
    c.values += (1 - up) * [0.45, 0.2, 0.12] + up * [0.05, 0.08, 0.24]
    c.paint(c.disc(0.55, 0.56, 0.09), [0.7, 0.5, 0.25])
    c.paint(land(c), [0.07, 0.055, 0.1])
    near = 0.2 + 0.06 * np.sin(6 * c.x + 1) + 0.02 * np.sin(17 * c.x) + 0.004 * np.sin(90 * c.x)
    c.paint(c.y - near, [0.03, 0.025, 0.045])
    return c.values


def rose(height: int, width: int) -> np.ndarray:
    """A rose window: rings of round panes."""
    c = Canvas(height, width, 0.03)
    c.paint(c.disc(0.5, 0.5, 0.065), 1.0)
    for count, out, radius, value in (
        (8, 0.15, 0.048, 0.9), (12, 0.265, 0.055, 0.6), (24, 0.355, 0.022, 0.8)
    ):  # fmt: skip
        for turn in 2 * np.pi * (np.arange(count) + 0.3) / count:
            c.paint(c.disc(0.5 + out * np.cos(turn), 0.5 + out * np.sin(turn), radius), value)
    return c.values


def glass(height: int, width: int) -> np.ndarray:
    """Leaded glass in warm colours: a pane is what lies nearest to its seed on a spiral."""
    c = Canvas(height, width, [0.02, 0.015, 0.01])
    far = np.stack([
        c.disc(0.5 + 0.058 * k**0.5 * np.cos(2.4 * k), 0.5 + 0.058 * k**0.5 * np.sin(2.4 * k))
        for k in range(40)
    ])  # fmt: skip
    nearest, next_nearest = np.sort(far, axis=0)[:2]
    hues = np.array([[1.0, 0.72, 0.3], [0.95, 0.4, 0.12], [1.0, 0.88, 0.6], [0.75, 0.18, 0.1]])
    light = 0.25 + 0.75 * c.glow(0.56, 0.57, 0.2)[..., None]
    pane = np.maximum(c.disc(0.5, 0.5, 0.33), 0.007 - (next_nearest - nearest) / 2)
    c.paint(pane, hues[np.argmin(far, axis=0) * 7 % 4] * light)
    return c.values


def barn(height: int, width: int) -> np.ndarray:
    """Daylight through the chinks between boards, and through holes in them."""
    c = Canvas(height, width)
    day = 0.25 + 0.75 * c.glow(0.44, 0.58, 0.3)
    for i in range(-3, 8):
        thick = 0.008 + 0.022 * (i * GOLDEN % 1)
        chink = c.bar(0.18 * i - 0.01, 0.5, 90 + 2 * np.sin(2 * i), thick)
        c.paint(np.maximum(chink, np.abs(c.y - 0.5) - 0.42), day)
    c.paint(c.disc(0.44, 0.58, 0.06 * (1 + 0.15 * np.sin(3 * c.angle(0.44, 0.58)))), day)
    for x, y, radius in ((0.6, 0.24, 0.03), (0.26, 0.82, 0.025), (0.8, 0.68, 0.035)):
        c.paint(c.disc(x, y, radius), day)
    c.paint(c.bar(0.5, 0.36, 2, 0.05))
    c.paint(c.bar(0.44, 0.57, 38, 0.012))
    return c.values


def asteroids(height: int, width: int) -> np.ndarray:
    """A white sun among tumbling rocks."""
    c = Canvas(height, width)
    c.values += 0.3 * np.exp(-c.disc(0.64, 0.58) / 0.35)
    c.paint(c.disc(0.64, 0.58, 0.13), 1.0)
    for k in range(1, 80):
        out = 0.09 * k**0.5
        x, y = 0.64 + out * np.cos(2.4 * k + 0.5), 0.58 + out * np.sin(2.4 * k + 0.5)
        rough = 1 + 0.2 * np.sin(2 * c.angle(x, y) + k) + 0.1 * np.sin(5 * c.angle(x, y))
        c.paint(c.disc(x, y, (0.024 + 0.024 * (k * GOLDEN % 1)) * rough))
    return c.values


def _mitchell(*four: float) -> dict[str, float]:
    return dict(zip(("exposure", "decay", "density", "weight"), four, strict=True))


# name: (mask, (height, width), shader, samples, parameters, lights, what it is for, what else).
# three has no decay, density or weight, so none is listed as its truth.
TARGETS = {
    "disc": (disc, (256, 256), "dawntime", 100, _mitchell(0.08, 0.97, 0.9, 0.6), [(0.56, 0.6)],
             "The first example: one light, one channel, every parameter determined.", {}),
    "bars": (bars, (200, 320), "mitchell", 100, _mitchell(0.09, 0.965, 0.85, 0.6), [(0.425, 0.52)],
             "A wide frame and thin bars, nearly along the rays above and below the light.", {}),
    "window": (window, (256, 256), "vesper", 150, _mitchell(0.03, 0.985, 0.75, 0.7), [(0.46, 0.6)],
               "A regular grid: shifted copies of it look alike.", {}),
    "trees": (trees, (256, 320), "article-glsl", 100, _mitchell(0.2, 0.96815, 0.926, 0.58767),
              [(0.58, 0.7)], "Fine leaves and trunks, at the article's own settings.", {}),
    "ring": (ring, (256, 256), "three", 18, {"exposure": 0.95}, [(0.6, 0.68)],
             "Three box passes at fixed steps: exposure and the light are all there is.", {}),
    "two_lights": (two_lights, (192, 288), "mitchell", 80, _mitchell(0.06, 0.97, 0.9, 0.6),
                   [(0.24, 0.6), (0.8, 0.45)], "Two lights share the other parameters.", {}),
    "offscreen": (skyline, (256, 256), "mitchell", 100, _mitchell(0.045, 0.98, 0.85, 0.6),
                  [(-0.12, 1.2)], "The light is outside the frame: only the rays tell where.", {}),
    "halfres": (fan, (256, 256), "dawntime", 200, _mitchell(0.05, 0.985, 0.8, 0.8), [(0.54, 0.56)],
                "The light pass is rendered at half size, stored in 8 bits, and read bilinearly.",
                {"mask_size": (128, 128)}),
    "background": (peaks, (256, 256), "babylon", 100, _mitchell(0.16, 0.975, 0.926, 0.58767),
                   [(0.55, 0.56)], "A composite: 1.1 times a coloured picture, and the light pass.",
                   {"background": dusk}),
    "clipped": (rose, (256, 256), "vesper", 120, _mitchell(0.0535, 0.975, 0.85, 0.8), [(0.5, 0.5)],
                "A tenth of the pixels is clipped at 255.", {}),
    "coloured": (glass, (240, 240), "dawntime", 120, _mitchell(0.08, 0.975, 0.85, 0.6),
                 [(0.56, 0.57)], "Three different channels under one set of parameters.", {}),
    "decay_one": (barn, (256, 256), "mitchell", 100, _mitchell(0.12, 1.0, 1.0, 0.1),
                  [(0.44, 0.58)], "Decay and density are exactly 1, on their bounds.", {}),
    "pmndrs": (asteroids, (216, 384), "pmndrs", 60, _mitchell(0.6, 0.96, 0.96, 0.09),
               [(0.58, 0.58)], "No tap at the pixel itself: only exposure*weight matters.", {}),
}  # fmt: skip

# name: background, seed, quality as a JPEG.
SCREENS = {
    "screen_flat": ("flat", 12, None),
    "screen_smooth": ("smooth", 12, None),
    "screen_textured": ("textured", 4, None),
    "screen_jpeg": ("flat", 1, 90),
}


def to_bytes(values) -> np.ndarray:
    """Values as an 8-bit file holds them: clamped, rounded half up, still from 0 to 1."""
    return np.floor(np.clip(np.asarray(values), 0, 1) * 255 + 0.5) / 255


def enlarge(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(h, w) read bilinearly at the pixel centres of a picture of another size."""
    y, x = ((np.arange(n) + 0.5) * m / n - 0.5 for n, m in zip(size, image.shape, strict=True))
    return np.asarray(bilinear(jnp.asarray(image), *map(jnp.asarray, np.meshgrid(x, y))))


def rendered(model: Mitchell, mask: np.ndarray, background=None) -> np.ndarray:
    """The picture by the reference sum, in float64."""
    # Compiled as one: op by op takes twice as long.
    image = np.asarray(eqx.filter_jit(model)(jnp.asarray(mask), background, method="reference"))
    if image.dtype != np.float64:
        raise RuntimeError("jax: expected 64-bit floats; set jax_enable_x64")
    return image


def stages() -> Iterator[tuple[str, Stage, dict[str, float]]]:
    """All scenes kept: a name, the scene, and the update where it moves."""
    for name, stage in STAGES.items():
        yield f"stage_{name}", stage(), {}
    for name, (stage, _, first, step) in SEQUENCES.items():
        for i in range(FRAMES):
            update = first + i * step
            yield f"{name}_{i}", stage(update), {"update": update}


def render_stage(path: Path, stage: Stage) -> tuple[Scene, np.ndarray, np.ndarray]:
    """Write the scene file; the scene as read from it, its mask and its picture."""
    atomic_write(path, stage.text().encode())
    scene = read_scene(path)
    mask = to_bytes(drawn_mask(scene, stage.antialias).astype(np.float64))
    light = [tuple(light_on_screen(scene).values())]
    model = Mitchell(**stage.params, light=light, shader=stage.shader, samples=stage.samples)
    return scene, mask, rendered(model, mask)


def make_stage(folder: Path, name: str, stage: Stage) -> dict:
    """Write the scene ``name``, its mask, target and side file; its truth."""
    files = {"target": f"{name}.png", "mask": f"{name}_mask.png", "scene": f"{name}.scene.toml"}
    scene, mask, image = render_stage(folder / files["scene"], stage)
    write_image(folder / files["mask"], mask)
    write_image(folder / files["target"], image)
    settings = {"shader": stage.shader, "samples": stage.samples}
    beside = f'scene = "{files["scene"]}"\n\n[scattering]\nshader = "{stage.shader}"\n'
    atomic_write(folder / f"{name}.toml", f"{beside}samples = {stage.samples}\n".encode())
    place = {key: round(value, 9) for key, value in light_on_screen(scene).items()}
    names = ("camera.position", "light.position", "light.radius", *stage.known)
    known = {key: np.asarray(scene.value(key)).tolist() for key in names}
    return files | settings | {"params": stage.params | place, "known": known, "note": stage.note}


def make_gif(file: Path, name: str, frames: int = 48) -> None:
    """Write one lap of the moving scene ``name`` as an animation, twice its size; needs x64."""
    stage, lap, *_ = SEQUENCES[name]
    pictures = []
    with tempfile.TemporaryDirectory() as folder:
        for i in range(frames):
            *_, image = render_stage(Path(folder) / "scene.toml", stage(lap * i / frames))
            height, width = image.shape
            image = enlarge(to_bytes(image), (2 * height, 2 * width))
            pictures.append(np.rint(image * 255).astype(np.uint8))
    duration = 4000 / frames  # in milliseconds, of one frame
    data = imageio.v3.imwrite("<bytes>", np.stack(pictures), extension=".gif", plugin="pillow",
                              mode="L", is_batch=True, duration=duration, loop=0)  # fmt: skip
    assert data is not None
    atomic_write(file, data)


def plane(drawn: np.ndarray, truth: canvases.Truth, rays: int) -> np.ndarray:
    """(h, w, 3) the light of a canvas (h, w, 4) of bytes."""
    values = drawn / 255
    made = canvas(values[..., :3] * values[..., 3:], values[..., 3])
    sky = Sky(truth.sun_angle, truth.sun_width, truth.sun, truth.sky)
    return np.asarray(render(made, sky, rays=rays, exposure=truth.exposure))


def planes() -> Iterator[tuple[str, np.ndarray, canvases.Truth, dict]]:
    """All canvases kept: a name, the bytes, the sky, and what else is to be said."""
    for name, (draw, truth, note) in canvases.CANVASES.items():
        yield name, draw(), truth, {"note": note}
    states = canvases.sand_frames()
    for i, cells in enumerate(states):
        truth = canvases.sand_truth(i, len(states))
        more = {"seed": canvases.SEED, "step": i * canvases.EVERY, "grains": sand.grains(cells)}
        yield f"plane_sand_{i}", canvases.of_sand(cells, 2), truth, more


def make_plane(folder: Path, name: str, drawn: np.ndarray, truth: canvases.Truth) -> dict:
    """Write the canvas ``name``, its target and side file; its truth."""
    files = {"target": f"{name}.png", "canvas": f"{name}_canvas.png"}
    atomic_write(folder / files["canvas"], bytes(imagecodecs.png_encode(drawn)))
    write_image(folder / files["target"], plane(drawn, truth, PLANE_RAYS))
    beside = f'canvas = "{files["canvas"]}"\n\n[scattering]\nmodel = "flatland"\n'
    atomic_write(folder / f"{name}.toml", f"{beside}rays = {PLANE_RAYS}\n".encode())
    params = {
        "exposure": truth.exposure,
        "sun_angle": truth.sun_angle,
        "sun_width": truth.sun_width,
    }
    for key in ("sun", "sky"):
        params |= {f"{key}_{c}": v for c, v in zip("rgb", getattr(truth, key), strict=True)}
    return files | {"rays": PLANE_RAYS, "params": params}


def make_screen(folder: Path, name: str, kind: str, seed: int, quality: int | None) -> dict:
    """Write the screenshot ``name``, as a JPEG of some ``quality`` if given, and its side file; its
    truth."""
    screen = screens.made(seed, kind)
    target = f"{name}.png" if quality is None else f"{name}.jpg"
    if quality is None:
        data = imagecodecs.png_encode(screen.image)
    else:
        data = imagecodecs.jpeg_encode(screen.image, level=quality)
    atomic_write(folder / target, bytes(data))
    params = dict(screen.truth)
    settings = {"shader": screens.SHADER, "samples": params.pop("samples")}
    beside = f'[scattering]\nshader = "{settings["shader"]}"\nsamples = {settings["samples"]}\n'
    atomic_write(folder / f"{name}.toml", beside.encode())
    told = {"panels": screen.panels, "pass_scale": screen.pass_scale, "kind": kind}
    return {"target": target} | settings | {"params": params} | told


def make_sand_gif(file: Path, frames: int = 60) -> None:
    """Write the falling sand and its light as an animation, twice its size; needs x64."""
    pictures = []
    for i, cells in enumerate(canvases.sand_frames(frames, every=10)):
        image = plane(canvases.of_sand(cells, 2), canvases.sand_truth(i, frames), PLANE_RAYS)
        larger = to_bytes(image).repeat(2, 0).repeat(2, 1)
        pictures.append(np.rint(larger * 255).astype(np.uint8))
    data = imageio.v3.imwrite("<bytes>", np.stack(pictures), extension=".gif", plugin="pillow",
                              is_batch=True, duration=80, loop=0)  # fmt: skip
    assert data is not None
    atomic_write(file, data)


def make(folder: Path) -> None:
    """Write every target, its mask, its side file and the manifest to ``folder``; needs x64."""
    truths = {}
    for name, (draw, size, shader, samples, four, lights, note, more) in TARGETS.items():
        files = {"target": f"{name}.png", "mask": f"{name}_mask.png"}
        mask = to_bytes(draw(*more.get("mask_size", size)))
        write_image(folder / files["mask"], mask)
        background = None
        if "background" in more:
            files["background"] = f"{name}_background.png"
            background = to_bytes(more["background"](*size))
            write_image(folder / files["background"], background)
            background = jnp.asarray(background)

        known = _mitchell(1.0, 1.0, 1.0, 1.0) | four
        image = rendered(Mitchell(**known, light=lights, shader=shader, samples=samples), mask,
                         background)  # fmt: skip
        if mask.shape[:2] != size:
            image = enlarge(to_bytes(image), size)
        write_image(folder / files["target"], image)

        beside = [f'{key} = "{files[key]}"' for key in files if key != "target"]
        beside += ["", "[scattering]", f'shader = "{shader}"', f"samples = {samples}"]
        beside += [f"lights = {len(lights)}"] if len(lights) > 1 else []
        atomic_write(folder / f"{name}.toml", ("\n".join(beside) + "\n").encode())
        where = [row.name for row in light_parameters(len(lights))]
        params = four | dict(zip(where, sum(lights, ()), strict=True))
        truth = {"shader": shader, "samples": samples, "params": params, "note": note}
        truths[name] = files | truth
    scenes = {name: make_stage(folder, name, stage) | at for name, stage, at in stages()}
    drawn = {
        name: make_plane(folder, name, values, truth) | more
        for name, values, truth, more in planes()
    }
    shots = {name: make_screen(folder, name, *how) for name, how in SCREENS.items()}
    manifest = {
        "schema": 1, "targets": truths, "scenes": scenes, "canvases": drawn, "screenshots": shots
    }  # fmt: skip
    text = json.dumps(manifest, indent=1) + "\n"
    atomic_write(folder / "manifest.json", text.encode())


def main() -> None:
    parser = argparse.ArgumentParser(description="Draw the synthetic targets.")
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).parent)
    parser.add_argument("--gif", nargs=2, metavar=("FILE", "NAME"),
                        help=f"write one of {', '.join(MOVING)} as an animation")  # fmt: skip
    given = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    if given.gif is None:
        make(given.folder)
        return
    file, name = given.gif
    if name not in MOVING:
        parser.error(f"--gif: expected one of {', '.join(MOVING)}, got '{name}'")
    if name == "sand":
        make_sand_gif(Path(file))
    else:
        make_gif(Path(file), name)


if __name__ == "__main__":
    main()

"""Screenshots as a user has them: the finished composite and nothing else.

A disc light behind one or two objects, a veil, a background that is flat, smooth or textured,
control panels on top, the light pass at full or half resolution, some of it clipped. The light pass
is the project's own; the background under it and the panels over it are painted by formula.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from godfit.io.filters import shrink
from godfit.models.mitchell import Mitchell

BACKGROUNDS = ("flat", "smooth", "textured")
"""Kinds of backgrounds; the place of one is part of its screenshots' seeds."""

SCREENSHOT_SHADER = "dawntime"
"""The convention of the light pass where none is chosen."""

RAYLESS = "rayless"
"""The name of pictures without rays, beside those of the backgrounds."""

OBJECT_KINDS = 4
"""Shapes that ``_object`` can paint."""

OBJECT_KINDS_WITHOUT_GRILLE = 3
"""The same before the disc, whose glare hides the bars of a grille."""


@dataclass(frozen=True, eq=False)
class Screenshot:
    """``image`` (h, w, 3) bytes; ``truth``, the parameters by name; ``panels`` as (x, y, width,
    height) in pixels; ``mask`` (h, w), the occlusion mask, which a user does not have;
    ``pass_scale``, the size of the light pass as a share of the picture's."""

    image: np.ndarray
    truth: dict[str, float]
    panels: tuple[tuple[int, int, int, int], ...]
    mask: np.ndarray
    pass_scale: float


@dataclass(frozen=True, eq=False)
class ClipFrame:
    """What the frames of a clip do not draw at random: the ``light`` (u, v) in texture coordinates,
    and the shader parameters that all frames share, by name. They have no panels."""

    light: np.ndarray
    shared: dict[str, float] | None = None


def make_screenshot(
    seed: int,
    background: str,
    size: tuple[int, int] = (270, 480),
    *,
    shader: str = SCREENSHOT_SHADER,
    frame: ClipFrame | None = None,
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Screenshot:
    """The screenshot of a seed, of ``size`` (h, w) pixels; ``frame``, if it is one of a clip. The
    light pass of every channel is multiplied by its ``tint``."""
    rng = np.random.default_rng([seed, BACKGROUNDS.index(background)])
    h, w = size
    light = rng.uniform(-0.1, 1.1, 2)
    if rng.uniform() < 0.6:
        light = rng.uniform(0.15, 0.85, 2)
    light = light if frame is None else np.asarray(frame.light)
    shared = None if frame is None else frame.shared
    x, y = _picture_heights(size)
    centre = np.array([light[0] * w / h, light[1]])
    radius = rng.uniform(0.05, 0.16)
    solid = np.zeros(size, bool)
    painted = _background(rng, background, size)
    for i in range(rng.integers(1, 3)):
        extent = rng.uniform(0.08, 0.2)
        # The first stands before a part of the disc, the second farther off.
        away = extent + radius * rng.uniform(-0.5, 0.5) if i == 0 else rng.uniform(0.25, 0.6)
        inward = np.arctan2(0.5 - centre[1], w / h / 2 - centre[0]) + rng.uniform(-1, 1)
        turn = rng.uniform(0, 2 * np.pi) if i == 0 and 0 < light.min() < light.max() < 1 else inward
        position = centre + away * np.array([np.cos(turn), np.sin(turn)])
        kinds = OBJECT_KINDS_WITHOUT_GRILLE if i == 0 else OBJECT_KINDS
        shape = _object(rng, x - position[0], y - position[1], extent, kinds)
        painted[shape] = _shaded(rng, x, y)[shape]
        solid |= shape
    veil = rng.uniform(0.02, 0.1)
    disc = np.hypot(x - centre[0], y - centre[1]) < radius
    mask = np.where(solid, 0.0, np.where(disc, 1.0, veil))
    mask = (np.round(255 * mask) / 255).astype(np.float32)
    samples = int(rng.choice([60, 100, 120, 150, 200]))
    truth = {
        "decay": float(rng.uniform(0.05, 0.8) ** (1 / samples)),
        "density": float(rng.uniform(0.5, 1.0)),
        "weight": float(rng.uniform(0.4, 1.0)),
        "light_x": float(light[0]),
        "light_y": float(light[1]),
        "samples": samples,
        "radius": float(radius),
        "veil": round(255 * veil) / 255,
    }
    clipped_share = rng.uniform(0.002, 0.1)
    if shared is not None:
        truth |= shared
    scale = float(rng.choice([1.0, 0.5]))
    pass_mask = mask if scale == 1 else shrink(mask, (h // 2, w // 2))
    unit = _light_pass(pass_mask, size, truth | {"exposure": 1.0}, shader, clamp=False)
    clipping_exposure = ((1 - painted) / tint).min(-1) / np.maximum(unit, 1e-6)
    # A share of the picture is clipped, as people set the exposure.
    exposure = float(np.quantile(clipping_exposure, clipped_share))
    while np.mean(clipping_exposure < 1.02 * exposure) > clipped_share + 0.01:
        # All of a flat background would clip at once: the exposure stays below that.
        exposure *= 0.97
    truth["exposure"] = exposure if shared is None else shared["exposure"]
    light_pass = _light_pass(pass_mask, size, truth, shader, clamp=scale != 1)
    levels = np.floor(255 * np.clip(painted, 0, 1) + 0.5) + np.floor(
        255 * np.clip(light_pass[..., None] * tint, 0, 1) + 0.5
    )
    image = np.clip(levels, 0, 255).astype(np.uint8)
    panels = _paint_panels(rng, image, centre * h) if frame is None else ()
    return Screenshot(image, truth, panels, mask, scale)


def without_rays(seed: int, size: tuple[int, int] = (270, 480)) -> tuple[str, np.ndarray]:
    """(subject, (h, w, 3) bytes) a picture without rays: a game's frame before its light pass, a
    landscape with a sun, clouds, a page of text, or noise."""
    rng = np.random.default_rng([seed, len(BACKGROUNDS)])
    subject = list(SUBJECTS)[seed % len(SUBJECTS)]
    image = SUBJECTS[subject](rng, size)
    return subject, np.floor(255 * np.clip(image, 0, 1) + 0.5).astype(np.uint8)


def _scene(rng: np.random.Generator, size: tuple[int, int]) -> np.ndarray:
    x, y = _picture_heights(size)
    image = _background(rng, str(rng.choice(BACKGROUNDS)), size)
    for _ in range(rng.integers(2, 6)):
        position = rng.uniform(0, (size[1] / size[0], 1))
        extent = rng.uniform(0.05, 0.25)
        shape = _object(rng, x - position[0], y - position[1], extent, OBJECT_KINDS)
        image[shape] = _shaded(rng, x, y)[shape]
    return image


def _land(rng: np.random.Generator, size: tuple[int, int]) -> np.ndarray:
    x, y = _picture_heights(size)
    sky = rng.uniform(0.2, 0.7, 3) + (y[..., None] - 0.5) * rng.uniform(-0.4, 0.4, 3)
    sun = np.hypot(x - rng.uniform(0.2, x.max() - 0.2), y - rng.uniform(0.5, 0.9))
    sky = np.where((sun < rng.uniform(0.02, 0.08))[..., None], 1.0, sky)
    ridge = 0.35 + 0.1 * np.sin(x * rng.uniform(2, 5) + rng.uniform(0, 6.3))
    ridge = ridge + 0.03 * _power_law_noise(rng, size, 2.0)[:1]
    ground = rng.uniform(0.05, 0.4, 3) * (1 + 0.4 * _power_law_noise(rng, size, 1.2)[..., None])
    return np.where((y < ridge)[..., None], ground, sky)


def _cloud(rng: np.random.Generator, size: tuple[int, int]) -> np.ndarray:
    noise = _power_law_noise(rng, size, rng.uniform(1.0, 2.0))[..., None]
    return rng.uniform(0.2, 0.6, 3) + noise * rng.uniform(0.05, 0.2, 3)


def _text(rng: np.random.Generator, size: tuple[int, int]) -> np.ndarray:
    h, w = size
    paper, ink = rng.permutation([rng.uniform(0.0, 0.3), rng.uniform(0.6, 1.0)])
    page, line = np.full(size, paper), int(rng.integers(9, 16))
    dot = line // 5
    for top in range(line, h - line, line):
        left = int(rng.integers(8, 30))
        while left < w - 2 * line:
            if rng.uniform() < 0.2:
                left += line // 2
            letter = np.kron(rng.uniform(size=(3, 2)) < 0.6, np.ones((dot, dot), bool))
            page[top : top + 3 * dot, left : left + 2 * dot][letter] = ink
            left += 2 * dot + 2
    return page[..., None] * rng.uniform(0.8, 1.0, 3)


def _noise(rng: np.random.Generator, size: tuple[int, int]) -> np.ndarray:
    sigma = rng.uniform(0, 1.5)
    noise = ndimage.gaussian_filter(rng.standard_normal((*size, 3)), (sigma, sigma, 0))
    return rng.uniform(0.3, 0.6) + rng.uniform(0.02, 0.15) * noise / np.std(noise)


SUBJECTS = {"scene": _scene, "land": _land, "cloud": _cloud, "text": _text, "noise": _noise}
"""Painters of pictures without rays, (rng, size) -> (h, w, 3), by subject."""


def _power_law_noise(
    rng: np.random.Generator, size: tuple[int, int], exponent: float
) -> np.ndarray:
    """(h, w) noise of standard deviation 1 whose amplitude is 1 / frequency**exponent."""
    down, across = np.fft.fftfreq(size[0])[:, None], np.fft.rfftfreq(size[1])[None]
    frequency = np.hypot(down, across)
    frequency[0, 0] = np.inf
    wave = np.fft.rfft2(rng.standard_normal(size)) * frequency**-exponent
    noise = np.fft.irfft2(wave, s=size)
    return noise / noise.std()


def _light_pass(mask, size, truth, shader, *, clamp):
    """(h, w) the light pass of ``size``, from a mask of that size or of half of it.

    With ``clamp`` a smaller pass is stored clamped and then enlarged, as shaders have it. Without,
    the mask is enlarged instead: the exposure, on which clamping depends, is not known yet.
    """
    model = Mitchell(
        truth["exposure"], truth["decay"], truth["density"], truth["weight"],
        [[truth["light_x"], truth["light_y"]]], shader, int(truth["samples"]),
    )  # fmt: skip
    if not clamp and mask.shape != size:
        mask = np.kron(mask, np.ones((2, 2), np.float32))[: size[0], : size[1]]
        mask = np.pad(mask, [(0, n - m) for n, m in zip(size, mask.shape, strict=True)], "edge")
    return np.asarray(model(jnp.asarray(mask), size=size))


def _picture_heights(size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """(h, w) x to the right and y up, in picture heights, at the pixels' middles."""
    h, w = size
    return np.meshgrid((np.arange(w) + 0.5) / h, 1 - (np.arange(h) + 0.5) / h)


def _background(rng: np.random.Generator, kind: str, size: tuple[int, int]) -> np.ndarray:
    """(h, w, 3) the ordinary pass without objects."""
    x, y = _picture_heights(size)
    colour = rng.uniform(0, 0.45, 3)
    if kind == "flat":
        return np.broadcast_to(np.where(rng.uniform() < 0.2, 0.0, colour), (*size, 3)).copy()
    other = np.clip(colour + rng.uniform(-0.25, 0.25, 3), 0, 0.5)
    turn = rng.uniform(0, 2 * np.pi)
    along = (x - x.mean()) * np.cos(turn) + (y - 0.5) * np.sin(turn)
    along = (along - along.min()) / np.ptp(along)
    field = colour + (other - colour) * (along ** rng.uniform(0.7, 1.6))[..., None]
    if kind == "smooth":
        return field
    noise = sum(ndimage.gaussian_filter(rng.standard_normal(size), s) * s for s in (1.0, 2.5, 6.0))
    cells = np.sin(x * rng.uniform(20, 60)) * np.sin(y * rng.uniform(20, 60))
    texture = 0.02 * noise / np.std(noise) + 0.02 * np.sign(cells)
    return np.clip(field + texture[..., None] * rng.uniform(0.5, 1.5, 3), 0, 1)


def _object(rng: np.random.Generator, x, y, radius: float, kinds: int) -> np.ndarray:
    """(h, w) True inside one of the first ``kinds``: star, ellipse with a hole, box, grille."""
    turn = rng.uniform(0, np.pi)
    along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    kind = rng.integers(kinds)
    if kind == 0:
        angle = np.arctan2(y, x)
        waves = sum(
            rng.uniform(0, 0.25) * np.cos(k * angle + rng.uniform(0, 6.3)) for k in (2, 3, 5)
        )
        return np.hypot(x, y) < radius * (1 + waves)
    if kind == 1:
        outer = np.hypot(along / radius, across / (radius * rng.uniform(0.5, 1)))
        return (outer < 1) & (np.hypot(along + 0.4 * radius, across) > rng.uniform(0, 0.3) * radius)
    if kind == 2:
        return np.maximum(np.abs(along), 1.6 * np.abs(across)) < radius
    bars = np.abs((across / radius * 3) % 1 - 0.5) < rng.uniform(0.2, 0.35)
    rim = np.maximum(np.abs(along), np.abs(across)) > 0.85 * radius
    return (bars | rim) & (np.maximum(np.abs(along), np.abs(across)) < radius)


def _shaded(rng: np.random.Generator, x, y) -> np.ndarray:
    """(h, w, 3) a surface: a colour, lit from one side, with some grain."""
    turn = rng.uniform(0, 2 * np.pi)
    lit = 1 + 0.5 * np.sin(6 * (x * np.cos(turn) + y * np.sin(turn)) + rng.uniform(0, 6.3))
    grain = 1 + 0.1 * ndimage.gaussian_filter(rng.standard_normal(x.shape), 1)
    return rng.uniform(0.0, 0.4, 3) * (lit * grain)[..., None]


def _paint_panels(rng: np.random.Generator, image: np.ndarray, light: np.ndarray):
    """Paint a panel into ``image``, away from the light (in pixels), of up to 15% of the picture;
    the panels."""
    h, w = image.shape[:2]
    share = rng.uniform(0, 0.15)
    width = int(w * rng.uniform(0.12, 0.3))
    height = min(int(share * h * w / width), h)
    if height < 12:
        return ()
    left = 0 if light[0] > w / 2 else w - width
    top = 0 if rng.uniform() < 0.5 else h - height
    image[top : top + height, left : left + width] = rng.integers(15, 60)
    for row in range(top + 3, top + height - 6, 10):
        image[row : row + 5, left + 4 : left + 4 + int(width * rng.uniform(0.2, 0.5))] = 200
        image[row - 1 : row + 6, left + int(0.6 * width) : left + int(0.9 * width)] = (47, 161, 214)
    return ((left, top, width, height),)

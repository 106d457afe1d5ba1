"""Imitations of photographs: a bright sky behind dark trees, and rays of all that is bright in it.

The occlusion mask is a soft bright-pass of the ordinary pass (Mitchell, GPU Gems 3, section 13.4,
draws it; post effects that have no scene take it from the picture). A user does not have it. The
light pass is the project's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from godfit.models.mitchell import Mitchell
from godfit.scattering.conventions.convention import LUMA

PHOTOGRAPH_SHADER = "dawntime"
"""The convention of the light pass."""

STREAM = 7
"""Makes the random numbers differ from those of other pictures of the same seed."""


@dataclass(frozen=True, eq=False)
class Photograph:
    """``image`` (h, w, 3) bytes; ``truth``, the parameters by name; ``mask`` (h, w), the occlusion
    mask."""

    image: np.ndarray
    truth: dict[str, float]
    mask: np.ndarray


def make_photograph(
    seed: int, size: tuple[int, int] = (270, 480), texture: float = 1.0
) -> Photograph:
    """The photograph of a seed, of ``size`` (h, w) pixels; ``texture`` is the standard deviation of
    dark surfaces in levels."""
    rng = np.random.default_rng([seed, STREAM])
    h, w = size
    x, y = np.meshgrid((np.arange(w) + 0.5) / h, 1 - (np.arange(h) + 0.5) / h)
    light = rng.uniform((0.2, 0.55), (0.8, 0.95))
    distance = np.hypot(x - light[0] * w / h, y - light[1])
    glow = np.exp(-((distance / rng.uniform(0.1, 0.3)) ** 2))[..., None]
    sky = rng.uniform(0.45, 0.75, 3)
    sky = sky + (0.98 - sky) * (0.9 * glow + 0.1 * (1 - y[..., None]))
    dark = _ground(rng, x, y) | _trees(rng, x, y, w / h)
    grain = ndimage.gaussian_filter(rng.standard_normal(size), 1)
    shade = rng.uniform(0.02, 0.15, 3) * (1 + 0.3 * (y[..., None] - 0.5))
    shade = shade + texture / 255 * (grain / grain.std())[..., None]
    scene = np.round(255 * np.clip(np.where(dark[..., None], shade, sky), 0, 1)) / 255
    truth = {
        "threshold": float(rng.uniform(0.35, 0.7)),
        "softness": float(rng.uniform(0.01, 0.06)),
        "density": float(rng.uniform(0.5, 1.0)),
        "weight": float(rng.uniform(0.4, 1.0)),
        "light_x": float(light[0]),
        "light_y": float(light[1]),
        "samples": int(rng.choice([60, 100, 150])),
    }
    truth["decay"] = float(rng.uniform(0.05, 0.8) ** (1 / truth["samples"]))
    soft = (scene @ np.array(LUMA, scene.dtype) - truth["threshold"]) / truth["softness"]
    mask = (1 / (1 + np.exp(-soft))).astype(np.float32)
    unit = _light_pass(mask, truth | {"exposure": 1.0})
    # The rays are as bright as haze, so that dark surfaces stay dark.
    truth["exposure"] = float(rng.uniform(0.15, 0.4) / np.quantile(unit[dark], 0.95))
    lit = scene + np.clip(_light_pass(mask, truth), 0, 1)[..., None]
    return Photograph(np.floor(255 * np.clip(lit, 0, 1) + 0.5).astype(np.uint8), truth, mask)


def _ground(rng: np.random.Generator, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(h, w) True below a ridge."""
    waves = sum(
        rng.uniform(0, 0.03) * np.sin(k * x + rng.uniform(0, 6.3)) for k in (2.0, 5.0, 11.0)
    )
    return y < rng.uniform(0.15, 0.4) + waves


def _trees(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, aspect: float) -> np.ndarray:
    """(h, w) True on trunks and in crowns, in which there are holes."""
    dark = np.zeros(x.shape, bool)
    for trunk in rng.uniform(0, aspect, rng.integers(4, 9)):
        height, half_width = rng.uniform(0.5, 1.0), rng.uniform(0.008, 0.025)
        dark |= (np.abs(x - trunk - 0.05 * np.sin(3 * y + trunk)) < half_width) & (y < height)
        crown = rng.uniform(0.08, 0.2)
        leaves = ndimage.gaussian_filter(rng.standard_normal(x.shape), 4)
        inside = np.hypot(x - trunk, (y - height) / 0.8) < crown
        dark |= inside & (leaves > -0.3 * leaves.std())
    return dark


def _light_pass(mask: np.ndarray, truth: dict[str, float]) -> np.ndarray:
    """(h, w) the light pass of a mask (h, w), linear."""
    model = Mitchell(
        truth["exposure"], truth["decay"], truth["density"], truth["weight"],
        [[truth["light_x"], truth["light_y"]]], PHOTOGRAPH_SHADER, int(truth["samples"]),
    )  # fmt: skip
    return np.asarray(model(jnp.asarray(mask), size=mask.shape))

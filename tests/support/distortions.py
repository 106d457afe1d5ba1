"""Frames that something was done to that the fit does not account for, each with what its hint
says. A strength is part of the name where there are two."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import ndimage

from tests.support import random_targets

SAMPLES = 60
SAYS = {
    "vertical": "--flip vertical",
    "horizontal": "--flip horizontal",
    "both": "--flip both",
    "srgb": "--transfer srgb",
    "reinhard": "--transfer reinhard",
    "reinhard strong": "--transfer reinhard",
    "aces": "--transfer aces",
    "filmic": "--transfer filmic",
    "border": "--border black",
    "blur 1": "blurred",
    "blur 2": "blurred",
    "jitter": "jittered",
    "nearest 2": "2x2 blocks",
    "nearest 3": "3x3 blocks",
    "tint warm": "--tint",
    "tint cold": "--tint",
    "samples few": "--samples 8",
    "samples many": "--samples 120",
    "rounded": "rounded",
    "background": "background",
}
"""What the hint about each distortion says."""
OPTIONS: dict[str, dict[str, Any]] = {
    **{name: {"flip": name} for name in ("vertical", "horizontal", "both")},
    **{name: {"transfer": name} for name in ("srgb", "reinhard", "aces", "filmic")},
    "reinhard strong": {"transfer": "reinhard"},
    "border": {"border": "black"},
    **{name: {"tint": True} for name in ("tint warm", "tint cold")},
    "samples few": {"samples": 8},
    "samples many": {"samples": 120},
}
"""The option that a hint names, where it names one."""


def srgb(x: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1, from its formula."""
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)


def hable(x: np.ndarray) -> np.ndarray:
    """Hable's curve, from the listing of his slides."""
    a, b, c, d, e, f = 0.15, 0.5, 0.1, 0.2, 0.02, 0.3
    return (x * (a * x + c * b) + d * e) / (x * (a * x + b) + d * f) - e / f


def aces(x: np.ndarray) -> np.ndarray:
    """Narkowicz's curve."""
    return x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)


def frame(seed: int, size: int, samples: int = SAMPLES) -> tuple[np.ndarray, dict[str, float]]:
    """A mask as bytes and a truth whose light is near the left edge."""
    rng = np.random.default_rng([seed, 61])
    kind = list(random_targets.MASKS)[seed % len(random_targets.MASKS)]
    light = np.array([rng.uniform(0.05, 0.3), rng.uniform(0.55, 0.9)])
    mask = random_targets.MASKS[kind](rng, size, light)
    mask = np.floor(mask * 255 + 0.5).clip(0, 255).astype(np.uint8)
    truth = {
        "decay": float(rng.uniform(0.1, 0.4) ** (1 / samples)),
        "density": float(rng.uniform(0.7, 0.95)),
        "weight": float(rng.uniform(0.4, 0.8)),
        "light_x": float(light[0]), "light_y": float(light[1]),
        "samples": samples, "exposure": 1.0,
    }  # fmt: skip
    image = random_targets.render64(mask / 255, truth)
    truth["exposure"] = float(0.9 / max(np.quantile(image, 0.99), 1e-6))
    return mask, truth


def _rays(mask, truth, mode="nearest", jitter=None):
    """Dawntime's sum in float64 with another border or jittered taps."""
    h, w = mask.shape
    rows, columns = np.mgrid[:h, :w].astype(np.float64)
    place = truth["light_x"] * w - 0.5, (1 - truth["light_y"]) * h - 0.5
    out, n = mask.astype(np.float64), int(truth["samples"])
    for i in range(1, n):
        t = (i - (0 if jitter is None else jitter)) * truth["density"] / n
        at = [rows + t * (place[1] - rows), columns + t * (place[0] - columns)]
        read = ndimage.map_coordinates(mask, at, order=1, mode=mode)
        out += truth["weight"] * truth["decay"] ** i * read
    return truth["exposure"] * out


def made(kind: str, seed: int, size: int) -> tuple[np.ndarray, dict[str, Any], dict[str, float]]:
    """A target, what the fit is given, and the truth."""
    samples = {"samples few": 8, "samples many": 120}.get(kind, SAMPLES)
    mask, truth = frame(seed, size, samples)
    given: dict[str, Any] = {
        "mask": mask, "shader": "dawntime", "samples": SAMPLES, "pass_scale": 1.0,
    }  # fmt: skip
    unit = mask / 255
    image = random_targets.render64(unit, truth)
    axes = {"vertical": 0, "horizontal": 1, "both": (0, 1)}
    curves = {
        "srgb": srgb, "reinhard": lambda x: x / (1 + x), "aces": aces,
        "reinhard strong": lambda x: 4 * x / (1 + 4 * x),
        "filmic": lambda x: hable(2 * x) / hable(np.array(11.2)),
    }  # fmt: skip
    if kind in axes:
        image = np.flip(image, axes[kind])
    elif kind in curves:
        image = curves[kind](image)
    elif kind == "border":
        truth["light_x"] = -0.4
        image = _rays(unit, truth, "grid-constant")
        image *= 0.9 / np.quantile(image, 0.99)
    elif kind.startswith("blur"):
        image = ndimage.gaussian_filter(image, float(kind[-1]), mode="nearest")
    elif kind == "jitter":
        image = _rays(unit, truth, jitter=np.random.default_rng(seed).random(mask.shape))
    elif kind.startswith("nearest"):
        side = int(kind[-1])
        low = size // side
        small = unit[: low * side, : low * side].reshape(low, side, low, side).mean((1, 3))
        image = random_targets.render64(small, truth).repeat(side, 0).repeat(side, 1)
        given["mask"] = mask[: low * side, : low * side]
    elif kind.startswith("tint"):
        colour = (1.0, 0.82, 0.55) if kind == "tint warm" else (0.35, 0.7, 1.0)
        image = image[..., None] * np.array(colour)
    elif kind == "rounded":
        # A pass of half the exposure in bytes, doubled where it is added.
        image = 2 * np.floor(image / 2 * 255 + 0.5) / 255 * 0.93
    elif kind == "background":
        noise = ndimage.gaussian_filter(np.random.default_rng(seed).random((size, size)), 3)
        back = 0.3 * (noise - noise.min()) / np.ptp(noise)
        given["background"] = random_targets.to_bytes(back)
        image = 0.6 * image + 1.1 * given["background"] / 255
    return random_targets.to_bytes(image), given, truth

"""Random targets with one defect that the fit does not account for, and what a warning about each
defect says."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

import godfit
from tests.support import random_targets

SAMPLES = 40
# What a warning about each defect says.
SAYS = {
    "transfer": "gamma-encoded",
    "register": "shifted",
    "upsampled": "rendered at",
    "convention": "another shader",
    "light": "second light",
    "background": "background was clipped",
    "jpeg": "JPEG",
}


def truth_and_mask(seed: int, size: int):
    """A mask as bytes, a truth with a light in the frame, and the random numbers that follow."""
    rng = np.random.default_rng([seed, 6])
    kind = list(random_targets.MASKS)[seed % len(random_targets.MASKS)]
    light = rng.uniform(0.1, 0.9, 2)
    mask = (
        np.floor(random_targets.MASKS[kind](rng, size, light) * 255 + 0.5)
        .clip(0, 255)
        .astype(np.uint8)
    )
    truth = {
        "decay": float(rng.uniform(0.02, 0.7) ** (1 / SAMPLES)),
        "density": float(rng.uniform(0.5, 1.0)),
        "weight": float(rng.uniform(0.2, 1.0)),
        "light_x": float(light[0]),
        "light_y": float(light[1]),
        "samples": SAMPLES,
        "exposure": 1.0,
    }
    exposed(mask, truth, rng.uniform(0.6, 0.95))
    return mask, truth, rng


def exposed(mask: np.ndarray, truth: dict[str, float], top: float) -> None:
    """Set the truth's exposure so that its 98th percentile is at ``top``."""
    truth["exposure"] = 1.0
    truth["exposure"] = float(
        top / max(np.quantile(random_targets.render64(mask / 255, truth), 0.98), 1e-6)
    )


def made(kind: str, seed: int, size: int) -> tuple[np.ndarray, dict]:
    """A target with a defect, and what the fit is given."""
    mask, truth, rng = truth_and_mask(seed, size)
    given = {"mask": mask, "shader": "dawntime", "samples": SAMPLES}
    image = random_targets.render64(mask / 255, truth)
    if kind == "clean":
        return random_targets.to_bytes(image, float(seed % 2), seed), given
    if kind == "transfer":
        return random_targets.to_bytes(np.maximum(image, 0) ** (1 / 2.2)), given
    if kind == "register":
        shift = rng.choice([-1, 1], 2) * rng.uniform(1, 4, 2)
        given["mask"] = np.roll(mask, np.round(shift).astype(int), (0, 1))
        return random_targets.to_bytes(image), given
    if kind == "upsampled":
        given["pass_scale"] = 1.0
        low = mask.reshape(size // 2, 2, size // 2, 2).mean((1, 3)) / 255
        return random_targets.to_bytes(
            random_targets.enlarged(random_targets.render64(low, truth), size)
        ), given
    if kind == "convention":
        given["shader"] = "pmndrs"
        return random_targets.to_bytes(image), given
    if kind == "light":
        other = truth | {"light_x": (truth["light_x"] + 0.5) % 1, "light_y": rng.uniform(0.1, 0.9)}
        both = image + 0.6 * random_targets.render64(mask / 255, other)
        return random_targets.to_bytes(both / 1.6), given
    if kind == "background":
        noise = ndimage.gaussian_filter(rng.standard_normal((size, size)), size / 16)
        back = np.clip(0.75 + 0.35 * noise / noise.std(), 0, None)
        # An image of floats is not clipped where the background's bytes are.
        target = (0.5 * image + back).astype(np.float32)
        return target, given | {"background": random_targets.to_bytes(back)}
    return random_targets.encoded(random_targets.to_bytes(image), int(rng.integers(60, 96))), given


def warned(kind: str, seed: int, size: int) -> godfit.FitResult:
    target, given = made(kind, seed, size)
    return godfit.fit(target, **given)

"""Random truths on each rung of the ladder of `godfit select`: what is above the rung is as the
rung holds it."""

from __future__ import annotations

import numpy as np

from tests.support import random_targets

SHADER, SAMPLES = "dawntime", 100
DEFAULTS = {"decay": 0.99, "density": 0.8, "weight": 0.8, "light_x": 0.5, "light_y": 0.5}
RUNGS = (
    "veil", "shader defaults", "+ light", "+ attenuation", "+ density", "+ own pixel",
    "+ samples", "+ second light", "+ colour",
)  # fmt: skip
OTHER_SAMPLES = (40, 64, 140)


def draw(seed: int, rung: str, size: int):
    """(mask as bytes, image unclamped) of a truth on ``rung``."""
    rng = np.random.default_rng([seed, RUNGS.index(rung)])
    level = RUNGS.index(rung)
    truth = dict(DEFAULTS) | {"samples": SAMPLES, "exposure": 1.0}
    if level >= 2:
        truth |= {"light_x": float(rng.uniform(0.1, 0.9)), "light_y": float(rng.uniform(0.1, 0.9))}
    if level >= 3:
        truth["decay"] = float(rng.choice([rng.uniform(0.95, 0.985), rng.uniform(0.993, 0.999)]))
    if level >= 4:
        truth["density"] = float(rng.choice([rng.uniform(0.4, 0.75), rng.uniform(0.85, 1)]))
    if level >= 5:
        truth["weight"] = float(rng.choice([rng.uniform(0.2, 0.6), rng.uniform(1, 1.5)]))
    if rung == "+ samples":
        truth["samples"] = int(rng.choice(OTHER_SAMPLES))
    kind = list(random_targets.MASKS)[int(rng.integers(len(random_targets.MASKS)))]
    light = np.array([truth["light_x"], truth["light_y"]])
    mask = (
        np.floor(random_targets.MASKS[kind](rng, size, light) * 255 + 0.5)
        .clip(0, 255)
        .astype(np.uint8)
    )
    if rung == "veil":
        return mask, np.full((size, size), rng.uniform(0.05, 0.9))
    image = random_targets.render64(mask / 255, truth)
    if rung == "+ second light":
        away = rng.uniform(0.25, 0.5) * np.array([np.cos(t := rng.uniform(0, 6.3)), np.sin(t)])
        other = np.clip(light + away, 0, 1)
        second = truth | {"light_x": float(other[0]), "light_y": float(other[1])}
        image = image + random_targets.render64(mask / 255, second)
    image = image * (rng.uniform(0.7, 1.1) / np.quantile(image, 0.98))
    if rung == "+ colour":
        image = image[..., None] * rng.uniform(0.4, 1, 3)
    return mask, image

"""Random truths of every convention: targets of bytes rendered by loops over its formula, in
float64, and how far a fit ends from them."""

from __future__ import annotations

from typing import NamedTuple

import jax
import numpy as np

import godfit
from godfit.scattering.conventions import CONVENTIONS
from tests.support import convention_oracle, random_targets

SIZE = 128
BRIGHT = 0.98
"""Quantile of a picture's levels that is exposed to about the top of the scale."""
LIKE_A_HUNDRED = 5.0
"""Quoted errors within which a parameter is found."""
RESOLVED = {"decay": 5e-5, "density": 5e-4, "light_x": 3e-4, "light_y": 3e-4}
"""Errors that count as found whatever the quoted ones are: where only rounding limits a fit, these
are below what bytes resolve. Exposures are relative."""
RESOLVED_SHARE = 1e-3
SAMPLES = {"sun-beams": 200, "glsl-godrays": 60}
"""Samples of the truths, where they are not 40."""
BLENDED = ("moonshine", "godot4", "jmonkey")
"""Conventions whose pass needs the background."""


class Attempt(NamedTuple):
    """A fit of a truth: whether it converged, and the errors over quoted errors by parameter."""

    converged: bool
    scores: dict[str, float]
    message: str

    @property
    def found(self) -> bool:
        return all(score <= LIKE_A_HUNDRED for score in self.scores.values())


def determined(shader: str) -> tuple[str, ...]:
    """What a picture determines of a convention: parameters, or ``exposure*weight``."""
    names = list(CONVENTIONS[shader].parameters)
    if CONVENTIONS[shader].product_open:
        names = ["exposure*weight", *(n for n in names if n not in ("exposure", "weight"))]
    return (*names, "light_x", "light_y")


def draw(shader: str, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, dict]:
    """(target bytes, mask bytes, background bytes or None, truth by name) for a seed."""
    own = CONVENTIONS[shader]
    rng = np.random.default_rng([seed, list(CONVENTIONS).index(shader)])
    kind = list(random_targets.MASKS)[seed % len(random_targets.MASKS)]
    light = rng.uniform(0.1, 0.9, 2)
    mask = random_targets.MASKS[kind](rng, SIZE, light)
    mask = np.floor(mask * 255 + 0.5).clip(0, 255).astype(np.uint8)
    n = SAMPLES.get(shader, 40)
    truth = {
        "exposure": 1.0,
        "decay": float(rng.uniform(0.01, 0.8) ** (1 / n)),
        "density": float(rng.uniform(0.4, 1.0)),
        "weight": float(rng.uniform(0.2, 1.0)),
        **own.absent,
        "samples": n,
        "light": light,
    }
    if shader == "panda3d":
        truth["density"] = float(rng.uniform(0.4, 1.9))
    if shader in ("sun-shafts", "sun-beams"):
        truth["density"] *= 0.5
    back = None
    if shader in BLENDED:
        colour = rng.uniform(0.2, 0.7, 3)
        back = np.floor((0.3 + mask[..., None] / 255 * colour).clip(0, 1) * 255).astype(np.uint8)
        mask = back if shader != "godot4" else mask
    read = mask / 255
    one = convention_oracle.LIGHT_PASSES[shader]
    if read.ndim == 3:
        light_pass = np.stack([one(read[..., c], truth) for c in range(3)], -1)
    else:
        light_pass = one(read, truth)
    truth["exposure"] = exposure = exposed(shader, light_pass, rng)
    if shader in ("radial-blur", "reshade"):
        light_pass = one(read, truth)
    elif shader != "jmonkey":
        light_pass = exposure * light_pass
    picture = light_pass
    if back is not None:
        light_pass = np.broadcast_to(np.atleast_3d(light_pass), back.shape)
        picture = convention_oracle.composite(shader, light_pass, back / 255, exposure)
    return random_targets.to_bytes(picture), mask, back, truth


def exposed(shader: str, light_pass: np.ndarray, rng: np.random.Generator) -> float:
    """An exposure with which few pixels of a light pass of exposure 1 clip."""
    if shader == "reshade":
        return float(rng.uniform(0.05, 0.3))
    bright = {"moonshine": 0.4, "jmonkey": 1.0, "godot4": 1.0}.get(shader, 0.9)
    if shader == "jmonkey":
        return float(rng.uniform(0.3, 1.0))
    return float(rng.uniform(0.7, 1.1) * bright / max(np.quantile(light_pass, BRIGHT), 1e-3))


def attempt(shader: str, seed: int) -> Attempt:
    """The fit of a truth, without a start."""
    target, mask, back, truth = draw(shader, seed)
    with jax.enable_x64(False):
        result = godfit.fit(
            target, mask=mask, background=back, shader=shader, samples=truth["samples"],
            pass_scale=1.0,
        )  # fmt: skip
    truth |= {"light_x": truth["light"][0], "light_y": truth["light"][1]}
    truth["exposure*weight"] = truth["exposure"] * truth["weight"]
    scores = {}
    for name in determined(shader):
        estimate = result.combined.get(name) or result.params.get(name)
        if estimate is None or estimate.stderr is None:
            scores[name] = float("inf")
            continue
        error = abs(estimate.value - truth[name])
        if error <= RESOLVED.get(name, RESOLVED_SHARE * abs(truth[name])):
            error = min(error, LIKE_A_HUNDRED * estimate.stderr)
        scores[name] = error / estimate.stderr if estimate.stderr else float(error > 0) * np.inf
    return Attempt(result.converged, scores, result.message)

"""Two screenshots without a mask: what the light pass between them says of light and mask.

The light pass is known wherever nothing clips. What the ordinary pass shows of the objects gives
light, attenuation, density and the light's disc; under these each texel of the mask is solved for
in turn.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from godfit.blind.light_pass import LightPass
from godfit.blind.pair_mask import TexelLight, mask_under, texels_of
from godfit.blind.pair_scene import Place, Scene, in_levels, scene_places
from godfit.errors import InputError
from godfit.io.image import LEVELS
from godfit.models.mitchell import Mitchell

FAINTEST_PASS = 3.0
"""Levels that a light pass must span: below, two screenshots differ by rounding alone."""
FEWEST_KNOWN = 0.1
"""Share of the picture in which the light pass must be known."""
EXPLAINS = -0.3
"""Cost for each pair of pixels below which a light explains the light pass: of 14 real pairs all
whose light was found have less, and one whose light was 1.6% of the picture off has more."""
NOT_ONE_LIGHT = (
    "no single light explains what the two screenshots differ by: another tone curve, several "
    "lights or a camera that moved"
)
TOO_FEW = (
    "background: expected two screenshots with some pixels that are neither clipped nor ignored, "
    "got too few; lower the exposure for both"
)
MIDDLE_OWN = 1.8
"""The own pixel's weight times the number of taps to begin with, 1 over a shader's weight: the
middle of what sliders give, which end at 1."""
PLAIN_WEIGHT = 1.0
"""Weight of a shader without the pixel's own value: only its product with exposure has an
effect."""


@dataclasses.dataclass(frozen=True, eq=False)
class Pair:
    """What two screenshots give at one place of the light: the shader's ``model`` there, the
    ``mask`` (h, w, c) under it, the light pass in ``texels``, the place ``at``, and the
    ``objection`` why that is wrong, or empty."""

    model: Mitchell
    mask: np.ndarray
    texels: TexelLight
    at: Place
    objection: str


def check_light(light: LightPass) -> None:
    """Raise InputError for a light pass that is none."""
    known = light.known.any(-1)
    if known.mean() < FEWEST_KNOWN:
        raise InputError(
            "background: expected two screenshots of which most is neither clipped nor ignored, "
            f"got {known.mean():.0%}; lower the exposure for both"
        )
    if np.ptp(np.where(light.known, light.values, 0)) < FAINTEST_PASS:
        raise InputError(
            "background: expected the same view with the effect off, got a picture that differs "
            "by rounding alone; switch the effect off for it"
        )


def found_in(
    light: LightPass, scene: Scene, shading: Mitchell, near: tuple[float, float] | None
) -> Pair:
    """Light, numbers and mask of a light pass, as far as what the ``scene`` shows of its objects
    gives them. Raises InputError where the light pass is none, or too little of it is known."""
    check_light(light)
    found = scene_places(light, scene, shading.convention, near)
    if not found:
        raise InputError(TOO_FEW)
    shader, samples = shading.convention, int(shading.samples)
    at = in_levels(found[0], MIDDLE_OWN / samples if shader.own_pixel else 0.0)
    texels = texels_of(light, scene.valid)
    total = (1 - math.exp(-at.kappa)) / at.kappa + at.own
    product = at.bright / (LEVELS * shader.gain * samples * total)
    weight = 1 / (at.own * samples) if at.own > 0 else PLAIN_WEIGHT
    decay = math.exp(-at.kappa / samples)
    model = Mitchell(product / weight, decay, at.rho, weight, [[at.u, at.v]], shader.name, samples)
    objection = "" if found[0].cost < EXPLAINS else NOT_ONE_LIGHT
    return Pair(model, mask_under(texels, model, at), texels, at, objection)

"""Two screenshots without a mask: what the light pass between them says of light and mask.

The light pass is known wherever nothing clips. A search along rays gives light, attenuation,
density and the light's disc; under these each texel of the mask is solved for in turn.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np

from godfit.blind.light_pass import LightPass
from godfit.blind.pair_mask import TexelLight, mask_under, texels_of
from godfit.blind.pair_scene import Scene, along_rays, scene_places
from godfit.blind.pair_search import Ranges, search
from godfit.blind.rays import Candidate, View
from godfit.errors import InputError
from godfit.io.filters import shrink
from godfit.io.image import LEVELS
from godfit.models.mitchell import Mitchell

COPY_WIDTH = 320
"""Width in pixels of the copy that the search begins on."""
FAINTEST_PASS = 3.0
"""Levels that a light pass must span: below, two screenshots differ by rounding alone."""
FEWEST_KNOWN = 0.1
"""Share of the picture in which the light pass must be known."""
UNEXPLAINED = 2.0
"""Misfit along rays, in levels squared, from which no light explains the light pass: the true one
leaves less than a tenth of that."""
EXPLAINS = -0.3
"""Cost for each pair of pixels below which the scene's objects explain the light pass."""
NOT_ONE_LIGHT = (
    "no single light explains what the two screenshots differ by: another tone curve, several "
    "lights or a camera that moved"
)
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
    at: Candidate
    objection: str


def views(light: LightPass, valid: np.ndarray | None) -> tuple[TexelLight, View, View]:
    """The light pass in texels; a small copy and the texels of its brightest channel."""
    texels = texels_of(light, valid)
    channel = int(texels.values.reshape(-1, texels.values.shape[-1]).sum(0).argmax())
    image = np.ascontiguousarray(texels.values[..., channel], float)
    known = (texels.sure[..., channel] == 1).astype(float)
    fine = View(image, known)
    factor = max(1, round(image.shape[1] / COPY_WIDTH))
    size = image.shape[0] // factor, image.shape[1] // factor
    if factor > 1:
        image = np.asarray(shrink(image.astype(np.float32), size), float)
        known = (np.asarray(shrink(known.astype(np.float32), size)) > 0.999).astype(float)
    return texels, View(image, known), fine


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
) -> Iterator[Pair]:
    """Light, numbers and mask of a light pass, as far as it gives them: first by what the ``scene``
    shows of its objects, then by a search along rays, for which nothing but the light pass counts.
    """
    check_light(light)
    texels, copy, fine = views(light, scene.valid)
    ranges = Ranges.of(copy.image, int(shading.samples), shading.convention.own_pixel)
    seen = scene_places(light, scene, shading.convention, near)
    begun = [along_rays(place, ranges.middle_own) for place in seen if place.cost < EXPLAINS]
    if begun:
        yield _at(begun[0], "", texels, shading)
    places = search(copy, fine, ranges, near, begun)
    objection = "" if places[0].cost < UNEXPLAINED else NOT_ONE_LIGHT
    yield _at(places[0].at, objection, texels, shading)


def _at(at: Candidate, objection: str, texels: TexelLight, shading: Mitchell) -> Pair:
    """The shader's parameters and the mask at a place."""
    shader, samples = shading.convention, int(shading.samples)
    total = (1 - math.exp(-at.kappa)) / at.kappa + at.own
    product = at.bright / (LEVELS * shader.gain * samples * total)
    weight = 1 / (at.own * samples) if at.own > 0 else PLAIN_WEIGHT
    decay = math.exp(-at.kappa / samples)
    model = Mitchell(product / weight, decay, at.rho, weight, [[at.u, at.v]], shader.name, samples)
    return Pair(model, mask_under(texels, model, at), texels, at, objection)

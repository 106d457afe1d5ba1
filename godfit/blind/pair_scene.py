"""Places of the light by the scene: its objects are in the ordinary pass, its light in the other.

The search of one picture, see ``search.py``, explains the light pass itself: no texture is left in
that, and what occludes the light is seen in the picture without it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from godfit.blind import hypotheses
from godfit.blind.hypotheses import Hypothesis
from godfit.blind.light_pass import LightPass
from godfit.blind.pairs import drawn, solved
from godfit.blind.reduced import Reduced, reduced
from godfit.blind.search import PAIRS, Candidate, in_pixels, searched
from godfit.io.filters import shrink
from godfit.io.image import LEVELS, Image
from godfit.runtime.parallel import parallel_map
from godfit.scattering.conventions import Convention

LEAST_USABLE = 500
"""Pixels of the copy without which a hypothesis is not tried."""
FAINTEST = 1e-3
"""Levels of the light pass over a mask of the dim background, at least: the mask is divided by
them."""
LEAST_KAPPA, MOST_DENSITY = 0.02, 0.995
"""Attenuation along a ray, at least, and density, at most, with which a mask is solved for: texels
are decided from the light outwards, by taps that end before it."""

DARK = 0.5
"""Brightness of an object against the scene's median, at most: what occludes is black there."""


class Place(NamedTuple):
    """Light (u, v); attenuation ``kappa`` along a ray; density ``rho``; the own pixel's weight
    ``own`` against all taps; levels of the light pass over a mask of the dim background, ``dim``,
    and over a white one, ``bright``; ``radius`` of the light's disc, in widths."""

    u: float
    v: float
    kappa: float
    rho: float
    own: float
    dim: float
    bright: float
    radius: float


class Scene(NamedTuple):
    """Two screenshots, the effect ``on`` and ``off``, and ``valid`` (h, w) or None."""

    on: Image
    off: Image
    valid: np.ndarray | None


def scene_hypotheses(light: LightPass, scene: Scene, shader: Convention) -> list[Hypothesis]:
    """What the light pass may have read: what the ordinary pass has in its ground's colour or is
    not dark there, with a disc; what is bright in the picture with the effect on."""
    size = light.size
    valid = np.ones(size, bool) if scene.valid is None else scene.valid
    on, off = (_copy(image, valid, shader) for image in (scene.on, scene.off))
    small = on.valid.shape[0], on.valid.shape[1]
    occluded = np.zeros(small, bool)
    values = shrink(light.values.mean(-1)[..., None].astype(np.float32), small)[..., 0]
    values = values.astype(float) / LEVELS
    unknown = (~light.known.all(-1) & valid)[..., None]
    clipped = shrink(unknown.astype(np.float32), small)[..., 0] > 0
    made = [
        hypotheses.bright(on, occluded),
        hypotheses.colour(off, occluded),
        hypotheses.darkness(off, occluded),
    ]
    usable = on.valid & ~clipped
    # The light pass has no steps of the ground, and no light is more than it.
    if np.count_nonzero(usable) < LEAST_USABLE:
        return []
    return [
        h._replace(
            values=values, usable=usable, bounded=on.valid & clipped, ceiling=values + LEVELS,
            steps=(),
        )
        for h in made
        if h is not None
    ]  # fmt: skip


def not_dark(off: Image) -> np.ndarray:
    """(h, w) the mask, 1 where an ordinary pass is not dark against its median, else 0."""
    brightness = np.atleast_3d(off.encoded).mean(-1)
    return (brightness > DARK * np.median(brightness)).astype(np.float32)


def _copy(image: Image, valid: np.ndarray, shader: Convention) -> Reduced:
    levels = np.atleast_3d(image.encoded).astype(np.float32) * np.float32(LEVELS)
    return reduced(np.broadcast_to(levels, (*levels.shape[:2], 3)), valid, shader)


def scene_places(
    light: LightPass,
    scene: Scene,
    shader: Convention,
    near: tuple[float, float] | None,
    seed: int = 0,
) -> list[Candidate]:
    """The best place under each hypothesis, best first.

    Each is searched for once more about the best place of all: most of the picture is flat in the
    cost of a steep ray, and a hypothesis that is right may never come near its light.
    """
    tried = scene_hypotheses(light, scene, shader)
    if not tried:
        return []
    found = parallel_map(lambda h: searched(h, near, seed), tried)
    best = min(found, key=_cost).place
    if near is None:
        found += parallel_map(lambda h: searched(h, best, seed), tried)
    return sorted(found, key=_cost)


def _cost(place: Candidate) -> float:
    return place.cost


def in_levels(candidate: Candidate, own: float, seed: int = 0) -> Place:
    """The same place with an own pixel of weight ``own``. The gains of the hypothesis are the
    levels of the light pass over the dim background and over white."""
    hypothesis = candidate.hypothesis
    pairs = drawn(hypothesis, PAIRS, seed)
    _, gains = solved(in_pixels(candidate.point, hypothesis.values.shape), pairs, hypothesis)
    gains = gains[0, : len(hypothesis.maps)]
    kappa = max(candidate.kappa, LEAST_KAPPA)
    levels = LEVELS * ((1 - math.exp(-kappa)) / kappa + own) * gains
    dim = float(levels[hypothesis.windowed == 0].sum())
    (u, v), bright = candidate.place, float(levels.sum())
    return Place(
        u, v, kappa, min(candidate.density, MOST_DENSITY), own, max(dim, FAINTEST),
        max(bright, 1.0), candidate.radius,
    )  # fmt: skip

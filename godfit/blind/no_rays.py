"""Whether what a search found is rays at all."""

from __future__ import annotations

import numpy as np

from godfit.blind import first_look
from godfit.blind.explained import TEXTURE
from godfit.blind.sight import out_of_sight
from godfit.inference.observation import Picture
from godfit.models.coordinates import LIGHT_X, LIGHT_Y

# Of what varies in a picture, the share that light must explain to be called rays: of a textured
# one, where photographs, text and noise reach 0 and screenshots .4, and of others, where landscapes
# reach .73 and screenshots .83 at least.
RAYS, CLEAR_RAYS = 0.25, 0.75
# Where less is explained, but by some light, the share of starts that must find it: of textured
# screenshots up to nineteen of twenty do, of pictures without rays four of twelve at most, whose
# light explains nothing.
AGREED = 0.4
NO_RAYS = (
    "no rays were found: a light explains {:.0f}% of what varies in this picture beside a smooth "
    "background"
)
NO_LIGHT = (
    "no rays were found: where a light would stand, at {:.2f}, {:.2f}, nothing is brighter than "
    "the rest"
)


def objection(looked: first_look.Look, held: np.ndarray, picture: Picture) -> str:
    """Why what the search found, with coordinates ``held`` (p,) where not NaN, is no rays of
    ``picture``; empty where it is rays."""
    z = looked.ends[0].coordinates
    light = z[LIGHT_X : LIGHT_Y + 1]
    agreed, tried = first_look.agreed(looked.lights, light)
    least = RAYS if looked.texture >= TEXTURE else CLEAR_RAYS
    if not looked.explained > (0 if agreed > AGREED * tried else least):
        return NO_RAYS.format(100 * max(looked.explained, 0))
    # Of a light beside the picture it may be that only the veil is seen.
    if np.abs(light - 0.5).max() < 0.5 and out_of_sight(looked.model, z, held, picture):
        return NO_LIGHT.format(*light)
    return ""

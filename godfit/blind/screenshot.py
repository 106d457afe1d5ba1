"""What can be told of a finished picture before any light is known.

What differs from the background in colour stands in the way, or lies on top; of what only edges cut
off, or glare hides, the shadows decide. Pixels of objects and panels say nothing themselves: what
they look like without the light is anybody's guess.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from godfit.blind.explained import grain
from godfit.blind.segment import Segments, grown, light_colour, panels, segments
from godfit.inference.observation import Picture
from godfit.io.image import Image
from godfit.models.background import TERM_COUNTS
from godfit.models.disc_light import DiscLight
from godfit.models.mitchell import Mitchell

# Share of pixels that the model may be silent about without being told.
FOREIGN = 0.02
# Levels by which the background's colours must vary over the picture to be called smooth: of 200
# made ones those of one colour vary by .04 at most, the others by 1.1 at least.
SMOOTH = 0.3
# Texture in levels next to which the light is taken to be white.
HIDES_COLOUR = 1.5
# Share of the picture that must be background for the rest to be objects.
LEAST = 0.03


class Reading(NamedTuple):
    """``picture`` with ``mask`` 1 where it is open; ``unknown`` (h, w) is what shadows decide;
    ``panels`` as (x, y, width, height); ``degree`` of the background and its ``texture``, in
    levels; ``tint`` of the light, (2,) or, where it is white, (0,)."""

    picture: Picture
    unknown: np.ndarray
    panels: list[tuple[int, int, int, int]]
    degree: int
    texture: float
    tint: np.ndarray


def read(target: Image, valid: np.ndarray | None, occluder: np.ndarray | None) -> Reading:
    """What can be told before any light is known. ``occluder`` (h, w) is True where the user says
    that something stands in the way."""
    size = target.values.shape[:2]
    picture = Picture.make(target, np.ones(size, np.float32), None, valid)
    picture = dataclasses.replace(picture, foreign=FOREIGN)
    colour = _light_colour(picture)
    found = segments(picture.levels, picture.half, picture.valid, colour)
    lying = panels(found.other | found.doubtful, picture.levels)
    open_, silent, unknown = _sorted_out(picture, found, lying)
    if (picture.valid & ~silent).mean() < LEAST:
        # Objects all over are no objects.
        open_, silent = np.ones_like(open_), np.zeros_like(silent)
    if occluder is not None:
        open_ = np.where(occluder, 0, open_).astype(np.float32)
        silent |= grown(occluder, 2)
        unknown &= ~occluder
    picture = dataclasses.replace(picture, mask=open_, valid=picture.valid & ~silent)
    tint = colour[[0, 2]] if np.any(colour != 1) else np.zeros(0)
    degree = 0 if found.variation < SMOOTH else 2
    return Reading(picture, unknown, lying, degree, grain(picture), tint)


def _light_colour(picture: Picture) -> np.ndarray:
    """The light's (c,). Texture has a colour of its own, which hides it."""
    if grain(picture) > HIDES_COLOUR:
        return np.ones(picture.channels)
    return light_colour(picture.levels, picture.half, picture.valid)


def _sorted_out(picture: Picture, found: Segments, lying: list[tuple[int, int, int, int]]):
    """(h, w) each: what is open at first sight, what says nothing, what shadows decide."""
    open_ = np.where(found.other, 0.0, 1.0).astype(np.float32)
    silent = grown(found.other, 2)
    unknown = found.other | found.doubtful | (picture.clipped & picture.valid)
    unknown = grown(unknown)
    for x, y, wide, tall in lying:
        over = (slice(y, y + tall), slice(x, x + wide))
        around = (slice(max(y - 2, 0), y + tall + 2), slice(max(x - 2, 0), x + wide + 2))
        open_[over], silent[around], unknown[over] = 1.0, True, False
    return open_, silent, unknown


def template(shading: Mitchell, channels: int, degree: int, tint) -> DiscLight:
    """The model at no particular point, but for the light's ``tint`` (t,)."""
    return DiscLight(shading, [0.1, 0.003, 0.05], np.zeros((TERM_COUNTS[degree], channels)), tint)

"""Five scenes of a lamp among objects in a cube of one medium, which Mitsuba 3 renders as well.

The medium is pure haze or (the least turbidity) pure molecules; pictures have 16x16 pixels.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from godfit.models.atmosphere import MIN_TURBIDITY, Air
from godfit.scenes.scene import Scene, read_scene

SIZE, HALF = 16, 6.0


@dataclasses.dataclass(frozen=True)
class Reference:
    """A scene, its lamp's place, and the air: turbidity, g, metres a unit, share of haze."""

    objects: str
    light: tuple[float, float, float]
    air: tuple[float, float, float, float]


BOX = '[[object]]\nprimitive = "box"\nsize = [1.0, 1.6, 0.5]\nposition = [0.5, 0.2, -3]\n'
BALL = '[[object]]\nprimitive = "icosphere"\nradius = 0.6\nposition = [-0.8, 0.1, -2.5]\n'
RING = (
    '[[object]]\nprimitive = "torus"\nradius = 0.9\ntube = 0.15\n'
    "position = [0, 0, -3]\nrotation = [60, 20, 0]\n"
)
HAZE, CLEAR = 1.0, MIN_TURBIDITY
REFERENCES = {
    "box, forward haze": Reference(BOX, (0.3, 0.5, -4.0), (2.0, 0.6, 15.0, HAZE)),
    "ball, even haze": Reference(BALL, (-0.9, 0.8, -3.2), (2.0, 0.0, 25.0, HAZE)),
    "box and ball, backward haze": Reference(
        BOX + BALL, (0.0, -0.6, -3.5), (2.0, -0.3, 15.0, HAZE)
    ),
    "ring, molecules": Reference(RING, (0.0, 0.0, -3.2), (CLEAR, 0.0, 1e4, 1e-3)),
    "all, molecules": Reference(BOX + BALL + RING, (0.2, 1.2, -2.6), (CLEAR, 0.0, 2e4, 1e-3)),
}


def air_of(reference: Reference) -> Air:
    turbidity, g, scale, haze = reference.air
    return Air(turbidity, g, 1.0, scale, haze)


def scene_of(reference: Reference, folder: Path) -> Scene:
    """The scene of a reference, its camera at the origin."""
    light = ", ".join(map(str, reference.light))
    (folder / "scene.toml").write_text(
        f"[image]\nwidth = {SIZE}\nheight = {SIZE}\n[camera]\nposition = [0, 0, 0]\n"
        f"target = [0, 0, -1]\nfov_y = 70\n[light]\nposition = [{light}]\nradius = 1e-4\n"
        + reference.objects
    )
    return read_scene(folder / "scene.toml")


def to_the_wall(direction: np.ndarray) -> np.ndarray:
    """How far rays from the middle of the cube go in it."""
    return HALF / np.abs(direction).max(-1)

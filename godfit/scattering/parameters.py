"""The parameters of a god-ray effect: one table of names, symbols, units, bounds and meanings.

The names are those of the shaders (Mitchell, GPU Gems 3, chapter 13). Lights after the first are
``light2_x``, ``light2_y``, ``light3_x``, ...
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import inf

LIGHT_DENSITY = 1.0
"""Density at which the taps reach the light: above it the last ones lie beyond the light."""
MAX_DENSITY = 2.0
"""Largest density, as a share of the ray: the sliders of published shaders end at 1 or at 2, and
pictures were published at 1.056 and 1.094."""


@dataclass(frozen=True)
class Parameter:
    """One row of the table. ``lower`` and ``upper`` are inclusive bounds in ``unit``."""

    name: str
    symbol: str
    unit: str
    lower: float
    upper: float
    meaning: str


SCATTERING = (
    Parameter("exposure", "E", "1", 0.0, inf, "scale of the whole light pass"),
    Parameter("decay", "d", "1 per tap", 0.0, 1.0, "ratio of a tap's weight to the one before it"),
    Parameter(
        "density", "rho", "of the ray", 0.0, MAX_DENSITY, "how far towards the light the taps reach"
    ),
    Parameter("weight", "w", "1", 0.0, inf, "weight of a tap relative to the pixel's own value"),
)
"""The parameters of Mitchell's sum besides the light, in the order of reports."""


def density_reach(density: float) -> float:
    """The end of the range that a density is in: taps up to the light, or taps beyond it. Another
    shader in place of one whose taps end at the light should not reach beyond it either."""
    return LIGHT_DENSITY if density <= LIGHT_DENSITY else max(MAX_DENSITY, density)


def light_parameters(lights: int) -> tuple[Parameter, ...]:
    """The rows of ``lights`` lights: u to the right, v up, (0, 0) the bottom-left corner."""
    rows = []
    for i in range(lights):
        stem = "light" if i == 0 else f"light{i + 1}"
        subject = "the light" if lights == 1 else f"light {i + 1}"
        for axis, symbol, direction in (("x", "u", "to the right"), ("y", "v", "up")):
            meaning = f"{subject}, {direction} from the left bottom corner"
            rows.append(Parameter(f"{stem}_{axis}", symbol, "of the image", -inf, inf, meaning))
    return tuple(rows)


def table(lights: int = 1) -> dict[str, Parameter]:
    """All parameters of an effect with ``lights`` lights, by name, in the order of reports."""
    return {p.name: p for p in SCATTERING + light_parameters(lights)}


def is_light(name: str) -> bool:
    """Whether ``name`` is a light's coordinate."""
    return re.fullmatch(r"light\d*_[xy]", name) is not None

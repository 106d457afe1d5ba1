"""Places of the fit coordinates in the vectors of the models around Mitchell's sum.

A vector begins with the scattering coordinates (``Mitchell.coordinates``), then come the lights. A
bare picture (``bare_picture.py``) has one light, then three numbers of shape, the background's
coefficients and the tint.
"""

from __future__ import annotations

from godfit.scattering.parameters import SCATTERING

EXPOSURE = 0
"""Exposure, the scale of the whole light pass."""
KAPPA = 1
"""Attenuation for each unit of ray."""
DENSITY = 2
"""Share of the ray that the taps reach over."""
GAIN = 3
"""exposure * weight * samples / density; of a bare picture, the disc's part of it."""
SCATTERING_COUNT = len(SCATTERING)
"""Number of the scattering coordinates, which come first: the four above."""
LIGHT_X = 4
"""u of the first light, in texture coordinates."""
LIGHT_Y = 5
"""v of the first light, in texture coordinates."""
SHADING_COUNT = SCATTERING_COUNT + 2
"""Number of the coordinates of a shading with one light."""

RADIUS = 6
"""Radius of a disc light, in picture heights."""
EDGE = 7
"""Width of a disc's soft edge, in picture heights."""
VEIL = 8
"""Gain times veil: the part of the gain that an open mask has without the disc."""

FIRST_BACKGROUND = SHADING_COUNT + 3
"""Place of the background's first coefficient in the vector of a bare picture."""

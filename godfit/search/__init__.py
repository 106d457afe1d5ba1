"""The search where the mask is known; importing it registers how each model is searched for."""

from godfit.search import (  # noqa: F401
    edge_pixels,
    masked,
    placement,
    screening,
    screening_daylight,
)

"""Light in the plane: two-dimensional global illumination of a drawn canvas.

After "Building Real-Time Global Illumination" (jason.today/gi, 2024): every lit pixel of a canvas
sends out light, every opaque one stops it. ``canvas.py`` has the canvas, ``drawing.py`` shapes to
draw it from, ``sky.py`` what lies around it; ``rays.py``, ``cascades.py`` and ``published.py`` are
ways from there to a picture, ``picture.py`` the way in to all of them.
"""

from godfit.flatland.accumulate import accumulated, effective_frames, weights
from godfit.flatland.canvas import Canvas, canvas, read_canvas
from godfit.flatland.rendering import METHODS, render
from godfit.flatland.sky import Sky

__all__ = [
    "METHODS",
    "Canvas",
    "Sky",
    "accumulated",
    "canvas",
    "effective_frames",
    "read_canvas",
    "render",
    "weights",
]

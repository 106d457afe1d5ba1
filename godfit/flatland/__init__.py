"""Light in the plane: two-dimensional global illumination of a drawn canvas.

After "Building Real-Time Global Illumination" (jason.today/gi, 2024): every lit pixel of a canvas
emits light, every opaque one stops it.

``canvas.py`` has the canvas, ``drawing.py`` the shapes to draw it from and ``sky.py`` the light
from outside. ``rays.py``, ``cascades.py`` and ``published.py`` are methods that render it, and
``rendering.py`` is the entry to all of them; the files ``*_kernel.py`` have their compiled loops.
``model.py``, ``starts.py`` and ``fit_setup.py`` are for fits.
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

"""Light in the plane: two-dimensional global illumination of a drawn canvas.

After "Building Real-Time Global Illumination" (jason.today/gi, 2024): every lit pixel of a canvas
emits light, every opaque one stops it.

``canvas.py`` has the canvas, ``drawing.py`` the shapes to draw it from, ``painting.py`` the strokes
to paint it with, ``sand.py`` the sand that falls on it, and ``sky.py`` the light from outside.
``rays.py`` and ``cascades.py`` are methods that render it, and ``rendering.py`` is the entry to
both; ``published.py`` has the article's own two shaders. The files ``*_kernel.py`` have compiled
loops. ``model.py``, ``starts.py`` and ``fit_setup.py`` are for fits.
"""

from __future__ import annotations

# Not at its first use: the module of this name would hide the function.
from godfit.flatland.canvas import Canvas, canvas, from_rgba, read_canvas

TYPE_CHECKING = False
if TYPE_CHECKING:
    from godfit.flatland.accumulate import accumulated, effective_frames, weights
    from godfit.flatland.painting import PALETTE, Stroke, example_strokes, painted
    from godfit.flatland.published import GlobalIllumination, NaiveMarch, render_published
    from godfit.flatland.rendering import METHODS, render
    from godfit.flatland.sand import Sand, falling_sand, painted_sand
    from godfit.flatland.sky import Sky

__all__ = [
    "METHODS",
    "PALETTE",
    "Canvas",
    "GlobalIllumination",
    "NaiveMarch",
    "Sand",
    "Sky",
    "Stroke",
    "accumulated",
    "canvas",
    "effective_frames",
    "example_strokes",
    "falling_sand",
    "from_rgba",
    "painted",
    "painted_sand",
    "read_canvas",
    "render",
    "render_published",
    "weights",
]

_HOMES = {
    "GlobalIllumination": "godfit.flatland.published",
    "METHODS": "godfit.flatland.rendering",
    "NaiveMarch": "godfit.flatland.published",
    "PALETTE": "godfit.flatland.painting",
    "Sand": "godfit.flatland.sand",
    "Sky": "godfit.flatland.sky",
    "Stroke": "godfit.flatland.painting",
    "accumulated": "godfit.flatland.accumulate",
    "effective_frames": "godfit.flatland.accumulate",
    "example_strokes": "godfit.flatland.painting",
    "falling_sand": "godfit.flatland.sand",
    "painted": "godfit.flatland.painting",
    "painted_sand": "godfit.flatland.sand",
    "render": "godfit.flatland.rendering",
    "render_published": "godfit.flatland.published",
    "weights": "godfit.flatland.accumulate",
}


def __getattr__(name: str):
    """Import a public name at its first use: most fits need no light in the plane."""
    if name not in _HOMES:
        raise AttributeError(f"module 'godfit.flatland' has no attribute '{name}'")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)

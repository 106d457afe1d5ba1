"""Reads the parameters of god rays out of images.

``fit`` is the main job; ``Mitchell`` renders; ``radial_sum`` and ``Taps`` are what both stand on.
"""

from typing import TYPE_CHECKING

from godfit.errors import InputError
from godfit.image import Image, read_image, write_image

if TYPE_CHECKING:
    from godfit.clip import ClipResult, fit_clip
    from godfit.fitting import fit
    from godfit.models import Mitchell
    from godfit.radial import radial_sum
    from godfit.raster import rasterise
    from godfit.result import Estimate, FitResult
    from godfit.scene import Scene, read_scene
    from godfit.taps import CONVENTIONS, Taps

__all__ = [
    "CONVENTIONS",
    "ClipResult",
    "Estimate",
    "FitResult",
    "Image",
    "InputError",
    "Mitchell",
    "Scene",
    "Taps",
    "fit",
    "fit_clip",
    "radial_sum",
    "rasterise",
    "read_image",
    "read_scene",
    "write_image",
]

_HOMES = {
    "CONVENTIONS": "godfit.taps",
    "ClipResult": "godfit.clip",
    "Estimate": "godfit.result",
    "FitResult": "godfit.result",
    "Mitchell": "godfit.models",
    "Scene": "godfit.scene",
    "Taps": "godfit.taps",
    "fit": "godfit.fitting",
    "fit_clip": "godfit.clip",
    "radial_sum": "godfit.radial",
    "rasterise": "godfit.raster",
    "read_scene": "godfit.scene",
}


def __getattr__(name: str):
    """What needs JAX is imported when it is asked for: the command line's help is instant."""
    if name not in _HOMES:
        raise AttributeError(f"module 'godfit' has no attribute '{name}'")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)

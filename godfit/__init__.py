"""Estimates the parameters of god rays from images.

``fit`` estimates; ``Mitchell`` renders; both are built on ``radial_sum`` and ``Taps``.
"""

# Nothing but this may be imported here. ``python -m godfit`` imports this file with the current
# folder on the path, where a file may have the name of any module.
from godfit.errors import InputError

TYPE_CHECKING = False
if TYPE_CHECKING:
    __version__: str
    from godfit.fitting import fit, problem
    from godfit.inference.estimates import Estimate
    from godfit.inference.problem import Problem
    from godfit.io.image import Image, read_image, write_image
    from godfit.models.mitchell import Mitchell
    from godfit.report.clip import ClipResult
    from godfit.report.compare import Comparison
    from godfit.report.result import FitResult
    from godfit.report.saved import SavedFit, load, render
    from godfit.report.select import Selection
    from godfit.scattering.conventions import CONVENTIONS
    from godfit.scattering.radial import radial_sum
    from godfit.scattering.taps import Taps
    from godfit.scenes.raster import rasterise
    from godfit.scenes.scene import Scene, read_scene
    from godfit.studies.batch.run import FrameFit, batch
    from godfit.studies.clip import fit_clip
    from godfit.studies.compare import compare
    from godfit.studies.select import select

__all__ = [
    "CONVENTIONS",
    "ClipResult",
    "Comparison",
    "Estimate",
    "FitResult",
    "FrameFit",
    "Image",
    "InputError",
    "Mitchell",
    "Problem",
    "SavedFit",
    "Scene",
    "Selection",
    "Taps",
    "__version__",
    "batch",
    "compare",
    "fit",
    "fit_clip",
    "load",
    "problem",
    "radial_sum",
    "rasterise",
    "read_image",
    "read_scene",
    "render",
    "select",
    "write_image",
]

_HOMES = {
    "CONVENTIONS": "godfit.scattering.conventions",
    "ClipResult": "godfit.report.clip",
    "Comparison": "godfit.report.compare",
    "Estimate": "godfit.inference.estimates",
    "FitResult": "godfit.report.result",
    "FrameFit": "godfit.studies.batch.run",
    "Image": "godfit.io.image",
    "Mitchell": "godfit.models.mitchell",
    "Problem": "godfit.inference.problem",
    "SavedFit": "godfit.report.saved",
    "Scene": "godfit.scenes.scene",
    "Selection": "godfit.report.select",
    "Taps": "godfit.scattering.taps",
    "batch": "godfit.studies.batch.run",
    "compare": "godfit.studies.compare",
    "fit": "godfit.fitting",
    "fit_clip": "godfit.studies.clip",
    "load": "godfit.report.saved",
    "problem": "godfit.fitting",
    "radial_sum": "godfit.scattering.radial",
    "rasterise": "godfit.scenes.raster",
    "read_image": "godfit.io.image",
    "read_scene": "godfit.scenes.scene",
    "render": "godfit.report.saved",
    "select": "godfit.studies.select",
    "write_image": "godfit.io.image",
}


def __dir__() -> list[str]:
    """The public names: no module is one."""
    return sorted(__all__)


def __getattr__(name: str):
    """Import a public name at its first use."""
    if name == "__version__":
        from importlib import metadata

        return metadata.version("godfit")
    if name not in _HOMES:
        raise AttributeError(f"module 'godfit' has no attribute '{name}'")
    import importlib

    from godfit.runtime.host_state import imports_kept

    if not _HOMES[name].startswith("godfit.io"):
        # JAX's own variables stay, because its compiler reads them when it starts.
        import jax  # noqa: F401
    with imports_kept():
        return getattr(importlib.import_module(_HOMES[name]), name)

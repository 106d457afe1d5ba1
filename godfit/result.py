"""What a fit found: values, errors, what is left open, and the pictures that go with them."""

from __future__ import annotations

import dataclasses
import os
from typing import TYPE_CHECKING

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from godfit.image import encode
from godfit.models import Mitchell
from godfit.observation import LEVELS, Picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A parameter's value; ``stderr`` is None where it is fixed or cannot be known."""

    value: float
    stderr: float | None
    fixed: bool = False
    at_bound: bool = False


@dataclasses.dataclass(frozen=True, eq=False)
class FitResult:
    """What the picture says. Arrays are (h, w) or (h, w, 3); levels are 8-bit levels.

    ``covariance`` is that of the parameters in the order of ``params`` (NaN where held);
    ``correlations`` keeps the pairs above 0.1 in size, largest first; ``undetermined`` names in
    words what the picture leaves open. ``noise_levels`` is the standard deviation of the noise
    before rounding; ``residual_correlation`` that of the standardised residuals of neighbours.
    """

    converged: bool
    message: str
    model: Mitchell
    params: dict[str, Estimate]
    covariance: np.ndarray
    correlations: dict[str, float]
    undetermined: tuple[str, ...]
    notes: tuple[str, ...]
    noise_levels: float
    rmse_levels: float
    psnr_db: float
    pixels: int
    pixels_clipped: int
    residual_correlation: float
    log_likelihood: float
    timing_s: dict[str, float]
    picture: Picture
    inputs: dict[str, dict[str, str]] = dataclasses.field(default_factory=dict)

    def render(self) -> np.ndarray:
        """The fitted image, linear, clamped to [0, 1]; shaped like the target."""
        picture = self.picture
        image = render(self.model, picture.mask, picture.background, picture.size)
        image = np.broadcast_to(np.atleast_3d(image), picture.levels.shape)
        return image if image.shape[-1] == 3 else image[..., 0]

    @property
    def residual(self) -> np.ndarray:
        """Fitted minus target in levels, both clamped to the scale, NaN where ignored."""
        fitted = np.asarray(encode(self.render(), self.picture.transfer)) * np.float32(LEVELS)
        residual = np.atleast_3d(fitted) - self.picture.levels
        residual[~self.picture.valid] = np.nan
        return residual if residual.shape[-1] == 3 else residual[..., 0]

    def summary(self) -> str:
        """The table that the command line prints, as plain text."""
        from godfit.report import summary

        return summary(self)

    def plot(self) -> Figure:
        """A matplotlib figure: target, fitted, residual, parameters."""
        from godfit.report import plot

        return plot(self)

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write fit.json, fit.png and render.png into ``folder``; raises OSError."""
        from godfit.report import save

        save(self, folder)

    def _repr_html_(self) -> str:
        from godfit.report import html

        return html(self)


def render(
    model: Mitchell, mask: np.ndarray, background: np.ndarray | None, size: tuple[int, int]
) -> np.ndarray:
    """The model's image, (h, w) or (h, w, 3), linear, clamped to [0, 1]."""
    back = None if background is None else jnp.asarray(background)
    return np.clip(np.asarray(_image(model, jnp.asarray(mask), back, size)), 0, 1)


@eqx.filter_jit
def _image(model, mask, background, size):
    return model(mask, background, size=size)

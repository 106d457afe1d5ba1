"""The result of a fit: values, errors, open parameters, and the pictures that go with them."""

from __future__ import annotations

import dataclasses
import functools
import os
import tempfile
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from godfit.inference.allowances.prior import Prior
from godfit.inference.estimates import Estimate
from godfit.inference.evaluate import occlusion_of
from godfit.inference.observation import Picture
from godfit.inference.problem import Problem
from godfit.io.image import LEVELS, decode, write_image
from godfit.models.base import AbstractModel
from godfit.report.figure import sheet_of
from godfit.report.files import PAGE, page_writer, write_result
from godfit.report.live.data import NOTEBOOK_SIDE, page_data
from godfit.report.live.page import framed
from godfit.report.live.widget import viewer_widget
from godfit.report.pages import fit_page, shown
from godfit.report.record import fit_record
from godfit.report.style import own_style
from godfit.report.text import html, one_line, summary
from godfit.runtime.guest import as_guest

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class FitResult:
    """The result of a fit. Arrays are (h, w) or (h, w, 3); levels are 8-bit levels.

    ``print(result)`` prints the report of the command line.

    ``combined`` has the product that is determined even where its factors are not,
    ``"exposure*weight"``. ``covariance`` is that of the parameters in the order of ``params`` (NaN
    where held). ``correlations`` keeps the pairs above 0.1 in size, largest first.
    ``undetermined`` has a sentence for each group of parameters that the picture leaves open,
    ``warnings`` a sentence for each reason why the model may be wrong.
    ``pixels_effective`` is the number of independent pixels: fewer than ``pixels`` where their
    errors are correlated. ``starts_agreed`` is (agreeing, tried) where other starts were tried.
    ``noise_levels`` is the standard deviation of the noise before rounding.
    ``residual_correlation`` is that of neighbouring residuals, near 0 for noise,
    ``residual_tails`` their kurtosis, near 3 for Gaussian noise. With ``simulated``, values and
    errors allow for the target's processing, see ``inference/indirect_inference.py``; the
    likelihood does not. ``pass_scale`` is the size of the light pass relative to the mask that was
    given, None without one. ``where`` has, for each determined parameter, the share (rows, columns)
    of the information on it that each cell of the picture holds. ``mask_estimated`` is True where
    the mask comes from two screenshots.

    >>> import godfit
    >>> result = godfit.fit("frame.png", mask="mask.png", shader="dawntime", samples=30)
    >>> result.params["density"].stderr < 0.01, result.residual.shape
    (True, (96, 96))
    """

    converged: bool
    message: str
    model: AbstractModel
    params: dict[str, Estimate]
    combined: dict[str, Estimate]
    covariance: np.ndarray
    correlations: dict[str, float]
    undetermined: tuple[str, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    noise_levels: float
    rmse_levels: float
    psnr_db: float
    pixels: int
    pixels_effective: float
    pixels_clipped: int
    residual_correlation: float
    residual_tails: float
    log_likelihood: float
    timing_s: dict[str, float]
    picture: Picture
    # By coordinate: which moved, and at what value the other parameters were held (NaN if free).
    free: np.ndarray
    held: np.ndarray
    seed: int = 0
    starts_agreed: tuple[int, int] | None = None
    simulated: bool = False
    pass_scale: float | None = None
    prior: Prior = dataclasses.field(default_factory=dict)
    mask_estimated: bool = False
    inputs: dict[str, dict[str, str]] = dataclasses.field(default_factory=dict)
    where: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)

    @property
    def problem(self) -> Problem:
        """The problem that was solved, with the coordinates that the picture leaves open held."""
        found = Problem(self.model, self.picture, self.free, self.held, self.seed, prior=self.prior)
        with as_guest():
            point = np.asarray(self.model.coordinates(), np.float32)
        return found.replaced(point=point, noise_levels=self.noise_levels)

    @property
    def size(self) -> tuple[int, int]:
        """(rows, columns) of the picture."""
        return self.picture.size

    @functools.cached_property
    def levels(self) -> np.ndarray:
        """(h, w, c) levels of the fitted image in the target's encoding, not rounded."""
        with as_guest():
            return self.picture.rendered(self.model)

    def render(self) -> np.ndarray:
        """The fitted image, linear, clamped to [0, 1]; shaped like the target."""
        levels = self.levels / np.float32(LEVELS)
        with as_guest():
            image = np.asarray(decode(levels, self.picture.transfer))
        return image if image.shape[-1] == 3 else image[..., 0]

    @property
    def mask(self) -> np.ndarray:
        """(h, w) or (h, w, 3): the occlusion mask that the light pass reads, given or estimated."""
        with as_guest():
            return np.asarray(occlusion_of(self.model, np.asarray(self.picture.mask)))

    @property
    def residual(self) -> np.ndarray:
        """Fitted minus target in levels, both clamped to the scale, NaN where ignored."""
        residual = self.levels - self.picture.levels
        residual[~self.picture.valid] = np.nan
        return residual if residual.shape[-1] == 3 else residual[..., 0]

    def summary(self) -> str:
        """The table that the command line prints, as plain text."""
        return summary(self)

    def record(self, command: str = "") -> dict[str, Any]:
        """The contents of fit.json; numbers that are not finite are null."""
        return fit_record(self, command)

    def plot(self) -> Figure:
        """A matplotlib figure: target, fitted, residual, parameters. A notebook displays it; its
        ``show()`` opens it elsewhere."""
        with as_guest(), own_style():
            return sheet_of(self).figure()

    def save(self, folder: str | os.PathLike[str], command: str = "", page: bool = True) -> None:
        """Write fit.json, fit.png, render.png, with ``page`` report.html, and mask.png where it was
        estimated from two screenshots, into ``folder``. Raises OSError, and warns of pictures that
        fail."""

        def render(path: Path) -> None:
            write_image(path, self.render(), transfer=self.picture.transfer, exact=True)

        def mask(path: Path) -> None:
            write_image(path, np.clip(self.mask, 0, 1))

        images: dict[str, Callable[[Path], None]] = {"render.png": render}
        if self.mask_estimated:
            images["mask.png"] = mask
        record = ("fit.json", self.record(command))
        if page:
            images[PAGE] = page_writer(lambda: self.page(command))
        write_result(Path(folder), record, ("fit.png", lambda: sheet_of(self)), images)

    def __str__(self) -> str:
        return summary(self)

    def __repr__(self) -> str:
        return one_line(self)

    def _repr_html_(self) -> str:
        """The table, then the page in a frame, whose shader runs at the first touch."""
        page = fit_page(self, notebook=True).html()
        return html(self) + framed(page)

    def show(self) -> str:
        """Open the page in the browser; returns the file that holds it, in a folder of its own."""
        path = Path(tempfile.mkdtemp(prefix="godfit-")) / PAGE
        page_writer(self.page)(path)
        webbrowser.open(path.as_uri())
        return str(path)

    def widget(self) -> Any:
        """The page as a widget of a notebook, whose ``values`` are the sliders'. Raises InputError
        without the extra ``notebook``."""
        return viewer_widget(page_data(shown(self), NOTEBOOK_SIDE, eager=False))

    def page(self, command: str = "") -> str:
        """report.html: a page that runs the fitted shader in a browser, offline, in one file."""
        return fit_page(self, command).html()

"""A fit that was saved: its numbers, its report and its picture, from fit.json."""

from __future__ import annotations

import dataclasses
import os
from typing import Any, NamedTuple, cast

import numpy as np

from godfit.errors import InputError, Remark
from godfit.inference.estimates import Estimate
from godfit.inference.observation import render as rendered
from godfit.io.sources import Source, read_source
from godfit.models.build import mitchell_at
from godfit.models.mitchell import Mitchell
from godfit.report.record import MODEL_SETTINGS, read_params, read_record, recorded
from godfit.report.result import FitResult
from godfit.report.text import one_line, summary
from godfit.runtime.guest import as_guest


class NamedModel(NamedTuple):
    """A model whose scene or canvas is not part of the record: its name and settings."""

    name: str
    settings: dict[str, Any]


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class SavedFit:
    """The fit in a fit.json, with the names of ``FitResult`` where both have them. Levels are 8-bit
    levels. ``record`` is the whole file; ``path`` is where it lies.

    >>> import godfit
    >>> saved = godfit.load("frame.godfit")
    >>> saved.shader, saved.converged, saved.size
    ('dawntime', True, (96, 96))
    """

    path: str
    record: dict[str, Any]
    params: dict[str, Estimate]
    combined: dict[str, Estimate]
    correlations: dict[str, float]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]

    def __getattr__(self, name: str) -> Any:
        """What fit.json has under this name: ``converged``, ``rmse_levels`` and the like."""
        if name.startswith("_") or name not in self.record:
            raise AttributeError(f"'{self.path}' has no '{name}'")
        return self.record[name]

    @property
    def size(self) -> tuple[int, int]:
        """(rows, columns) of the picture; (0, 0) where the record does not have it."""
        columns, rows = self.record.get("size", (0, 0))
        return rows, columns

    @property
    def model(self) -> Mitchell | NamedModel:
        """The fitted model, a function of a mask; only its name and settings where it needs a scene
        or a canvas."""
        settings = read_params(self.path)
        name = settings.get("model", Mitchell.name)
        if name != Mitchell.name:
            return NamedModel(name, {k: settings[k] for k in MODEL_SETTINGS[1:] if k in settings})
        return mitchell_at(settings, {}, [])

    def render(self, mask: Source | None = None, background: Source | None = None) -> np.ndarray:
        """The fitted image, (h, w) or (h, w, 3), linear, from 0 to 1.

        ``mask`` and ``background`` are files or arrays; by default those that the fit was made
        with, at the paths in fit.json. Raises InputError where they are not found, and for a model
        other than ``mitchell``.
        """
        with as_guest():
            if mask is None:
                known = recorded(self.path)
                back = known.background if background is None else _values(background, "background")
                return rendered(known.model, known.mask, back, known.size)
            model = self.model
            if not isinstance(model, Mitchell):
                raise InputError(f"'{self.path}': expected a fit of mitchell, got {model.name}")
            values = _values(mask, "mask")
            back = None if background is None else _values(background, "background")
            size = values.shape if back is None else back.shape
            return rendered(model, values, back, (size[0], size[1]))

    def summary(self) -> str:
        """The report that the command line printed, as plain text."""
        # A saved fit has all that a report takes from a result.
        return summary(cast(Any, self))

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return one_line(cast(Any, self))


def load(path: str | os.PathLike[str]) -> SavedFit:
    """The fit in a fit.json, or in the folder that holds one. Raises InputError for another file.

    >>> import godfit
    >>> round(godfit.load("frame.godfit/fit.json").params["density"].value, 2)
    0.8
    """
    name = os.fspath(path)
    if os.path.isdir(name):
        name = os.path.join(name, "fit.json")
    record = read_record(name)
    absent = {"converged": False, "message": "", "undetermined": [], "starts_agreed": None}
    absent |= dict.fromkeys(("noise_levels", "rmse_levels", "psnr_db"), float("nan"))
    absent |= dict.fromkeys(("pixels", "pixels_clipped", "pixels_effective"), 0)
    known = {key: value for key, value in record.items() if value is not None}
    record = {"timing_s": {}} | absent | known
    return SavedFit(
        name, record, _estimates(record["params"]), _estimates(record.get("combined", {})),
        record.get("correlations", {}), _remarks(record, "warnings"), _remarks(record, "notes"),
    )  # fmt: skip


def render(
    fit: FitResult | SavedFit | str | os.PathLike[str],
    mask: Source | None = None,
    *,
    background: Source | None = None,
) -> np.ndarray:
    """The picture of a fit, (h, w) or (h, w, 3), linear, from 0 to 1.

    ``fit`` is a result, a saved fit or the path of a fit.json; ``mask`` and ``background`` are
    files or arrays in place of its own. Raises InputError where an image is missing, and, for
    another mask, where the model is not ``mitchell``.

    >>> import godfit
    >>> godfit.render("frame.godfit/fit.json", mask="mask.png").shape
    (96, 96)
    """
    if isinstance(fit, (str, os.PathLike)):
        fit = load(fit)
    if isinstance(fit, SavedFit):
        return fit.render(mask, background)
    if mask is None and background is None:
        return fit.render()
    if not isinstance(fit.model, Mitchell):
        raise InputError(f"render: expected a fit of mitchell with a mask, got {fit.model.name}")
    with as_guest():
        own = fit.picture.background
        back = own if background is None else _values(background, "background")
        values = fit.mask if mask is None else _values(mask, "mask")
        size = values.shape if back is None else back.shape
        return rendered(fit.model, values, back, (size[0], size[1]))


def _values(source: Source, name: str) -> np.ndarray:
    return read_source(source, "none", name).values


def _estimates(entries: dict[str, Any]) -> dict[str, Estimate]:
    found = {}
    for name, entry in entries.items():
        ends = (entry.get(key) for key in ("interval95", "posterior95"))
        interval, posterior = (None if pair is None else (pair[0], pair[1]) for pair in ends)
        flags = entry.get("fixed", False), entry.get("at_bound", False)
        found[name] = Estimate(entry["value"], entry.get("stderr"), *flags, interval, posterior)
    return found


def _remarks(record: dict[str, Any], key: str) -> tuple[str, ...]:
    """Sentences of a record, of either layout."""
    return tuple(
        r if isinstance(r, str) else Remark(r["text"], r.get("code", ""))
        for r in record.get(key, ())
    )

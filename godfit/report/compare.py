"""The result of ``godfit compare``: its table, compare.json and compare.png."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from godfit.inference.criteria import CLEAR
from godfit.io.image import LEVELS
from godfit.report.figure import (
    PANEL_PIXELS,
    as_shown,
    limit_of,
    residual_caption,
    worst_channel,
)
from godfit.report.files import PAGE, page_writer, write_result
from godfit.report.pages import compare_page
from godfit.report.record import fit_record
from godfit.report.result import FitResult
from godfit.report.sheet import QUIET, Grid, Panel, Sheet, picture
from godfit.report.style import own_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True, eq=False)
class Row:
    """A fitted model. ``parameters`` counts the numbers that were fitted and are determined, the
    noise among them."""

    name: str
    result: FitResult
    parameters: int
    aic: float
    bic: float
    seconds: float


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison:
    """Rows in the order of their BIC, the best first.

    >>> import numpy as np, godfit
    >>> godfit.Comparison((), np.zeros((2, 2))).rows
    ()
    """

    rows: tuple[Row, ...]
    target: np.ndarray

    @property
    def best(self) -> Row:
        return self.rows[0]

    @property
    def sentence(self) -> str:
        """A sentence: which model the criteria prefer, and by how much."""
        best = self.best
        model = best.result.model.name
        others = [row for row in self.rows if row.result.model.name != model]
        if not others:
            return f"{best.name} has the lowest BIC"
        ahead = others[0].bic - best.bic
        sentence = (
            f"{best.name} is preferred: its BIC is {ahead:.4g} below that of {others[0].name}"
        )
        if ahead < CLEAR:
            sentence = (
                f"{best.name} and {others[0].name} explain it alike: BIC differs by {ahead:.2g}"
            )
        if not best.result.converged:
            sentence += (
                f"; neither leaves only noise ({best.result.rmse_levels:.2f} levels rms are left)"
            )
        return sentence

    def summary(self) -> str:
        """A plain-text table."""
        wide = max(len(row.name) for row in self.rows)
        lines = [
            f"  {'model':<{wide}} {'rms':>7} {'parameters':>10} {'AIC':>13} {'BIC':>13} {'s':>6}"
        ]
        for row in self.rows:
            state = "" if row.result.converged else "  not converged"
            lines.append(
                f"  {row.name:<{wide}} {row.result.rmse_levels:7.3f} {row.parameters:>10} "
                f"{row.aic:13.1f} {row.bic:13.1f} {row.seconds:6.2f}{state}"
            )
        for row in self.rows:
            values = ", ".join(f"{k} {e.value:.6g}" for k, e in row.result.params.items())
            lines.append(f"\n  {row.name}: {values}")
            lines += [f"    {note}" for note in row.result.undetermined]
        lines += ["", f"  {self.sentence}"]
        return "\n".join(lines)

    def record(self, command: str = "") -> dict[str, Any]:
        """The contents of compare.json."""
        return _record(self, command)

    def plot(self) -> Figure:
        """The target and every fit above, what each leaves below."""
        with own_style():
            return _sheet(self).figure()

    def save(self, folder: str | os.PathLike[str], command: str = "", page: bool = True) -> None:
        """Write compare.json, compare.png and, with ``page``, report.html into ``folder``. Raises
        OSError, and warns of pictures that fail."""
        record = ("compare.json", self.record(command))
        files = {PAGE: page_writer(lambda: compare_page(self).html())} if page else {}
        write_result(Path(folder), record, ("compare.png", lambda: _sheet(self)), files)


def _record(found: Comparison, command: str) -> dict[str, Any]:
    """The contents of compare.json."""
    fits = [
        {
            "name": row.name,
            "parameters": row.parameters,
            "aic": row.aic,
            "bic": row.bic,
            "seconds": round(row.seconds, 4),
            "fit": fit_record(row.result),
        }
        for row in found.rows
    ]
    return {"schema": 1, "preferred": found.best.name, "message": found.sentence, "fits": fits,
            "command": command}  # fmt: skip


def _sheet(found: Comparison) -> Sheet:
    """The target and every fit above, what each leaves below."""
    height, width = found.target.shape[:2]
    cut = (slice(None, None, -(-max(height, width) // PANEL_PIXELS)),) * 2
    residuals = [worst_channel(row.result.residual[cut]) for row in found.rows]
    # One scale for all, which the best of them fills.
    limit = min(map(limit_of, residuals))
    target = found.rows[0].result.picture.levels[cut] / np.float32(LEVELS)
    above = [Panel("target", picture(as_shown(target)))]
    below = []
    for i, (row, residual) in enumerate(zip(found.rows, residuals, strict=True)):
        lights = np.asarray(row.result.model.light)
        fitted = as_shown(row.result.levels[cut] / np.float32(LEVELS))
        words = ((f"{row.result.rmse_levels:.2f} levels rms", QUIET),)
        above.append(Panel(row.name, picture(fitted, lights), words, strong=i == 0))
        words = ((residual_caption(row.result), QUIET),)
        title = f"{row.name}: fitted - target, levels"
        below.append(Panel(title, picture(residual, limit=limit), words, limit))
    aspect = height / width
    blocks = Grid(tuple(above), aspect), Grid(tuple(below), aspect)
    return Sheet(found.sentence, found.best.result.converged, blocks)

"""The result of ``godfit select``: its table, select.json and select.png."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from godfit.inference.criteria import CLEAR
from godfit.inference.observation import Picture
from godfit.inference.settle import Settled, Tangent
from godfit.io.image import LEVELS
from godfit.models.base import AbstractModel
from godfit.report.figure import PANEL_PIXELS, as_shown, worst_channel
from godfit.report.files import PAGE, page_writer, write_result
from godfit.report.pages import select_page
from godfit.report.record import fit_record
from godfit.report.result import FitResult
from godfit.report.sheet import INK, QUIET, Grid, Panel, Sheet, Words, picture
from godfit.report.style import own_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CHART_ASPECT = 0.2
"""Height of the chart of criteria over its width."""
LEAST_BAR = 0.1
"""Shortest bar of the chart, whose scale is logarithmic."""


@dataclasses.dataclass(frozen=True, eq=False)
class Rung:
    """A fitted model. ``shows`` names what it has beyond the rung below; ``parameters`` counts the
    fitted numbers, the noise among them. ``free`` and ``held`` are (p,), as in ``FitResult``."""

    name: str
    shows: str
    model: AbstractModel | None
    settled: Settled
    tangent: Tangent
    free: np.ndarray
    held: np.ndarray
    parameters: int

    @property
    def values(self) -> dict[str, float]:
        if self.model is None:
            (level,) = self.settled.coordinates
            return {"veil": float(level)}
        return {name: float(v) for name, v in self.model.values().items()}


@dataclasses.dataclass(frozen=True, eq=False)
class Row:
    """A rung with its criteria. ``held_out`` is the log-likelihood per value that was not fitted;
    ``behind`` is how much less that is than the best rung's, and ``behind_error`` its error."""

    rung: Rung
    rmse: float
    aic: float
    bic: float
    held_out: float
    behind: float
    behind_error: float
    like_noise: bool


@dataclasses.dataclass(frozen=True, eq=False)
class Selection:
    """Rows from the smallest model to the largest. ``equivalent`` are shaders, with their
    parameters, that draw the same picture as the recommended one; ``base`` is the fit of the whole
    shader.

    >>> import godfit
    >>> [field for field in ("rows", "chosen") if field in godfit.Selection.__annotations__]
    ['rows', 'chosen']
    """

    rows: tuple[Row, ...]
    chosen: int
    equivalent: dict[str, dict[str, float]]
    base: FitResult
    daylight: FitResult | None
    seconds: float

    @property
    def recommended(self) -> Row:
        return self.rows[self.chosen]

    @property
    def sentence(self) -> str:
        """A sentence: what the picture shows, and what it does not show."""
        row = self.recommended
        shown = [r.rung.shows for r in self.rows[1 : self.chosen + 1] if r.rung.shows]
        hidden = [r.rung.shows for r in self.rows[self.chosen + 1 :] if r.rung.shows]
        sentence = f"'{row.rung.name}' is enough: "
        sentence += f"the picture shows {_joined(shown)}" if shown else "the picture shows no rays"
        if hidden:
            sentence += f"; it does not show {_joined(hidden, 'or')}"
        if not row.like_noise:
            sentence += f"; no rung leaves only noise ({row.rmse:.2f} levels rms are left)"
        if self.daylight is not None and self.prefers_daylight:
            sentence += "; Hoffman and Preetham's daylight explains it better than any of them"
        return sentence

    @property
    def prefers_daylight(self) -> bool:
        return self.daylight is not None and (
            -2 * self.daylight.log_likelihood < self.recommended.aic - CLEAR
        )

    def summary(self) -> str:
        """A plain-text table."""
        least = min(row.bic for row in self.rows)
        wide = max(len(row.rung.name) for row in self.rows)
        lines = [
            f"    {'model':<{wide}} {'rms':>8} {'noise':>8} {'unknowns':>8} "
            f"{'AIC':>13} {'BIC':>13} {'BIC - least':>12} {'held out':>10}"
        ]
        for i, row in enumerate(self.rows):
            lines.append(
                f"  {'>' if i == self.chosen else ' '} {row.rung.name:<{wide}} {row.rmse:8.3f} "
                f"{row.rung.settled.sigma:8.3g} {row.rung.parameters:>8} {row.aic:13.1f} "
                f"{row.bic:13.1f} {row.bic - least:12.1f} {row.held_out:10.5f}"
            )
        if self.daylight is not None:
            lines.append(
                f"    hoffman-preetham: {self.daylight.rmse_levels:.3f} levels rms, "
                f"log-likelihood {self.daylight.log_likelihood:.1f}"
            )
        values = ", ".join(f"{k} {v:.6g}" for k, v in self.recommended.rung.values.items())
        lines += ["", f"  {self.recommended.rung.name}: {values}"]
        if len(self.equivalent) > 1:
            lines.append(f"  one and the same picture: {_joined(list(self.equivalent))}")
        lines += ["", f"  {self.sentence}"]
        return "\n".join(lines)

    def record(self, command: str = "") -> dict[str, Any]:
        """The contents of select.json."""
        return _record(self, command)

    def plot(self) -> Figure:
        """The target, the residual of every rung, and the criteria over the unknowns."""
        with own_style():
            return _sheet(self).figure()

    def save(self, folder: str | os.PathLike[str], command: str = "", page: bool = True) -> None:
        """Write select.json, select.png and, with ``page``, report.html into ``folder``. Raises
        OSError, and warns of pictures that fail."""
        record = ("select.json", self.record(command))
        files = {PAGE: page_writer(lambda: select_page(self).html())} if page else {}
        write_result(Path(folder), record, ("select.png", lambda: _sheet(self)), files)


def _record(found: Selection, command: str) -> dict[str, Any]:
    """The contents of select.json."""
    rows = [
        {
            "name": row.rung.name,
            "params": row.rung.values,
            "unknowns": row.rung.parameters,
            "rmse_levels": row.rmse,
            "noise_levels": row.rung.settled.sigma,
            "log_likelihood": row.rung.settled.log_likelihood,
            "aic": row.aic,
            "bic": row.bic,
            "held_out": row.held_out,
            "held_out_behind": row.behind,
            "held_out_behind_error": row.behind_error,
            "like_noise": row.like_noise,
        }
        for row in found.rows
    ]
    return {
        "schema": 1,
        "recommended": found.recommended.rung.name,
        "message": found.sentence,
        "rows": rows,
        "equivalent": found.equivalent,
        "fit": fit_record(found.base),
        "hoffman_preetham": None if found.daylight is None else fit_record(found.daylight),
        "seconds": round(found.seconds, 4),
        "command": command,
    }


def _sheet(found: Selection) -> Sheet:
    """The target, the residual of every rung, and the criteria over the unknowns."""
    image, rows = found.base.picture, found.rows
    height, width = image.size
    cut = (slice(None, None, -(-max(height, width) // PANEL_PIXELS)),) * 2
    panels = [Panel("target", picture(as_shown(image.levels[cut] / np.float32(LEVELS))))]
    # The same colours for all: the recommended one's residual must be visible as well.
    limit = max(1.0, 3 * rows[found.chosen].rmse)
    for i, row in enumerate(rows):
        residual = worst_channel(_residual(row.rung, image))[cut]
        words = ((f"fitted - target; {row.rmse:.3g} levels rms", QUIET),)
        title, strong = f"{i + 1}. {row.rung.name}", i == found.chosen
        panels.append(Panel(title, picture(residual, limit=limit), words, limit, strong=strong))
    chart = Panel("BIC above the least, by rung", _chart(found), ticks=True)
    blocks = Grid(tuple(panels), height / width), Grid((chart,), CHART_ASPECT), _rungs(found)
    return Sheet(found.sentence, found.recommended.like_noise, blocks)


def _chart(found: Selection) -> Callable[[Any], Any]:
    """What draws the criterion of every rung, with the limit from which it is clear."""
    least = min(row.bic for row in found.rows)
    ahead = [max(row.bic - least, LEAST_BAR) for row in found.rows]
    colours = ["tab:blue" if i == found.chosen else "silver" for i in range(len(ahead))]

    def draw(axes: Any) -> None:
        axes.bar(range(1, len(ahead) + 1), ahead, color=colours, bottom=LEAST_BAR / 2)
        axes.axhline(CLEAR, color="black", lw=0.8, ls="--")
        axes.set_yscale("log")
        # Powers would be set as formulas, and each takes longer than the rest of the chart.
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.minorticks_off()
        axes.set_xticks(range(1, len(ahead) + 1))
        axes.tick_params(labelsize=8)

    return draw


def _rungs(found: Selection) -> Words:
    """The rows of the chart: number, name, unknowns and residual of every rung."""
    wide = max(len(row.rung.name) for row in found.rows)
    return Words(
        tuple(
            (
                f"{i + 1}. {row.rung.name:<{wide}} {row.rung.parameters:>3} unknowns, "
                f"{row.rmse:.3g} levels rms",
                INK,
            )
            for i, row in enumerate(found.rows)
        ),
        mono=True,
    )


def _residual(rung: Rung, picture: Picture) -> np.ndarray:
    """(h, w) or (h, w, 3) fitted less target, 0 where the target is clipped, NaN where ignored."""
    if rung.model is None:
        drawn = np.full(picture.levels.shape, rung.values["veil"], np.float32)
    else:
        drawn = picture.rendered(rung.model)
    residual = np.where(picture.clipped[..., None], 0, drawn - picture.levels)
    residual = np.where(picture.valid[..., None], residual, np.nan)
    return residual if picture.channels == 3 else residual[..., 0]


def _joined(words: list[str], last: str = "and") -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}"

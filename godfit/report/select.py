"""The result of ``godfit select``: its table, select.json and select.png."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from godfit.inference.criteria import CLEAR
from godfit.inference.observation import Picture
from godfit.inference.settle import Settled, Tangent
from godfit.io.image import LEVELS
from godfit.models.base import AbstractModel
from godfit.report.figure import worst_channel
from godfit.report.files import write_result
from godfit.report.record import fit_record
from godfit.report.result import FitResult
from godfit.report.style import own_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
            return _plot(self)

    def save(self, folder: str | os.PathLike[str], command: str = "") -> None:
        """Write select.json and select.png into ``folder``. Raises OSError, and warns of
        pictures that fail."""
        record = ("select.json", self.record(command))
        write_result(Path(folder), record, ("select.png", self.plot))


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


def _plot(found: Selection) -> Figure:
    """The target, the residual of every rung, and the criteria over the unknowns."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    picture, rows = found.base.picture, found.rows
    count = len(rows) + 1
    height, width = picture.size
    tall = 2.4 * min(max(height / width, 0.3), 2.0)
    figure = Figure(figsize=(2.4 * count, tall + 3.0), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subfigures(2, 1, height_ratios=[tall + 0.4, 2.6])  # pyright: ignore
    axes = above.subplots(1, count, squeeze=False)[0]
    step = max(1, max(height, width) // 512)
    target = np.clip(picture.levels / np.float32(LEVELS), 0, 1)
    target = np.broadcast_to(target, (height, width, 3))
    axes[0].imshow(target[::step, ::step])
    axes[0].set_title("target", fontsize=9)
    residuals = [_residual(row.rung, picture) for row in rows]
    # The same colours for all: the recommended one's residual must be visible as well.
    limit = max(1.0, 3 * rows[found.chosen].rmse)
    for i, (panel, row, residual) in enumerate(zip(axes[1:], rows, residuals, strict=True)):
        shown = panel.imshow(
            worst_channel(residual)[::step, ::step], cmap="RdBu_r", vmin=-limit, vmax=limit,
            interpolation="nearest",
        )  # fmt: skip
        bold = "bold" if i == found.chosen else "normal"
        panel.set_title(f"{row.rung.name}\n{row.rmse:.3g} levels rms", fontsize=9, weight=bold)
    above.colorbar(shown, ax=list(axes[1:]), label="fitted - target, levels", shrink=0.9)
    for panel in axes:
        panel.set_xticks([])
        panel.set_yticks([])
    chart = below.add_subplot()
    least = min(row.bic for row in rows)
    ahead = [max(row.bic - least, 0.1) for row in rows]
    names = [f"{row.rung.name}\n{row.rung.parameters} unknowns" for row in rows]
    colours = ["tab:blue" if i == found.chosen else "silver" for i in range(len(rows))]
    chart.bar(names, ahead, color=colours, bottom=0.05)
    chart.axhline(CLEAR, color="black", lw=0.8, ls="--")
    chart.set_yscale("log")
    chart.set_ylabel("BIC above the least", fontsize=9)
    chart.tick_params(labelsize=8)
    chart.set_title(found.sentence, fontsize=9, wrap=True)
    return figure


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

"""What ``godfit select`` leaves: select.json and select.png."""

from __future__ import annotations

import io
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from godfit.inference.observation import LEVELS, Picture
from godfit.io.image import atomic_write
from godfit.report.text import as_json as record
from godfit.report.text import worst_channel
from godfit.studies.ladder import Rung
from godfit.studies.select import CLEAR, Selection

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def as_json(found: Selection, command: str = "") -> dict[str, Any]:
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
        "fit": record(found.base),
        "hoffman_preetham": None if found.daylight is None else record(found.daylight),
        "seconds": round(found.seconds, 4),
        "command": command,
    }


def save(found: Selection, folder: str | os.PathLike[str], command: str = "") -> None:
    """Write select.json and select.png; each appears whole or not at all. Raises OSError."""
    figure = io.BytesIO()
    plot(found).savefig(figure, format="png", dpi=100)
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    atomic_write(place / "select.png", figure.getvalue())
    text = json.dumps(as_json(found, command), indent=1, ensure_ascii=False) + "\n"
    atomic_write(place / "select.json", text.encode())


def plot(found: Selection) -> Figure:
    """The target, what every rung leaves of it, and what is left against the unknowns."""
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
    # The same colours for all: what the recommended one leaves must be seen as well.
    limit = max(1.0, 3 * rows[found.chosen].rmse)
    for i, (panel, row, left) in enumerate(zip(axes[1:], rows, residuals, strict=True)):
        shown = panel.imshow(
            worst_channel(left)[::step, ::step], cmap="RdBu_r", vmin=-limit, vmax=limit,
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
    left = np.where(picture.clipped[..., None], 0, drawn - picture.levels)
    left = np.where(picture.valid[..., None], left, np.nan)
    return left if picture.channels == 3 else left[..., 0]

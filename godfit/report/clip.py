"""The result of a clip's fit: its table, fit.json, and fit.png with the light's path."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from godfit.inference.estimates import Estimate
from godfit.models.base import AbstractModel
from godfit.report.files import write_result
from godfit.report.record import SCHEMA, estimate, remarks, versions
from godfit.report.style import own_style
from godfit.report.text import given, number, parameter_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Frame(NamedTuple):
    """The fit of one frame alone: its ``light`` (2,) with standard errors ``error`` (2,) and
    ``params`` of the scattering. ``message`` says why it is left out, "" where it is not.
    ``combined`` is as in ``FitResult``."""

    name: str
    light: np.ndarray
    error: np.ndarray
    params: dict[str, Estimate]
    combined: dict[str, Estimate]
    message: str


@dataclasses.dataclass(frozen=True, eq=False)
class ClipResult:
    """The result of a clip's fit: ``params`` of the shader with their ``covariance`` (6, 6; NaN
    where held, open, or a light's), ``frames`` in their order, ``shown`` (h, w, 3) a small copy of
    the first.

    >>> import godfit
    >>> [field for field in ("params", "frames") if field in godfit.ClipResult.__annotations__]
    ['params', 'frames']
    """

    converged: bool
    message: str
    model: AbstractModel
    params: dict[str, Estimate]
    combined: dict[str, Estimate]
    covariance: np.ndarray
    frames: tuple[Frame, ...]
    undetermined: tuple[str, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    timing_s: dict[str, float]
    shown: np.ndarray

    def summary(self) -> str:
        """The table that the command line prints, as plain text."""
        return _summary(self)

    def record(self, command: str = "") -> dict[str, Any]:
        """The contents of fit.json."""
        return _record(self, command)

    def plot(self) -> Figure:
        """A matplotlib figure: the light's path, and the shader of each frame alone."""
        with own_style():
            return _plot(self)

    def save(self, folder: str | os.PathLike[str], command: str = "") -> None:
        """Write fit.json and fit.png into ``folder``. Raises OSError, and warns of
        pictures that fail."""
        record = ("fit.json", self.record(command))
        write_result(Path(folder), record, ("fit.png", self.plot))


def _summary(result: ClipResult) -> str:
    """A plain-text table: the shader, the light of every frame, and what remains open."""
    model, frames = result.model, result.frames
    lines = [f"{model.name} model, {given(model)}, {len(frames)} frames", ""]
    lines += parameter_table(result.params)
    wide = max(5, *(len(Path(f.name).name) for f in frames))
    lines += ["", f"  {'frame':<{wide}} {'light_x':>12} {'light_y':>12}   standard errors"]
    for f in frames:
        (x, y), (dx, dy) = f.light, f.error
        remark = f"left out: {f.message}" if f.message else ""
        lines.append(
            f"  {Path(f.name).name:<{wide}} {number(x, dx):>12} {number(y, dy):>12}   "
            f"{dx:.2g}, {dy:.2g}  {remark}".rstrip()
        )
    lines += ["", f"  {result.timing_s['solve']:.1f} s"]
    lines += [f"  note: {sentence}" for sentence in result.undetermined]
    lines += [f"  warning: {sentence}" for sentence in result.warnings]
    lines += ["", f"  {'converged' if result.converged else 'not converged: ' + result.message}"]
    return "\n".join(lines)


def _record(result: ClipResult, command: str) -> dict[str, Any]:
    """The contents of fit.json: as of one picture, with ``frames`` in place of the light."""
    return {
        "schema": SCHEMA,
        "converged": result.converged,
        "message": result.message,
        "model": result.model.name,
        **result.model.settings,
        "params": {name: estimate(e) for name, e in result.params.items()},
        "combined": {name: estimate(e) for name, e in result.combined.items()},
        "frames": [
            {
                "path": f.name,
                "light_x": {"value": float(f.light[0]), "stderr": float(f.error[0])},
                "light_y": {"value": float(f.light[1]), "stderr": float(f.error[1])},
                "params": {name: estimate(e) for name, e in f.params.items()},
                "used": not f.message,
                "message": f.message,
            }
            for f in result.frames
        ],
        "undetermined": list(result.undetermined),
        "warnings": remarks(result.warnings, "warning"),
        "notes": remarks(result.notes, "note"),
        "timing_s": {k: round(v, 4) for k, v in result.timing_s.items()},
        "versions": versions(),
        "command": command,
    }


def _plot(result: ClipResult) -> Figure:
    """The light's path over the first frame, and each parameter as fitted to every frame alone,
    with a band for all of them together."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    height, width = result.shown.shape[:2]
    every = result.params | result.combined
    determined = {name: e for name, e in every.items() if e.stderr is not None}
    tall = 4.6 * min(max(height / width, 0.4), 1.5)
    figure = Figure(figsize=(5.6 + 2.6 * max(len(determined), 1), tall + 0.9), layout="constrained")
    FigureCanvasAgg(figure)
    ratios = [5.2] + [2.6] * len(determined)
    axes = figure.subplots(1, 1 + len(determined), squeeze=False, width_ratios=ratios)[0]
    axes[0].imshow(result.shown, extent=(0, 1, 0, 1), aspect=height / width)
    _path(axes[0], result)
    axes[0].set_title("the light's path, over the first frame", fontsize=10)
    places = np.arange(1, len(result.frames) + 1)
    used = np.array([not f.message for f in result.frames])
    for panel, (name, whole) in zip(axes[1:], determined.items(), strict=True):
        alone = [(f.params | f.combined)[name] for f in result.frames]
        values = np.array([e.value for e in alone])
        errors = np.array([e.stderr or np.nan for e in alone])
        for which, colour in ((used, "tab:blue"), (~used, "silver")):
            panel.errorbar(
                places[which], values[which], 1.96 * errors[which], fmt="o", ms=4, color=colour,
                elinewidth=1, capsize=2,
            )  # fmt: skip
        assert whole.stderr is not None
        low, high = whole.value - 1.96 * whole.stderr, whole.value + 1.96 * whole.stderr
        panel.axhspan(low, high, color="tab:orange", alpha=0.4, lw=0)
        reaches = np.abs(values - whole.value) + 1.96 * np.nan_to_num(errors)
        # Frames with very large errors do not set the scale.
        reach = max(1.2 * float(np.median(reaches[used])) if used.any() else 0.0, 8 * whole.stderr)
        panel.set_ylim(whole.value - reach, whole.value + reach)
        panel.set_title(f"{name}\n{number(whole.value, whole.stderr)} ± {whole.stderr:.2g}")
        panel.set_xlabel("frame")
        panel.tick_params(labelsize=8)
    state = "converged" if result.converged else "NOT CONVERGED"
    figure.suptitle(
        f"{result.model.name}, {given(result.model)}, {len(result.frames)} frames: {state}",
        fontsize=12,
        color="black" if result.converged else "firebrick",
    )
    return figure


def _path(axes: Any, result: ClipResult) -> None:
    used = [f for f in result.frames if not f.message]
    if used:
        at = np.array([f.light for f in used])
        axes.plot(at[:, 0], at[:, 1], "-", color="black", lw=2.5)
        axes.plot(at[:, 0], at[:, 1], "-", color="gold", lw=1.3)
        axes.plot(at[:, 0], at[:, 1], "o", ms=5, mfc="gold", mec="black", mew=0.8)
        axes.annotate(
            "first", at[0], xytext=(6, 6), textcoords="offset points", fontsize=8, color="gold"
        )
        low, high = np.minimum(at.min(0), 0) - 0.02, np.maximum(at.max(0), 1) + 0.02
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
    axes.tick_params(labelsize=8)

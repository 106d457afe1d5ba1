"""The result of a clip's fit: its table, fit.json, and fit.png with the light's path."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from godfit.inference.estimates import Estimate
from godfit.models.base import AbstractModel
from godfit.report.files import PAGE, page_writer, write_result
from godfit.report.pages import clip_page
from godfit.report.record import SCHEMA, estimate, remarks, versions
from godfit.report.sheet import ALARM, QUIET, Grid, Panel, Sheet, Words
from godfit.report.style import own_style
from godfit.report.text import given, number, parameter_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COVERAGE = 1.96
"""Standard errors of a 95% interval."""
CHART_ASPECT = 0.8
"""Height of a parameter's chart over its width."""
PATH_MARGIN = 0.02
"""Room about the light's path, as a share of the picture."""
MOST_ASPECT = 12.0
"""Longer side of the path's panel over its shorter one, at most: a light may leave far."""


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
    the first, ``pages`` the frames as the live page has them.


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
    pages: tuple[dict[str, Any], ...] = ()

    def summary(self) -> str:
        """The table that the command line prints, as plain text."""
        return _summary(self)

    def record(self, command: str = "") -> dict[str, Any]:
        """The contents of fit.json."""
        return _record(self, command)

    def plot(self) -> Figure:
        """A matplotlib figure: the light's path, and the shader of each frame alone."""
        with own_style():
            return _sheet(self).figure()

    def save(self, folder: str | os.PathLike[str], command: str = "", page: bool = True) -> None:
        """Write fit.json, fit.png and, with ``page``, report.html into ``folder``. Raises
        OSError, and warns of pictures that fail."""
        record = ("fit.json", self.record(command))
        files = {PAGE: page_writer(lambda: clip_page(self).html())} if page else {}
        write_result(Path(folder), record, ("fit.png", lambda: _sheet(self)), files)


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


def _sheet(result: ClipResult) -> Sheet:
    """The light's path over the first frame, and each parameter as fitted to every frame alone,
    with a band for all of them together."""
    every = result.params | result.combined
    determined = {name: e for name, e in every.items() if e.stderr is not None}
    state = "converged" if result.converged else "NOT CONVERGED"
    title = f"{result.model.name}, {given(result.model)}, {len(result.frames)} frames: {state}"
    blocks: list[Grid | Words] = [_path(result)]
    if determined:
        charts = [
            Panel(
                f"{name}: {number(e.value, e.stderr)} ± {e.stderr:.2g}", _chart(result, name, e),
                (("by frame; the band is that of all frames", QUIET),), ticks=True,
            )
            for name, e in determined.items()
        ]  # fmt: skip
        blocks.append(Grid(tuple(charts), CHART_ASPECT))
    doubts = [
        *result.undetermined,
        *result.warnings,
        *([] if result.converged else [result.message]),
    ]
    blocks.append(Words(tuple((str(text), ALARM) for text in doubts)))
    return Sheet(title, result.converged, tuple(blocks))


def _chart(result: ClipResult, name: str, whole: Estimate) -> Callable[[Any], Any]:
    """What draws a parameter over the frames."""
    stderr = whole.stderr
    assert stderr is not None
    places = np.arange(1, len(result.frames) + 1)
    used = np.array([not f.message for f in result.frames])
    alone = [(f.params | f.combined)[name] for f in result.frames]
    values = np.array([e.value for e in alone])
    errors = np.array([e.stderr or np.nan for e in alone])

    def draw(axes: Any) -> None:
        from matplotlib.ticker import MaxNLocator

        for which, colour in ((used, "tab:blue"), (~used, "silver")):
            axes.errorbar(
                places[which], values[which], COVERAGE * errors[which], fmt="o", ms=4, color=colour,
                elinewidth=1, capsize=2,
            )  # fmt: skip
        low, high = whole.value - COVERAGE * stderr, whole.value + COVERAGE * stderr
        axes.axhspan(low, high, color="tab:orange", alpha=0.4, lw=0)
        reaches = np.abs(values - whole.value) + COVERAGE * np.nan_to_num(errors)
        # Frames with very large errors do not set the scale.
        reach = max(1.2 * float(np.median(reaches[used])) if used.any() else 0.0, 8 * stderr)
        axes.set_ylim(whole.value - reach, whole.value + reach)
        axes.set_xlim(0.5, len(places) + 0.5)
        axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))
        axes.yaxis.set_major_locator(MaxNLocator(4))
        # An offset beside the axis would stand on the title.
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:.6g}")
        axes.tick_params(labelsize=8)

    return draw


def _path(result: ClipResult) -> Grid:
    """The light of every frame over the first one, whose frame it may leave."""
    height, width = result.shown.shape[:2]
    at = np.array([f.light for f in result.frames if not f.message]).reshape(-1, 2)
    low = np.minimum(at.min(0, initial=0.0), 0.0) - PATH_MARGIN
    high = np.maximum(at.max(0, initial=1.0), 1.0) + PATH_MARGIN

    def draw(axes: Any) -> None:
        axes.imshow(result.shown, extent=(0, 1, 0, 1), aspect="auto")
        axes.plot(at[:, 0], at[:, 1], "-", color="black", lw=2.5)
        axes.plot(at[:, 0], at[:, 1], "-", color="gold", lw=1.3)
        axes.plot(at[:, 0], at[:, 1], "o", ms=5, mfc="gold", mec="black", mew=0.8)
        axes.plot(at[:1, 0], at[:1, 1], "o", ms=12, mfc="none", mec="gold", mew=1.5)
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])

    tall, wide = height * (high[1] - low[1]), width * (high[0] - low[0])
    words = (("the ring is the first frame", QUIET),)
    panel = Panel("the light's path, over the first frame", draw, words)
    return Grid((panel,), float(np.clip(tall / wide, 1 / MOST_ASPECT, MOST_ASPECT)))

"""fit.png: target, fitted image, residual and parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from godfit.io.image import LEVELS, encode
from godfit.report.text import given, rows

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from godfit.report.result import FitResult

PANEL_PIXELS = 1024
"""Pixels of a panel's longer side, at most: the figure has no more for it."""
LIMIT_QUANTILE = 0.998
"""Quantile of the residual's size at which its colours end: single pixels do not set the scale."""
LEAST_LIMIT = 0.5
"""Levels at which the residual's colours end, at least: less is rounding."""


def plot(result: FitResult) -> Figure:
    """Target, fitted and residual side by side, the light marked, the parameters below."""
    # Without pyplot: it would open a window system, and its figures have to be closed.
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from godfit.report.shown_figure import ShownFigure

    picture = result.picture
    height, width = picture.size
    # More pixels than the panels have would only take memory.
    subsampled = (slice(None, None, -(-max(height, width) // PANEL_PIXELS)),) * 2
    residual = worst_channel(result.residual[subsampled])
    known = np.abs(residual[np.isfinite(residual)])
    limit = LEAST_LIMIT
    if known.size:
        limit = max(LEAST_LIMIT, float(np.quantile(known, LIMIT_QUANTILE)))
    fitted = np.asarray(encode(result.render()[subsampled], picture.transfer))
    target = picture.levels[subsampled] / np.float32(LEVELS)
    panels = [
        ("target", target if target.shape[-1] == 3 else target[..., 0]),
        ("fitted", fitted),
        ("fitted - target, levels", residual),
    ]
    if picture.foreign:
        # No mask was given: the estimated one is shown. The square root brightens faint parts.
        panels.insert(1, ("estimated mask, square root", np.sqrt(result.mask[subsampled])))
    # Laid out by hand, in inches: matplotlib's own layout draws everything several times over.
    lines = -(-len(result.params) // 2) + len(_remarks(result)) + 1
    wide, tall, gap = 4.0, 4.0 * min(max(height / width, 0.3), 2.0), 0.45
    text = max(1.35, 0.19 * lines)
    whole = (len(panels) * (wide + gap) + 0.9, tall + text + 1.0)
    figure = ShownFigure(figsize=whole)
    FigureCanvasAgg(figure)

    def place(left: float, bottom: float, right: float, top: float):
        return (
            left / whole[0], bottom / whole[1], (right - left) / whole[0], (top - bottom) / whole[1]
        )  # fmt: skip

    for column, (title, image) in enumerate(panels):
        left = gap + column * (wide + gap)
        axes = figure.add_axes(place(left, text + 0.3, left + wide, text + 0.3 + tall))
        signed = image is residual
        shown = axes.imshow(
            image,
            cmap="RdBu_r" if signed else "gray",
            vmin=-limit if signed else 0,
            vmax=limit if signed else 1,
            extent=(0, 1, 0, 1),
            aspect="auto",
            interpolation="nearest",
        )
        axes.set_title(title, fontsize=11)
        axes.set_xticks([0, 0.5, 1])
        axes.set_yticks([0, 0.5, 1])
        axes.tick_params(labelsize=8)
        if signed:
            beside = place(left + wide + 0.1, text + 0.3, left + wide + 0.25, text + 0.3 + tall)
            figure.colorbar(shown, cax=figure.add_axes(beside)).ax.tick_params(labelsize=8)
        for u, v in np.asarray(result.model.light):
            _mark_light(axes, float(u), float(v))
    _write_parameters(figure.add_axes(place(gap, 0.05, whole[0] - gap, text)), result)
    state = "converged" if result.converged else "NOT CONVERGED"
    figure.suptitle(
        f"{result.model.name}, {given(result.model)}: {state}, residual "
        f"{result.rmse_levels:.2f} levels rms",
        fontsize=12,
        y=1 - 0.12 / whole[1],
        va="top",
        color="black" if result.converged else "firebrick",
    )
    return figure


def worst_channel(residual: np.ndarray) -> np.ndarray:
    """(h, w) residual of the channel with the largest error in every pixel, with its sign."""
    if residual.ndim == 2:
        return residual
    worst = np.nan_to_num(np.abs(residual)).argmax(-1)
    return np.take_along_axis(residual, worst[..., None], -1)[..., 0]


def _mark_light(axes, u: float, v: float) -> None:
    """A ring at the light, or an arrow at the frame towards a light outside."""
    if 0 <= u <= 1 and 0 <= v <= 1:
        axes.plot(u, v, "o", ms=11, mfc="none", mec="black", mew=2.5)
        axes.plot(u, v, "o", ms=11, mfc="none", mec="gold", mew=1.3)
        return
    away = np.array([u, v]) - 0.5
    edge = 0.5 + away * (0.47 / np.abs(away).max())
    tail = edge - 0.12 * away / np.hypot(*away)
    axes.annotate(
        "",
        xy=tuple(edge),
        xytext=tuple(tail),
        arrowprops={"arrowstyle": "-|>", "color": "gold", "lw": 2.5, "ec": "black"},
    )


def _write_parameters(axes, result: FitResult) -> None:
    axes.axis("off")
    wide = max(9, *map(len, result.params))
    lines = [
        f"{name:<{wide}} {value:>12} \N{PLUS-MINUS SIGN} {error:<18} {remark}".rstrip()
        for name, value, error, remark in rows(result.params)
    ]
    half = (len(lines) + 1) // 2
    style: dict[str, Any] = {"family": "monospace", "fontsize": 9, "va": "top"}
    axes.text(0.0, 1.0, "\n".join(lines[:half]), **style)
    axes.text(0.5, 1.0, "\n".join(lines[half:]), **style)
    style |= {"family": "sans-serif", "fontsize": 8, "va": "bottom", "color": "firebrick"}
    axes.text(0.0, 0.0, "\n".join(_remarks(result)), **style)


def _remarks(result: FitResult) -> list[str]:
    """Sentences: what is open, what may be wrong, and why the fit did not converge."""
    remarks = [*result.undetermined, *result.warnings]
    return remarks + ([] if result.converged else [result.message])

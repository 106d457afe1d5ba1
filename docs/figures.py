"""The figures of concepts.md, drawn when the docs are built."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import norm

SIZE = (6.0, 2.6)


def _axes(x, y):
    figure = Figure(figsize=SIZE, layout="constrained")
    axes = figure.subplots()
    axes.set(xlabel=x, ylabel=y)
    return figure, axes


def byte():
    """The likelihood of the value behind the level 100, for three sizes of noise."""
    figure, axes = _axes("value before rounding, levels", "likelihood, largest 1")
    values = np.linspace(98, 102, 801)
    for sigma in (0.05, 0.3, 1.0):
        inside = norm.cdf((100.5 - values) / sigma) - norm.cdf((99.5 - values) / sigma)
        axes.plot(values, inside / inside.max(), label=f"noise {sigma:g} levels")
    axes.axvspan(99.5, 100.5, color="0.9")
    axes.legend()
    return figure


def bands():
    """A sum of few taps and of many along one ray across an edge of the mask."""
    figure, axes = _axes("distance from the light, share of the picture", "light pass")
    distance = np.linspace(0.05, 0.9, 1200)
    for samples, style in ((8, "-"), (100, "--")):
        taps = np.arange(1, samples + 1) * 0.8 / samples
        read = np.abs(distance[:, None] * (1 - taps)) < 0.15
        total = (0.01 ** (taps / 0.8) * read).sum(1) / samples
        axes.plot(distance, total / total.max(), style, label=f"{samples} taps")
    axes.legend()
    return figure


def undetermined():
    """The misfit over exposure and weight, which trade along a valley."""
    figure, axes = _axes("exposure", "weight")
    exposure, weight = np.meshgrid(np.linspace(0.02, 0.12, 200), np.linspace(0.2, 1.4, 200))
    misfit = ((exposure * weight - 0.04) / 0.003) ** 2 + ((exposure - 0.05) / 0.2) ** 2
    axes.contourf(exposure, weight, np.sqrt(misfit), levels=[0, 1, 2, 3, 5, 10, 30], cmap="Blues_r")
    axes.plot(np.linspace(0.03, 0.12, 90), 0.04 / np.linspace(0.03, 0.12, 90), "w--")
    axes.set_ylim(0.2, 1.4)
    return figure


def errors():
    """Intervals of twenty fits of one truth, one of which misses it."""
    figure, axes = _axes("fit", "density")
    centres = 0.8 + 0.004 * norm.ppf((np.arange(20) * 7 % 20 + 0.5) / 20)
    misses = np.abs(centres - 0.8) > 0.0078
    axes.errorbar(
        np.arange(20), centres, 0.0078, fmt="o", ecolor=["C3" if m else "C0" for m in misses]
    )
    axes.axhline(0.8, color="0.5", lw=1)
    return figure


def draw_all(folder: Path) -> None:
    """Write every figure into ``folder``."""
    folder.mkdir(exist_ok=True)
    for draw in (byte, bands, undetermined, errors):
        draw().savefig(folder / f"{draw.__name__}.png", dpi=110)

"""What draws an image into a panel of a figure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

SIGNED = "RdBu_r"
"""Colours of a residual: blue below, red above."""
DIMMED = 0.35
"""Brightness of the target under the map of information, so that its colours are visible."""
WHOLE = {"extent": (0, 1, 0, 1), "aspect": "auto"}
"""A picture fills its panel."""


@dataclass(frozen=True, eq=False)
class PanelImage:
    """Draws an image (h, w) or (h, w, 3) of [0, 1] into its panel, or with a ``limit`` levels
    between it and its negative, with the ``lights`` (u, v) marked."""

    image: np.ndarray
    lights: np.ndarray | None = None
    limit: float = 0.0

    def __call__(self, axes: Any) -> Any:
        plain = self.limit or self.image.ndim == 2
        shown = axes.imshow(
            self.image if plain else np.clip(self.image, 0, 1),
            cmap=SIGNED if self.limit else "gray",
            vmin=-self.limit if self.limit else 0,
            vmax=self.limit or 1,
            interpolation="nearest",
            **WHOLE,
        )
        for u, v in () if self.lights is None else self.lights:
            mark_light(axes, float(u), float(v))
        axes.set_xlim(0, 1)
        axes.set_ylim(0, 1)
        return shown


@dataclass(frozen=True, eq=False)
class SourceMap:
    """Draws maps (rows, columns) over the dimmed ``target`` (h, w) or (h, w, 3), each in the colour
    of its name."""

    target: np.ndarray
    maps: Mapping[str, np.ndarray]
    colours: Mapping[str, str]

    def __call__(self, axes: Any) -> Any:
        from matplotlib.colors import to_rgb

        grey = self.target if self.target.ndim == 2 else self.target.mean(-1)
        axes.imshow(np.clip(grey, 0, 1) * DIMMED, cmap="gray", vmin=0, vmax=1, **WHOLE)
        # The square root makes the faint parts visible.
        strength = {n: np.sqrt(share / max(share.max(), 1e-30)) for n, share in self.maps.items()}
        colour = sum(s[..., None] * np.array(to_rgb(self.colours[n])) for n, s in strength.items())
        alpha = np.max(list(strength.values()), 0)
        layer = np.clip(np.concatenate([np.asarray(colour), alpha[..., None]], -1), 0, 1)
        return axes.imshow(layer, interpolation="bilinear", **WHOLE)


def mark_light(axes: Any, u: float, v: float) -> None:
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

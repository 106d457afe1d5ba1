"""fit.png: target, mask, fitted image, residual, where the numbers come from, and parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from godfit.inference.noise import WITHIN_ROUNDING
from godfit.io.image import LEVELS
from godfit.report.sheet import ALARM, INK, QUIET, Grid, Line, Panel, Sheet, Words, picture, shares
from godfit.report.text import given, half_sentence, rows
from godfit.scattering.parameters import is_light

if TYPE_CHECKING:
    from godfit.report.result import FitResult

PANEL_PIXELS = 1024
"""Pixels of a panel's longer side, at most: the figure has no more for it."""
LIMIT_QUANTILE = 0.998
"""Quantile of the residual's size at which its colours end: single pixels do not set the scale."""
LEAST_LIMIT = 0.5
"""Levels at which the residual's colours end, at least: less is rounding."""
SOURCES = {"density": "#e66100", "decay": "#1a85ff", "light": "#2ca02c"}
"""The colours of what the map of information shows."""


def sheet_of(result: FitResult) -> Sheet:
    """Target, mask, fitted and residual, the light marked, the parameters below."""
    image, height, width = result.picture, *result.picture.size
    # More pixels than the panels have would only take memory.
    cut = (slice(None, None, -(-max(height, width) // PANEL_PIXELS)),) * 2
    lights = np.asarray(result.model.light)
    residual = worst_channel(result.residual[cut])
    limit = limit_of(residual)
    target = as_shown(image.levels[cut] / np.float32(LEVELS))
    fitted = as_shown(result.levels[cut] / np.float32(LEVELS))
    panels = [Panel("target", picture(target, lights))]
    mask = mask_panel(result, lights)
    panels += [mask] if mask else []
    panels += [
        Panel("fitted", picture(fitted, lights)),
        Panel(
            "fitted - target, levels", picture(residual, lights, limit),
            ((residual_caption(result), QUIET),), limit,
        ),
    ]  # fmt: skip
    maps = by_source(result.where)
    if maps:
        captions = tuple(
            (half_sentence(name, share), SOURCES[name]) for name, share in maps.items()
        )
        panels.append(Panel("where the numbers come from", shares(target, maps, SOURCES), captions))
    state = "converged" if result.converged else "NOT CONVERGED"
    title = (
        f"{result.model.name}, {given(result.model)}: {state}, residual "
        f"{result.rmse_levels:.2f} levels rms"
    )
    blocks = Grid(tuple(panels), height / width), Words(parameter_lines(result.params), mono=True)
    return Sheet(title, result.converged, (*blocks, Words(_remarks(result))))


def as_shown(image: np.ndarray) -> np.ndarray:
    """(h, w) or (h, w, 3) as a panel draws it."""
    return image[..., 0] if image.ndim == 3 and image.shape[-1] == 1 else image


def limit_of(residual: np.ndarray) -> float:
    """The level at which the colours of a residual end."""
    known = np.abs(residual[np.isfinite(residual)])
    return (
        max(LEAST_LIMIT, float(np.quantile(known, LIMIT_QUANTILE))) if known.size else LEAST_LIMIT
    )


def worst_channel(residual: np.ndarray) -> np.ndarray:
    """(h, w) residual of the channel with the largest error in every pixel, with its sign."""
    if residual.ndim == 2:
        return residual
    worst = np.nan_to_num(np.abs(residual)).argmax(-1)
    return np.take_along_axis(residual, worst[..., None], -1)[..., 0]


def mask_panel(result: FitResult, lights: np.ndarray) -> Panel | None:
    """The mask that the light pass read, given or estimated; None where it is no picture."""
    mask = result.mask
    if mask.ndim not in (2, 3) or (mask.ndim == 3 and mask.shape[-1] not in (1, 3)):
        return None
    mask = mask[(slice(None, None, -(-max(mask.shape[:2]) // PANEL_PIXELS)),) * 2]
    title = "mask"
    if result.picture.foreign:
        # The square root brightens faint parts.
        title, mask = "estimated mask, square root", np.sqrt(np.maximum(mask, 0))
    return Panel(title, picture(as_shown(mask), lights))


def residual_caption(result: FitResult) -> str:
    """A sentence on what the residual shows."""
    if not result.converged:
        return "what is left is more than noise: the model, the mask or the answer differs here"
    if result.picture.half > 0 and result.noise_levels <= WITHIN_ROUNDING:
        return "only rounding is left: as good as it gets"
    return f"what is left resembles noise of {result.noise_levels:.2g} levels"


def by_source(where: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The maps of density, decay and the lights, these together, as far as they are known."""
    found = {name: where[name] for name in ("density", "decay") if name in where}
    lights = [share for name, share in where.items() if is_light(name)]
    return found | ({"light": np.mean(lights, 0)} if lights else {})


def parameter_lines(params: Mapping[str, Any]) -> tuple[Line, ...]:
    """The rows of the table of parameters."""
    wide = max(9, *map(len, params)) if params else 9
    return tuple(
        (f"{name:<{wide}} {value:>12} \N{PLUS-MINUS SIGN} {error:<18} {remark}".rstrip(), INK)
        for name, value, error, remark in rows(params)
    )


def _remarks(result: FitResult) -> tuple[Line, ...]:
    """Sentences: what is open, what may be wrong, and why the fit did not converge."""
    remarks = [*result.undetermined, *result.warnings]
    return tuple((str(r), ALARM) for r in remarks + ([] if result.converged else [result.message]))

"""A fit as text, as JSON, as a figure, as files."""

from __future__ import annotations

import html as markup
import io
import json
import math
import os
import platform
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from godfit.inference.observation import LEVELS
from godfit.io.image import atomic_write, encode, write_image
from godfit.runtime.parallel import side_by_side

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from godfit.models.mitchell import AbstractModel
    from godfit.report.result import Estimate, FitResult

SCHEMA = 1


# Pixels of a panel's longer side, at most.
SHOWN = 1024


def number(value: float, stderr: float | None) -> str:
    """A value to the digits that its error leaves it, at least four and at most nine."""
    if stderr is None or not stderr > 0 or value == 0:
        return f"{value:.6g}"
    digits = math.floor(math.log10(abs(value))) - math.floor(math.log10(stderr)) + 2
    return f"{value:#.{min(max(digits, 4), 9)}g}".rstrip(".")


def rows(params: Mapping[str, Estimate]) -> list[tuple[str, str, str, str]]:
    """(name, value, error, remark) of every parameter."""
    return [(name, number(e.value, e.stderr), _error(e), _remark(e)) for name, e in params.items()]


def _error(e: Estimate) -> str:
    if e.stderr is None:
        return "-"
    percent = f" ({100 * e.stderr / abs(e.value):.2g}%)" if e.value else ""
    return f"{e.stderr:.2g}{percent}"


def _remark(e: Estimate) -> str:
    if e.fixed:
        return "fixed"
    if e.at_bound:
        return "at its bound"
    return "" if e.stderr is not None else "not determined"


def given(model: AbstractModel) -> str:
    """What was not fitted, in words."""
    return ", ".join(
        f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in model.settings.items()
    )


def parameter_table(params: Mapping[str, Estimate]) -> list[str]:
    """Lines: a head, and a line for every parameter."""
    wide = max(10, *map(len, params))
    head = f"  {'parameter':<{wide}} {'value':>13}   {'standard error':<18}"
    return [head] + [
        f"  {name:<{wide}} {value:>13}   {error:<18} {remark}".rstrip()
        for name, value, error, remark in rows(params)
    ]


def summary(result: FitResult) -> str:
    """A plain-text table: what was fitted, to what, how well, and what remains open."""
    model = result.model
    height, width = result.picture.size
    lines = [f"{model.name} model, {given(model)}, {width}x{height} pixels", ""]
    lines += parameter_table(result.params)
    if result.correlations:
        pairs = list(result.correlations.items())[:3]
        lines += ["", "  correlations: " + "; ".join(f"{k} {v:+.4f}" for k, v in pairs)]
    lines += [
        "",
        f"  residual {result.rmse_levels:.3f} levels rms ({result.psnr_db:.1f} dB), noise before "
        f"rounding {result.noise_levels:.3g} levels",
        f"  {result.pixels:,} pixels, {result.pixels_clipped:,} clipped; "
        f"{result.timing_s.get('solve', 0.0):.2f} s solving, "
        f"{result.timing_s.get('compile', 0.0):.2f} s compiling",
    ]
    if result.pixels_effective < result.pixels:
        lines.append(f"  correlated: worth {result.pixels_effective:,.0f} independent pixels")
    if result.starts_agreed is not None:
        lines.append("  {} of {} starts agreed".format(*result.starts_agreed))
    for name, e in result.params.items():
        for kind, ends in (("profile", e.interval), ("posterior", e.posterior)):
            if ends is not None:
                low, high = ends
                lines.append(f"  {name}: {low:.9g} to {high:.9g} (95%, {kind})")
    lines += [f"  note: {sentence}" for sentence in result.undetermined]
    lines += [f"  warning: {sentence}" for sentence in result.warnings]
    lines += ["", f"  {'converged' if result.converged else 'not converged: ' + result.message}"]
    return "\n".join(lines)


def as_json(result: FitResult, command: str = "") -> dict[str, Any]:
    """The contents of fit.json; numbers that are not finite become null."""
    model = result.model
    return {
        "schema": SCHEMA,
        "converged": result.converged,
        "message": result.message,
        "model": model.name,
        **model.settings,
        "params": {name: estimate(e) for name, e in result.params.items()},
        "combined": {name: estimate(e) for name, e in result.combined.items()},
        "correlations": {pair: round(value, 6) for pair, value in result.correlations.items()},
        "undetermined": list(result.undetermined),
        "warnings": list(result.warnings),
        "notes": list(result.notes),
        "noise_levels": _finite(result.noise_levels),
        "rmse_levels": _finite(result.rmse_levels),
        "psnr_db": _finite(result.psnr_db),
        "residual_correlation": _finite(result.residual_correlation),
        "residual_tails": _finite(result.residual_tails),
        "log_likelihood": _finite(result.log_likelihood),
        "size": list(result.picture.size[::-1]),
        "pass_size": list(result.picture.mask.shape[1::-1]),
        "transfer": result.picture.transfer,
        "pixels": result.pixels,
        "pixels_effective": round(result.pixels_effective, 1),
        "starts_agreed": result.starts_agreed,
        "pixels_clipped": result.pixels_clipped,
        "timing_s": {k: round(v, 4) for k, v in result.timing_s.items()},
        "inputs": result.inputs,
        "versions": versions(),
        "command": command,
    }


def estimate(e: Estimate) -> dict[str, Any]:
    """A parameter's entry in fit.json."""
    return {
        "value": _finite(e.value),
        "stderr": _finite(e.stderr),
        "fixed": e.fixed,
        "at_bound": e.at_bound,
        **({"interval95": list(e.interval)} if e.interval else {}),
        **({"posterior95": list(e.posterior)} if e.posterior else {}),
    }


def versions() -> dict[str, str]:
    """Of the program and what its numbers come from."""
    names = ("godfit", "jax", "jaxlib", "equinox", "optimistix", "numpy")
    return {"python": platform.python_version()} | {n: metadata.version(n) for n in names}


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def plot(result: FitResult) -> Figure:
    """Target, fitted and residual side by side, the light marked, the parameters below."""
    # Without pyplot: no window system is asked for, and nothing has to be closed.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    picture = result.picture
    height, width = picture.size
    # More than the panels have pixels to show would only take memory.
    few = (slice(None, None, -(-max(height, width) // SHOWN)),) * 2
    residual = worst_channel(result.residual[few])
    known = np.abs(residual[np.isfinite(residual)])
    limit = max(0.5, float(np.quantile(known, 0.998))) if known.size else 0.5
    fitted = np.asarray(encode(result.render()[few], picture.transfer))
    target = picture.levels[few] / np.float32(LEVELS)
    panels = [
        ("target", target if target.shape[-1] == 3 else target[..., 0]),
        ("fitted", fitted),
        ("fitted - target, levels", residual),
    ]
    if picture.foreign:
        # Nobody gave a mask: what the light pass is taken to read, faint things brightened.
        panels.insert(1, ("mask as understood, square root", np.sqrt(result.mask[few])))
    # Laid out by hand, in inches: matplotlib's own layout draws everything several times over.
    lines = -(-len(result.params) // 2) + len(_remarks(result)) + 1
    wide, tall, gap = 4.0, 4.0 * min(max(height / width, 0.3), 2.0), 0.45
    text = max(1.35, 0.19 * lines)
    whole = (len(panels) * (wide + gap) + 0.9, tall + text + 1.0)
    figure = Figure(figsize=whole)
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
    """(h, w) the channel that is farthest off in every pixel, with its sign."""
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
    """What is open, what may be wrong, and why it is not to be believed, a line each."""
    remarks = [*result.undetermined, *result.warnings]
    return remarks + ([] if result.converged else [result.message])


def save(result: FitResult, folder: str | os.PathLike[str], command: str = "") -> None:
    """Write fit.json, fit.png and render.png; each appears whole or not at all, other files in the
    folder stay. Raises OSError or ImageError."""
    figure, place, image = io.BytesIO(), Path(folder), result.render()
    place.mkdir(parents=True, exist_ok=True)

    def drawn() -> None:
        plot(result).savefig(figure, format="png", dpi=100)

    def rendered() -> None:
        write_image(place / "render.png", image, transfer=result.picture.transfer)

    side_by_side(lambda work: work(), (drawn, rendered))
    atomic_write(place / "fit.png", figure.getvalue())
    text = json.dumps(as_json(result, command), indent=1, ensure_ascii=False) + "\n"
    atomic_write(place / "fit.json", text.encode())


def html(result: FitResult) -> str:
    """A table for notebooks."""
    head = "<tr><th>parameter</th><th>value</th><th>standard error</th><th></th></tr>"
    body = "".join(
        "<tr>" + "".join(f"<td>{markup.escape(cell)}</td>" for cell in row) + "</tr>"
        for row in rows(result.params)
    )
    words = markup.escape("; ".join([result.message, *result.undetermined, *result.warnings]))
    return f"<table>{head}{body}</table><p>{words}</p>"

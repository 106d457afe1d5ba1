"""A fit as text: tables and sentences."""

from __future__ import annotations

import html as markup
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from godfit.inference.estimates import Estimate
    from godfit.models.base import AbstractModel
    from godfit.report.result import FitResult


def number(value: float, stderr: float | None) -> str:
    """A value with the digits that its error warrants, at least four and at most nine."""
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
    """The settings of a model, which are not fitted, in words."""
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
    height, width = result.size
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


def one_line(result: FitResult) -> str:
    """A result where many stand in a list: model, shader, state and values."""
    values = ", ".join(
        f"{name} {value} +- {error}" for name, value, error, _ in rows(result.params)
    )
    state = "converged" if result.converged else "not converged"
    return f"<{type(result).__name__} of {result.model.name}, {state}: {values}>"


def html(result: FitResult) -> str:
    """A table for notebooks."""
    head = "<tr><th>parameter</th><th>value</th><th>standard error</th><th></th></tr>"
    body = "".join(
        "<tr>" + "".join(f"<td>{markup.escape(cell)}</td>" for cell in row) + "</tr>"
        for row in rows(result.params)
    )
    words = markup.escape("; ".join([result.message, *result.undetermined, *result.warnings]))
    return f"<table>{head}{body}</table><p>{words}</p>"

"""A fit as text: tables and sentences."""

from __future__ import annotations

import html as markup
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from godfit.errors import Remark
from godfit.scattering.parameters import is_light

if TYPE_CHECKING:
    from godfit.inference.estimates import Estimate
    from godfit.models.base import AbstractModel
    from godfit.report.result import FitResult


UNKNOWN_SHARE = 1.0
"""Standard error, as a share of the value, from which a parameter has no number in the report: not
even its size is known. A position of a light is no size and always has one."""
ROUGH = (
    "it converged and the residual is not noise: both can be, because no mask was given and the "
    "model leaves objects and texture unexplained; the errors allow for that"
)
"""Why a fit is converged beside a warning that the residual is not noise."""
ALONE = (
    "it converged and none of {} other starts agreed: both can be, because those starts ended "
    "where the picture is explained less well"
)
"""Why a fit is converged beside other starts that disagree, with how many these are."""


def number(value: float, stderr: float | None) -> str:
    """A value with the digits that its error warrants, at least four and at most nine."""
    if stderr is None or not stderr > 0 or value == 0:
        return f"{value:.6g}"
    digits = math.floor(math.log10(abs(value))) - math.floor(math.log10(stderr)) + 2
    return f"{value:#.{min(max(digits, 4), 9)}g}".rstrip(".")


def rows(params: Mapping[str, Estimate]) -> list[tuple[str, str, str, str]]:
    """(name, value, error, remark) of every parameter; a value that is not known is a dash."""
    return [
        (name, _value(name, e), _error(name, e), _remark(name, e)) for name, e in params.items()
    ]


def is_unknown(name: str, e: Estimate) -> bool:
    """Whether the error of a parameter is as large as its value."""
    known = e.stderr is None or e.value == 0 or is_light(name)
    return not known and e.stderr >= UNKNOWN_SHARE * abs(e.value)  # type: ignore[operator]


def known_products(result: FitResult) -> dict[str, Estimate]:
    """The products that are known better than one of their factors, which the report shows."""
    found = {}
    for name, e in result.combined.items():
        factors = [result.params[n] for n in name.split("*") if n in result.params]
        loose = any(f.stderr is None and not f.fixed for f in factors) or any(
            is_unknown(n, result.params[n]) for n in name.split("*") if n in result.params
        )
        if e.stderr is not None and loose and not is_unknown(name, e):
            found[name] = e
    return found


def _value(name: str, e: Estimate) -> str:
    return "-" if is_unknown(name, e) else number(e.value, e.stderr)


def _error(name: str, e: Estimate) -> str:
    if e.stderr is None or is_unknown(name, e):
        return "-"
    percent = f" ({100 * e.stderr / abs(e.value):.2g}%)" if e.value else ""
    return f"{e.stderr:.2g}{percent}"


def _remark(name: str, e: Estimate) -> str:
    if e.fixed:
        return "fixed"
    if is_unknown(name, e):
        return "not known: its error is as large as its value"
    if e.at_bound:
        return "at its bound"
    return "" if e.stderr is not None else "not determined"


def given(model: AbstractModel) -> str:
    """The settings of a model, which are not fitted, in words."""
    return ", ".join(
        f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in model.settings.items()
        if not isinstance(value, dict)
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
    lines += [f"  {line}" for line in verdict_lines(result)] + [""]
    lines += parameter_table({**result.params, **known_products(result)})
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
    return "\n".join(lines)


def half_sentence(name: str, share: np.ndarray) -> str:
    """How small a part of the picture holds half of the information on a parameter, whose ``share``
    (rows, columns) each cell has."""
    ordered = np.sort(share.reshape(-1))[::-1]
    half = int(np.searchsorted(ordered.cumsum(), ordered.sum() / 2)) + 1
    percent = 100 * half / share.size
    return f"half of the information on {name} is in {percent:.2g}% of the picture"


def verdict_lines(result: FitResult) -> list[str]:
    """The verdict, then why it stands although something speaks against it, then what to type."""
    lines = [("" if result.converged else "not ") + "converged"]
    if not result.converged:
        lines[0] += f": {result.message}"
    codes = {getattr(w, "code", "") for w in result.warnings}
    if result.converged and "structured" in codes:
        lines.append(ROUGH)
    agreed = result.starts_agreed
    if result.converged and agreed is not None and agreed[0] == 0 and agreed[1] > 0:
        lines.append(ALONE.format(agreed[1]))
    options = [option for w in (result.message, *result.warnings) if (option := _option(w))]
    if options:
        lines.append(f"to try: {', '.join(dict.fromkeys(options))}")
    return lines


def _option(sentence: str) -> str | None:
    """The first option of the command line that a sentence names."""
    return Remark(sentence, "").option


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

"""The page of each kind of result: what stands on it, in which order."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from godfit.report.live.data import NOTEBOOK_SIDE, PAGE_SIDE, Shown, page_data
from godfit.report.live.page import Page, Section, plain, sentences, table
from godfit.report.text import given, rows

if TYPE_CHECKING:
    from godfit.inference.estimates import Estimate
    from godfit.report.result import FitResult


def parameters(params: Mapping[str, Estimate]) -> str:
    """The table of parameters with their errors."""
    return table(("parameter", "value", "standard error", ""), rows(params))


def named(result: FitResult) -> str:
    """What was fitted: the target's file, or the model without one."""
    path = result.inputs.get("target", {}).get("path", "")
    return Path(path).name if path else result.model.name


def fit_page(result: FitResult, command: str = "", notebook: bool = False) -> Page:
    """The page of a fit; in a ``notebook`` the shader runs at the first touch, on fewer pixels."""
    side, eager = (NOTEBOOK_SIDE, False) if notebook else (PAGE_SIDE, True)
    state = "converged" if result.converged else f"not converged: {result.message}"
    doubts = [*result.undetermined, *result.warnings, *result.notes]
    sections = (
        Section(
            "Target, fitted picture and difference",
            viewer=page_data(shown(result, command), side, eager),
        ),
        Section("Parameters", parameters(result.params) + sentences(doubts)),
        Section("Everything that was printed", plain(result.summary())),
    )
    title = f"{named(result)}: {result.model.name}, {given(result.model)}"
    return Page(title, state, result.converged, sections[:2] if notebook else sections)


def shown(result: FitResult, command: str = "") -> Shown:
    """The picture of a fit, for a viewer."""
    return Shown(result.model, result.picture, result.params, result.levels, result.where, command)

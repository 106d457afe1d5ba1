"""The page of each kind of result: what stands on it, in which order."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from godfit.inference.estimates import Estimate
from godfit.inference.observation import Picture, render
from godfit.io.filters import shrink
from godfit.io.image import LEVELS, encode
from godfit.report.live.data import NOTEBOOK_SIDE, PAGE_SIDE, Shown, clip_data, page_data
from godfit.report.live.page import Page, Section, plain, sentences, table
from godfit.report.text import given, rows

if TYPE_CHECKING:
    from godfit.models.base import AbstractModel
    from godfit.report.clip import ClipResult
    from godfit.report.compare import Comparison
    from godfit.report.record import Recorded
    from godfit.report.result import FitResult
    from godfit.report.select import Rung, Selection
    from godfit.report.simplify import Simpler

PRINTED = "Everything that was printed"
"""Heading of the summary."""


def parameters(params: Mapping[str, Estimate]) -> str:
    """The table of parameters with their errors."""
    return table(("parameter", "value", "standard error", ""), rows(params))


def named(result: FitResult) -> str:
    """What was fitted: the target's file, or the model without one."""
    path = result.inputs.get("target", {}).get("path", "")
    return Path(path).name if path else result.model.name


def shown(result: FitResult, command: str = "") -> Shown:
    """The picture of a fit, for a viewer."""
    return Shown(result.model, result.picture, result.params, result.levels, result.where, command)


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
        Section(PRINTED, plain(result.summary())),
    )
    title = f"{named(result)}: {result.model.name}, {given(result.model)}"
    # A notebook has the table already.
    return Page(title, state, result.converged, sections[:1] if notebook else sections)


def clip_page(result: ClipResult) -> Page:
    """The page of a clip: its shader on every frame, with the frame's own light."""
    count, whole = len(result.pages), len(result.frames)
    viewers = []
    if count:
        note = f"the first {count} of {whole} frames" if count < whole else f"{whole} frames"
        viewer = clip_data(result.pages, result.model, result.params)
        viewers = [Section(f"The shader of all frames on {note}", viewer=viewer)]
    state = "converged" if result.converged else f"not converged: {result.message}"
    doubts = [*result.undetermined, *result.warnings, *result.notes]
    sections = (
        *viewers,
        Section("Parameters", parameters(result.params) + sentences(doubts)),
        Section(PRINTED, plain(result.summary())),
    )
    title = f"{whole} frames: {result.model.name}, {given(result.model)}"
    return Page(title, state, result.converged, sections)


def compare_page(found: Comparison) -> Page:
    """The page of a comparison: the criteria, and a viewer for every model."""
    head = ("model", "levels rms", "parameters", "AIC", "BIC", "")
    criteria = [
        (
            row.name, f"{row.result.rmse_levels:.3f}", str(row.parameters), f"{row.aic:.1f}",
            f"{row.bic:.1f}", "" if row.result.converged else "not converged",
        )
        for row in found.rows
    ]  # fmt: skip
    fits = [
        Section(
            row.name,
            parameters(row.result.params) + sentences(row.result.undetermined),
            page_data(shown(row.result), NOTEBOOK_SIDE, i == 0),
        )
        for i, row in enumerate(found.rows)
    ]
    title = f"{named(found.best.result)}: models compared"
    sections = (Section("Criteria", table(head, criteria)), *fits)
    return Page(title, found.sentence, found.best.result.converged, sections)


def select_page(found: Selection) -> Page:
    """The page of a selection: the ladder, the recommended rung first, then the others."""
    least = min(row.bic for row in found.rows)
    head = ("model", "levels rms", "noise", "unknowns", "BIC above the least", "held out")
    ladder = [
        (
            row.rung.name, f"{row.rmse:.3f}", f"{row.rung.settled.sigma:.3g}",
            str(row.rung.parameters), f"{row.bic - least:.1f}", f"{row.held_out:.5f}",
        )
        for row in found.rows
    ]  # fmt: skip
    order = sorted(range(len(found.rows)), key=lambda i: (i != found.chosen, i))
    viewers = [
        Section(rung.name, viewer=page_data(view, NOTEBOOK_SIDE, i == found.chosen))
        for i in order
        for rung in [found.rows[i].rung]
        for view in [_rung_shown(rung, found.base.picture)]
        if view is not None
    ]
    alike = list(found.equivalent) if len(found.equivalent) > 1 else []
    sections = (
        Section(
            "The ladder",
            table(head, ladder) + sentences(f"{name} draws the same picture" for name in alike),
        ),
        *viewers,
        Section(PRINTED, plain(found.summary())),
    )
    title = f"{named(found.base)}: the smallest model"
    return Page(title, found.sentence, found.recommended.like_noise, sections)


def _rung_shown(rung: Rung, picture: Picture) -> Shown | None:
    """The picture of a rung, for a viewer; None for a constant veil."""
    if rung.model is None:
        return None
    # A rung's parameters have no errors here.
    held = zip(rung.model.values().items(), rung.free, strict=True)
    params = {name: Estimate(float(v), None, not free) for (name, v), free in held}
    return Shown(rung.model, picture, params, picture.rendered(rung.model))


def simplify_page(found: Simpler, images: Recorded) -> Page:
    """The page of a simplification: the cheap setting against the full one, on the fit's images."""
    full = drawn(found.full, images)
    low = images
    if found.scale < 1:
        h, w = (max(1, round(n * found.scale)) for n in images.mask.shape[:2])
        low = dataclasses.replace(images, mask=shrink(images.mask, (h, w)))
    simpler = drawn(found.model, low)
    viewer = given_data(found.model, as_picture(low, full), simpler)
    title = "The full picture, the simpler one and the difference"
    sections = Section(title, viewer=viewer), Section(PRINTED, plain(found.summary()))
    return Page(f"{found.full.shader}: fewer samples", found.sentence, True, sections)


def render_page(images: Recorded) -> Page:
    """A page to play with a mask: no fit, the rendered picture is the target."""
    levels = drawn(images.model, images)
    viewer = given_data(images.model, as_picture(images, levels), levels)
    title = f"{images.model.name}, {given(images.model)}"
    words = "rendered with given numbers, not fitted"
    return Page(title, words, True, (Section("The picture", viewer=viewer),))


def drawn(model: AbstractModel, images: Recorded) -> np.ndarray:
    """(h, w, c) levels of a model on images, not rounded."""
    image = render(model, images.mask, images.background, images.size)
    levels = LEVELS * np.asarray(encode(image, images.transfer), np.float32)
    return levels.reshape(*images.size, -1)


def as_picture(images: Recorded, levels: np.ndarray) -> Picture:
    """Images with ``levels`` (h, w, c) as their target."""
    background = images.background
    if background is not None:
        background = background.reshape(*images.size, -1)
    valid = np.ones(images.size, bool)
    return Picture(levels, 0.5, valid, images.mask, background, images.transfer)


def given_data(model: AbstractModel, picture: Picture, levels: np.ndarray) -> dict[str, Any]:
    """The data of a viewer of a model whose parameters are given, and have no errors."""
    params = {name: Estimate(float(v), None, True) for name, v in model.values().items()}
    return page_data(Shown(model, picture, params, levels, fixed="given"))


def record_page(record: Mapping[str, Any], images: Recorded, target: np.ndarray) -> Page:
    """The page of a fit.json, from its images and the ``target`` (h, w, c) in levels."""
    params = {
        name: Estimate(
            float(entry["value"]), entry.get("stderr"), bool(entry.get("fixed")),
            bool(entry.get("at_bound")),
        )
        for name, entry in record["params"].items()
    }  # fmt: skip
    levels = np.broadcast_to(drawn(images.model, images), target.shape)
    command = record.get("command") or ""
    view = Shown(images.model, as_picture(images, target), params, levels, command=command)
    sections = (
        Section("Target, fitted picture and difference", viewer=page_data(view)),
        Section("Parameters", parameters(params) + sentences(images.notes)),
    )
    message = str(record.get("message") or "")
    title = f"{images.model.name}, {given(images.model)}"
    return Page(title, message, bool(record.get("converged")), sections)

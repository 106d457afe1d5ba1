"""A comparison of models on one picture: Mitchell's sum, Hoffman and Preetham's daylight and, with
a canvas, the light in the plane.

All are fitted to the same values with the same likelihood, once with the light held where the scene
has it and once with the light free. They are compared by Akaike's and Schwarz's criteria (Burnham &
Anderson, Model Selection and Multimodel Inference, 2002, ch. 2): twice the negative log-likelihood,
plus 2 or ln(values) for every parameter that the picture determines, the noise among them.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from godfit.fitting import fit
from godfit.flatland import fit_setup as plane
from godfit.flatland.model import Flatland
from godfit.inference.criteria import aic, bic
from godfit.io.sources import Source, read_source
from godfit.models.hoffman_preetham import HoffmanPreetham
from godfit.models.mitchell import Mitchell
from godfit.report.compare import Comparison, Row
from godfit.runtime.guest import as_guest
from godfit.scenes.scene import Scene, read_scene
from godfit.scenes.view import framed, in_single_precision, light_on_screen

if TYPE_CHECKING:
    pass


def compare(
    target: Source,
    *,
    mask: Source | None = None,
    scene: Scene | str | os.PathLike[str] | None = None,
    canvas: plane.CanvasSource | None = None,
    rays: int | None = None,
    light: tuple[float, float] | None = None,
    fov: float | None = None,
    distance: float | np.ndarray | None = None,
    shader: str | None = None,
    lights: int = 1,
    progress: Callable[[str], None] | None = None,
    **options: Any,
) -> Comparison:
    """Fit both models, and with a ``canvas`` that of the plane; arguments are those of
    `godfit.fit`. ``light`` (u, v), or the scene's, is where the light is held; without either, only
    the fits with a free light are made.

    >>> import godfit
    >>> godfit.compare("frame.png", mask="frame.png")
    Traceback (most recent call last):
    ...
    godfit.errors.InputError: mask: expected another image than the target, got the same one; ...
    """
    say = progress or (lambda text: None)
    picture = read_source(target, options.get("transfer", "none"))
    place: dict[str, float] = {}
    if scene is not None and not isinstance(scene, Scene):
        scene = read_scene(scene)
    if light is not None:
        place = {"light_x": light[0], "light_y": light[1]}
    elif scene is not None:
        with as_guest():
            place = light_on_screen(in_single_precision(framed(scene, picture)))
    kinds: list[tuple[str, dict[str, Any]]] = [
        (Mitchell.name, {"shader": shader, "lights": lights}),
        (HoffmanPreetham.name, {"fov": fov, "distance": distance}),
    ]
    shared = {"mask": mask, "scene": scene, "progress": say}
    rows = []
    for name, extra in kinds:
        given = shared | {"model": name} | extra | options
        free = f"{name}, light free"
        if place:
            say(name)
            rows.append(_row(name, picture, given | {"fix": place}))
        say(free)
        row = _row(free, picture, given)
        if place and row.result.log_likelihood < rows[-1].result.log_likelihood:
            # A light that may move explains no less than one that may not: it starts there.
            at = {n: e.value for n, e in rows[-1].result.params.items()}
            again = _row(free, picture, given | {"start": at | dict(options.get("start") or {})})
            row = max(row, again, key=lambda r: r.result.log_likelihood)
        rows.append(row)
    if canvas is not None:
        # A shader's samples, its pass scale and its background do not apply to the plane.

        away = ("samples", "pass_scale", "background")
        extra = {"model": Flatland.name, "canvas": canvas, "rays": rays, "progress": say}
        extra |= {k: v for k, v in options.items() if k not in away}
        say(Flatland.name)
        rows.append(_row(Flatland.name, picture, extra))
    rows.sort(key=lambda row: row.bic)
    return Comparison(tuple(rows), picture.values)


def _row(title: str, target: Source, options: Mapping[str, Any]) -> Row:
    """One fit judged; ``options`` are those of ``fit``."""
    began = time.perf_counter()
    # Three channels for all, so that likelihoods can be compared.
    result = fit(target, channels=3, inquire=False, **options)
    known = [e for e in result.params.values() if not e.fixed and e.stderr is not None]
    parameters = len(known) + 1
    values = result.pixels * result.picture.channels
    return Row(
        title,
        result,
        parameters,
        aic(result.log_likelihood, parameters),
        bic(result.log_likelihood, parameters, values),
        time.perf_counter() - began,
    )

"""Which model a picture deserves: Mitchell's sum, Hoffman and Preetham's daylight or, where there
is a canvas, the light in the plane.

All are fitted to the same values with the same likelihood, with the light where the scene has it
and with the light free, and judged by Akaike's and Schwarz's criteria (Burnham & Anderson, Model
Selection and Multimodel Inference, 2002, ch. 2): twice the negative log-likelihood, plus 2 or
ln(values) for every parameter that the picture determines, the noise among them.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from godfit.fitting import fit
from godfit.flatland import fit_setup as plane
from godfit.flatland.model import Flatland
from godfit.io.sources import Source, read_source
from godfit.models.hoffman_preetham import HoffmanPreetham
from godfit.models.mitchell import Mitchell
from godfit.report.compare import Comparison, Row
from godfit.scenes.scene import Scene, read_scene
from godfit.scenes.view import in_single_precision, light_on_screen

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
    `godfit.fit`. ``light`` (u, v), or the scene's, is where the fits with a given light hold it;
    without either there are none of these."""
    say = progress or (lambda text: None)
    picture = read_source(target, options.get("transfer", "none"))
    place: dict[str, float] = {}
    if scene is not None and not isinstance(scene, Scene):
        scene = read_scene(scene)
    if light is not None:
        place = {"light_x": light[0], "light_y": light[1]}
    elif scene is not None:
        with jax.enable_x64(False):
            place = light_on_screen(in_single_precision(scene))
    kinds: list[tuple[str, dict[str, Any]]] = [
        (Mitchell.name, {"shader": shader, "lights": lights}),
        (HoffmanPreetham.name, {"fov": fov, "distance": distance}),
    ]
    rows = []
    for name, extra in kinds:
        for fix in [place, {}] if place else [{}]:
            title = name + ("" if fix else ", light free")
            say(title)
            rows.append(_row(title, picture, mask, scene, name, fix, extra | options, say))
    if canvas is not None:
        # Neither a shader's settings nor the pass it lays its light on mean anything there.
        away = ("samples", "pass_scale", "background")
        extra = {"canvas": canvas, "rays": rays}
        extra |= {k: v for k, v in options.items() if k not in away}
        say(Flatland.name)
        rows.append(_row(Flatland.name, picture, None, None, Flatland.name, {}, extra, say))
    rows.sort(key=lambda row: row.bic)
    return Comparison(tuple(rows), picture.values)


def _row(
    title: str,
    target: Source,
    mask: Source | None,
    scene: Scene | None,
    model: str,
    fix: Mapping[str, float],
    options: Mapping[str, Any],
    say: Callable[[str], None],
) -> Row:
    began = time.perf_counter()
    result = fit(
        target,
        mask=mask,
        scene=scene,
        model=model,
        fix=fix,
        channels=3,
        inquire=False,
        progress=say,
        **options,
    )
    known = [e for e in result.params.values() if not e.fixed and e.stderr is not None]
    parameters = len(known) + 1
    values = result.pixels * result.picture.channels
    cost = -2 * result.log_likelihood
    return Row(
        title,
        result,
        parameters,
        2 * parameters + cost,
        parameters * math.log(values) + cost,
        time.perf_counter() - began,
    )

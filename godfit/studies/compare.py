"""Which model a picture deserves: Mitchell's sum, Hoffman and Preetham's daylight or, where there
is a canvas, the light in the plane.

All are fitted to the same values with the same likelihood, with the light where the scene has it
and with the light free, and judged by Akaike's and Schwarz's criteria (Burnham & Anderson, Model
Selection and Multimodel Inference, 2002, ch. 2): twice the negative log-likelihood, plus 2 or
ln(values) for every parameter that the picture determines, the noise among them.
"""

from __future__ import annotations

import dataclasses
import io
import json
import math
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from godfit import request as inputs
from godfit.fitting import fit
from godfit.flatland import inputs as plane
from godfit.flatland.model import Flatland
from godfit.inference.observation import LEVELS
from godfit.io.image import atomic_write, encode
from godfit.models.hoffman_preetham import HoffmanPreetham
from godfit.models.mitchell import Mitchell
from godfit.report.result import FitResult
from godfit.request import Source
from godfit.scenes.scene import Scene, read_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# A difference in a criterion that leaves the lesser model little support (Burnham & Anderson 2.6).
CLEAR = 10.0


@dataclasses.dataclass(frozen=True, eq=False)
class Row:
    """One model fitted. ``parameters`` counts what was fitted and is determined, the noise too."""

    name: str
    result: FitResult
    parameters: int
    aic: float
    bic: float
    seconds: float


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison:
    """Rows in the order of their BIC, the best first."""

    rows: tuple[Row, ...]
    target: np.ndarray

    @property
    def best(self) -> Row:
        return self.rows[0]

    @property
    def sentence(self) -> str:
        """What the picture says about the models, in words."""
        best = self.best
        model = best.result.model.name
        others = [row for row in self.rows if row.result.model.name != model]
        if not others:
            return f"{best.name} has the lowest BIC"
        ahead = others[0].bic - best.bic
        said = f"{best.name} is preferred: its BIC is {ahead:.4g} below that of {others[0].name}"
        if ahead < CLEAR:
            said = f"{best.name} and {others[0].name} explain it alike: BIC differs by {ahead:.2g}"
        if not best.result.converged:
            said += (
                f"; neither leaves only noise ({best.result.rmse_levels:.2f} levels rms are left)"
            )
        return said

    def summary(self) -> str:
        """A plain-text table."""
        wide = max(len(row.name) for row in self.rows)
        lines = [
            f"  {'model':<{wide}} {'rms':>7} {'parameters':>10} {'AIC':>13} {'BIC':>13} {'s':>6}"
        ]
        for row in self.rows:
            state = "" if row.result.converged else "  not converged"
            lines.append(
                f"  {row.name:<{wide}} {row.result.rmse_levels:7.3f} {row.parameters:>10} "
                f"{row.aic:13.1f} {row.bic:13.1f} {row.seconds:6.2f}{state}"
            )
        for row in self.rows:
            values = ", ".join(f"{k} {e.value:.6g}" for k, e in row.result.params.items())
            lines.append(f"\n  {row.name}: {values}")
            lines += [f"    {note}" for note in row.result.undetermined]
        lines += ["", f"  {self.sentence}"]
        return "\n".join(lines)


def compare(
    target: Source,
    *,
    mask: Source | None = None,
    scene: Scene | str | os.PathLike[str] | None = None,
    canvas: plane.Source | None = None,
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
    picture = inputs.image(target, options.get("transfer", "none"))
    place: dict[str, float] = {}
    if scene is not None and not isinstance(scene, Scene):
        scene = read_scene(scene)
    if light is not None:
        place = {"light_x": light[0], "light_y": light[1]}
    elif scene is not None:
        with jax.enable_x64(False):
            place = inputs.place_of(inputs.single(scene))
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


def as_json(found: Comparison, command: str = "") -> dict[str, Any]:
    """The contents of compare.json."""
    from godfit.report.text import as_json as record

    fits = [
        {
            "name": row.name,
            "parameters": row.parameters,
            "aic": row.aic,
            "bic": row.bic,
            "seconds": round(row.seconds, 4),
            "fit": record(row.result),
        }
        for row in found.rows
    ]
    return {"schema": 1, "preferred": found.best.name, "message": found.sentence, "fits": fits,
            "command": command}  # fmt: skip


def save(found: Comparison, folder: str | os.PathLike[str], command: str = "") -> None:
    """Write compare.json and compare.png; each appears whole or not at all. Raises OSError."""
    figure = io.BytesIO()
    plot(found).savefig(figure, format="png", dpi=100)
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    atomic_write(place / "compare.png", figure.getvalue())
    text = json.dumps(as_json(found, command), indent=1, ensure_ascii=False) + "\n"
    atomic_write(place / "compare.json", text.encode())


def plot(found: Comparison) -> Figure:
    """The target and every fit above, what each leaves below."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from godfit.report.text import worst_channel

    count = len(found.rows) + 1
    height, width = found.target.shape[:2]
    tall = 3.0 * min(max(height / width, 0.3), 2.0)
    figure = Figure(figsize=(3.2 * count, 2 * tall + 1.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, count, squeeze=False)
    step = max(1, max(height, width) // 768)
    residuals = [worst_channel(row.result.residual) for row in found.rows]
    limit = max(1.0, min(float(np.nanquantile(np.abs(r), 0.99)) for r in residuals))
    picture = found.rows[0].result.picture
    axes[0, 0].imshow(np.clip(picture.levels / np.float32(LEVELS), 0, 1)[::step, ::step])
    axes[0, 0].set_title("target", fontsize=10)
    axes[1, 0].axis("off")
    axes[1, 0].text(0, 1, found.sentence, wrap=True, va="top", fontsize=9)
    for i, (row, residual) in enumerate(zip(found.rows, residuals, strict=True), 1):
        fitted = np.asarray(encode(row.result.render(), picture.transfer))
        axes[0, i].imshow(fitted[::step, ::step])
        axes[0, i].set_title(f"{row.name}\n{row.result.rmse_levels:.2f} levels rms", fontsize=10)
        shown = axes[1, i].imshow(
            residual[::step, ::step], cmap="RdBu_r", vmin=-limit, vmax=limit,
            interpolation="nearest",
        )  # fmt: skip
    figure.colorbar(shown, ax=axes[1, 1:], label="fitted - target, levels", shrink=0.9)
    for panel in axes.flat:
        panel.set_xticks([])
        panel.set_yticks([])
    return figure

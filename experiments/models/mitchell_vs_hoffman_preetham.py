"""What is Mitchell's sum worth against light that really is scattered, and what the analytic model?

    python experiments/models/mitchell_vs_hoffman_preetham.py [--quick] [--figure FILE]

Targets are marched (``godfit.models.volume``): a sun over a box between the camera and the horizon,
over turbidity, the sun's elevation, g, optical depth and the size of the box; 96x96 bytes, exposed
so that the brightest channel's 98th percentile is 230 levels. Mitchell is given what shaders have,
in the picture's mean colour and behind the black box: a bright disc on a dim sky, and a sky that is
bright all over; the better of the two counts. Hoffman-Preetham is given where the sky is seen and
how far things are. The light is free for both.

Printed: how often each is within 1, 2 and 4 levels rms, how Mitchell's kappa follows the optical
depth and its gain E_sun beta/beta_ex, whether `godfit compare` names the model that the map has
ahead, and two pictures that neither can show.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import tempfile
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from godfit import FitResult, InputError, fit, rasterise
from godfit.models.atmosphere import Air
from godfit.models.build import view_of_scene
from godfit.models.volume import render
from godfit.scenes.scene import Scene, read_scene
from godfit.studies.compare import compare
from tests.support import random_targets

SIZE, FAR = 96, 12.0
AXES = {
    "turbidity": (1.5, 5.0),
    "depth": (0.1, 0.5, 1.5),
    "size": (0.5, 1.0, 2.0),
    "elevation": (8.0, 25.0, 45.0),
    "g": (0.3, 0.76, 0.9),
}
LEVELS = (1.0, 2.0, 4.0)
# Targets that are put to `compare`, of either kind.
COMPARED = 8
# Of a sky under a bright disc (DawnTime's), and of one that is bright itself.
SKIES = (0.07, 1.0)
MODELS = ("mitchell", "hoffman-preetham")


@dataclasses.dataclass(frozen=True)
class Case:
    """One target: its setting, what was fitted to it (rms levels by model) and what with."""

    setting: dict[str, float]
    rms: dict[str, float]
    kappa: float
    gain: float
    radiance: float
    depth: float


def stage(folder: Path, setting: dict[str, float], x: float = 0.4) -> Scene:
    """A box before a camera that looks level along -z, the sun ahead and up."""
    up = np.tan(np.radians(setting["elevation"]))
    size = setting["size"]
    (folder / "scene.toml").write_text(
        f"[image]\nwidth = {SIZE}\nheight = {SIZE}\n"
        f"[camera]\nposition = [0, 0, 0]\ntarget = [0, 0, -1]\nfov_y = 70\nfar = {FAR}\n"
        f"[light]\nposition = [0, {1e3 * up:.6f}, -1000]\nradius = {60 * np.hypot(1, up):.3f}\n"
        f'[[object]]\nprimitive = "box"\nsize = [{size}, {size}, {size}]\n'
        f"position = [{x}, {0.5 * 5 * up if up < 0.7 else 1.5}, -5]\nrotation = [20, 30, 0]\n"
    )
    return read_scene(folder / "scene.toml")


def air_for(setting: dict[str, float]) -> Air:
    """Air of the depth wanted, at 570 nm over the whole view."""
    thin = Air(setting["turbidity"], setting["g"], 1.0, 1.0)
    return Air(
        setting["turbidity"], setting["g"], 1.0, setting["depth"] / (float(thin.beta_ex[1]) * FAR)
    )


def target_of(scene: Scene, air: Air) -> tuple[np.ndarray, float]:
    """Bytes, and the exposure that made them."""
    distance = np.asarray(view_of_scene(scene).distance)
    image = render(scene, air, distance, steps=256)
    exposure = 230 / 255 / float(np.quantile(image.max(-1), 0.98))
    return random_targets.to_bytes(image * exposure), exposure


def shader_mask(scene: Scene, target: np.ndarray, sky: float) -> np.ndarray:
    """Disc and sky, of so much of it, in the target's mean colour, as bytes."""
    colour = target.reshape(-1, 3).mean(0)
    colour = colour / colour.max()

    def dimmed(share: float) -> tuple[float, float, float]:
        r, g, b = (float(c) * share for c in colour)
        return r, g, b

    # The disc is far beyond the camera's reach in this air; a shader draws it all the same.
    camera = dataclasses.replace(scene.camera, far=1e6)
    light = dataclasses.replace(scene.light, colour=dimmed(1.0))
    drawn = dataclasses.replace(scene, camera=camera, light=light, background=dimmed(sky))
    return np.round(255 * np.asarray(rasterise(drawn))).astype(np.uint8)


def both(scene: Scene, target: np.ndarray) -> tuple[FitResult, FitResult]:
    """Mitchell with the mask that suits it, and Hoffman and Preetham."""
    sums = [
        fit(target, mask=shader_mask(scene, target, sky), shader="mitchell", samples=100)
        for sky in SKIES
    ]
    day = fit(target, scene=scene, model="hoffman-preetham", samples=100)
    return min(sums, key=lambda found: found.rmse_levels), day


def case(setting: dict[str, float], folder: Path) -> Case:
    scene, air = stage(folder, setting), air_for(setting)
    target, exposure = target_of(scene, air)
    sum_, day = both(scene, target)
    _, kappa, _, gain, *_ = np.asarray(sum_.model.coordinates())
    # Towards the middle of the frame, in green.
    ahead = np.cos(np.radians(setting["elevation"]))
    beta = float(air.scattered(jnp.asarray(ahead))[1] / air.beta_ex[1])
    return Case(
        setting,
        {"mitchell": sum_.rmse_levels, "hoffman-preetham": day.rmse_levels},
        float(kappa),
        float(gain),
        exposure * beta,
        setting["depth"],
    )


def agreement(found: list[Case], folder: Path) -> None:
    """Whether `compare`, given the scene alone, names the model that the map has ahead: where
    neither is near, which is less far off depends on the mask, and there it need not."""
    for what, part in (
        (
            f"within {LEVELS[-1]:g} levels of",
            [c for c in found if min(c.rms.values()) <= LEVELS[-1]],
        ),
        ("further off than that from", [c for c in found if min(c.rms.values()) > LEVELS[-1]]),
    ):
        chosen = part[:: max(1, -(-len(part) // COMPARED))]
        agreed = 0
        for one in chosen:
            scene = stage(folder, one.setting)
            target, _ = target_of(scene, air_for(one.setting))
            best = compare(target, scene=scene, shader="mitchell", samples=100).best
            agreed += best.result.model.name == min(one.rms, key=lambda model: one.rms[model])
        print(
            f"compare names the model that the map has ahead in {agreed} of {len(chosen)} targets "
            f"that the better one is {what}"
        )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true", help="the ends of every axis alone")
    parser.add_argument("--figure")
    options = parser.parse_args()
    axes = {k: (v[0], v[-1]) if options.quick else v for k, v in AXES.items()}
    found = []
    with tempfile.TemporaryDirectory() as name:
        for values in itertools.product(*axes.values()):
            found.append(case(dict(zip(axes, values, strict=True)), Path(name)))
        report(found)
        agreement(found, Path(name))
        beyond(Path(name))
    if options.figure:
        draw(found, axes, options.figure)


def report(found: list[Case]) -> None:
    print(f"{len(found)} marched targets; within so many levels rms:")
    for model in MODELS:
        rms = np.array([c.rms[model] for c in found])
        shares = ", ".join(f"{level:g}: {np.mean(rms <= level):.0%}" for level in LEVELS)
        print(f"  {model:<17} {shares}; median {np.median(rms):.2f}, worst {rms.max():.2f}")
    for axis in AXES:
        for value in sorted({c.setting[axis] for c in found}):
            part = [c for c in found if c.setting[axis] == value]
            words = ", ".join(f"{m} {np.median([c.rms[m] for c in part]):.2f}" for m in MODELS)
            print(f"  {axis} {value:g}: median {words}")
    for name, one, other in (
        ("kappa against optical depth", [c.kappa for c in found], [c.depth for c in found]),
        ("gain against E_sun beta/beta_ex", [c.gain for c in found], [c.radiance for c in found]),
    ):
        both = np.log(np.maximum(np.array([one, other]), 1e-6))
        slope = np.polyfit(both[1], both[0], 1)[0]
        print(f"{name}: correlation of logarithms {np.corrcoef(both)[0, 1]:.2f}, slope {slope:.2f}")


def beyond(folder: Path) -> None:
    """What neither can show."""
    setting = {"turbidity": 3.0, "depth": 0.8, "size": 2.0, "elevation": 25.0, "g": 0.76}
    print("what neither can show:")
    for name, x in (("an occluder in the frame", 0.4), ("the same outside it", 5.6)):
        scene, air = stage(folder, setting, x), air_for(setting)
        target, _ = target_of(scene, air)
        rms = [found.rmse_levels for found in both(scene, target)]
        print(f"  {name}: mitchell {rms[0]:.2f}, hoffman-preetham {rms[1]:.2f} levels rms")
    try:
        stage(folder, setting | {"elevation": 115.0})
    except InputError as error:
        print(f"  the light behind: refused ({str(error).split(': ', 1)[1][:60]}...)")
    print("  light scattered more than once: not in the march either (Mitsuba: a third more)")


def draw(found: list[Case], axes: dict[str, tuple[float, ...]], path: str) -> None:
    from matplotlib.colors import BoundaryNorm, ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    across, down = ("turbidity", "depth", "size"), ("elevation", "g")
    columns = list(itertools.product(*(axes[a] for a in across)))
    rows = list(itertools.product(*(axes[a] for a in down)))
    colours = ListedColormap(["#1a6b3c", "#7fbf7b", "#f5d76e", "#c0504d"])
    norm = BoundaryNorm([0, *LEVELS, 256], 4)
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for axis, model in zip(panels, MODELS, strict=True):
        grid = np.full((len(rows), len(columns)), np.nan)
        for c in found:
            row = rows.index(tuple(c.setting[a] for a in down))
            grid[row, columns.index(tuple(c.setting[a] for a in across))] = c.rms[model]
        axis.imshow(grid, cmap=colours, norm=norm, aspect="auto")
        for (i, j), value in np.ndenumerate(grid):
            axis.text(j, i, f"{value:.1f}", ha="center", va="center", fontsize=6)
        labels = [f"{t:g}\n{d:g}\n{s:g}" for t, d, s in columns]
        axis.set_xticks(range(len(columns)), labels, fontsize=7)
        axis.set_yticks(range(len(rows)), [f"{e:g}°, g {g:g}" for e, g in rows], fontsize=7)
        axis.set_title(f"{model}: levels rms off the march")
        axis.set_xlabel("turbidity / optical depth / size of the box")
    panels[0].set_ylabel("sun's elevation, g")
    words = ["to 1 level", "to 2", "to 4", "above"]
    patches = [Patch(color=colours(i), label=word) for i, word in enumerate(words)]
    figure.legend(handles=patches, loc="outside lower center", ncols=4, fontsize=8)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()

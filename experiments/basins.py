"""From how far away does one start still find the answer, without any screening?

    python experiments/basins.py [--size PIXELS] [--grid N] [--figure FILE]

Targets of three masks are fitted once; then the climb alone (``godfit.search.multigrid.climb``, and settling
on a few thousand pixels) is begun from other places: the light away from its own by up to half a
frame, and attenuation and density away from theirs. Printed: the share of starts from which the
light (to .002), decay (.001) and density (.005) are found, and how far off the light may begin
for nine starts in ten to arrive. Screening exists for the rest of the map.
"""

from __future__ import annotations

import argparse

import jax
import numpy as np
import scenes
from stability_judges import SAMPLES, TRUTH, light_pass, mask_of

from godfit import FitResult
from godfit import fit as whole_fit
from godfit.inference.settle import settle
from godfit.runtime.cache import enable_jax_cache
from godfit.search import multigrid

KINDS = ("triangles", "ellipses", "clouds")
REACH = 0.5
# What attenuation (kappa, by which light falls off along a ray) is multiplied by, and what is added
# to density.
FACTORS, DENSITIES = (0.25, 4.0), (-0.4, 0.2)
FOUND = {"light": 2e-3, "decay": 1e-3, "density": 5e-3}


def arrives(result: FitResult, start: np.ndarray) -> bool:
    """Whether the climb from coordinates ``start`` ends at the truth."""
    model, picture = result.model, result.picture
    free, held = result.free, result.held
    with jax.enable_x64(False):
        point = multigrid.climb(
            picture.small, model, [start.astype(np.float32)], free, held, 0, lambda _: None
        )
        seen = picture.observe(picture.informative(multigrid.PIXELS, 0))
        settled, _ = settle(point.coordinates, model, seen, free, held)
        values = {k: float(v) for k, v in model.moved(settled.coordinates, held).values().items()}
    light = np.hypot(values["light_x"] - TRUTH["light_x"], values["light_y"] - TRUTH["light_y"])
    return bool(
        light < FOUND["light"]
        and abs(values["decay"] - TRUTH["decay"]) < FOUND["decay"]
        and abs(values["density"] - TRUTH["density"]) < FOUND["density"]
    )


def maps(kind: str, size: int, grid: int) -> tuple[np.ndarray, np.ndarray]:
    """(grid, grid) whether starts arrive: light across and down, attenuation and density."""
    mask = mask_of(size, kind)
    linear = light_pass(mask)
    target = scenes.to_bytes(linear * (0.9 / np.quantile(linear, 0.98)))
    result = whole_fit(target, mask=mask, shader="dawntime", samples=SAMPLES)
    home = np.asarray(result.model.coordinates(), np.float64)
    light, other = np.zeros((grid, grid), bool), np.zeros((grid, grid), bool)
    offsets = np.linspace(-REACH, REACH, grid)
    factors = np.geomspace(*FACTORS, grid)
    densities = np.linspace(*DENSITIES, grid)
    for i in range(grid):
        for j in range(grid):
            start = home.copy()
            start[4:6] += offsets[j], -offsets[i]
            light[i, j] = arrives(result, start)
            start = home.copy()
            start[1:3] = home[1] * factors[i], home[2] + densities[j]
            other[i, j] = arrives(result, start)
    return light, other


def reach(light: np.ndarray) -> float:
    """The largest distance within which nine starts in ten arrive, in shares of the frame."""
    offsets = np.linspace(-REACH, REACH, len(light))
    away = np.hypot(offsets[:, None], offsets[None]).ravel()
    good = [d for d in np.unique(away) if light.ravel()[away <= d].mean() >= 0.9]
    return float(max(good, default=0.0))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--grid", type=int, default=11)
    parser.add_argument("--figure")
    options = parser.parse_args()
    enable_jax_cache()
    found = {}
    for kind in KINDS:
        found[kind] = light, other = maps(kind, options.size, options.grid)
        print(
            f"{kind:<10} light: {light.mean():.0%} of the starts arrive, nine in ten from within "
            f"{reach(light):.2f} of the frame; attenuation and density: {other.mean():.0%}",
            flush=True,
        )
    if options.figure:
        draw(found, options.figure)


def draw(found: dict[str, tuple[np.ndarray, np.ndarray]], path: str) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 6), layout="constrained")
    axes = figure.subplots(2, len(found))
    for column, (kind, (light, other)) in zip(axes.T, found.items(), strict=True):
        column[0].imshow(light, extent=(-REACH, REACH, -REACH, REACH), vmin=0, vmax=1)
        column[0].set_title(f"{kind}: light, {light.mean():.0%} arrive")
        column[0].set_xlabel("start's offset across, of the frame")
        factors = np.log10(FACTORS)
        column[1].imshow(other[::-1], extent=(*DENSITIES, *factors), vmin=0, vmax=1, aspect="auto")
        column[1].set_title(f"attenuation, density: {other.mean():.0%} arrive")
        column[1].set_xlabel("start's offset in density")
    axes[0, 0].set_ylabel("start's offset up")
    axes[1, 0].set_ylabel("log10 of the factor on attenuation")
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main()

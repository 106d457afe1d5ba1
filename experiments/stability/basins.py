"""From how far away does one start still find the answer, without any screening?

    python experiments/stability/basins.py [--size PIXELS] [--grid N] [--figure FILE]

Targets of three masks are fitted once; then the climb alone (``godfit.search.multigrid.climb``, and
settling on a few thousand pixels) is begun from other places: the light away from its own by up to
half a frame, and attenuation and density away from theirs. Printed: the share of starts from which
the light (to .002), decay (.001) and density (.005) are found, and how far off the light may begin
for nine starts in ten to arrive. Screening exists for the rest of the map.
"""

from __future__ import annotations

import argparse

import numpy as np

from godfit.runtime.cache import enable_jax_cache
from tests.support.basins import DENSITIES, FACTORS, REACH, maps, reach

KINDS = ("triangles", "ellipses", "clouds")


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

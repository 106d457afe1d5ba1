"""Is density within its error where rays are so short that rounding hides its bands?

    python experiments/accuracy/short_rays.py [--seeds FIRST:LAST] [--size PIXELS]
                                              [--samples N] [--decay D]

Made pictures of five kinds have a decay by which a tenth of their taps is visible: the likelihood
then has a minimum in density for every band, and many are nearly as deep as the right one. Printed
for each: whether the fit converged, the worst error of a parameter over its quoted error, and the
density with its error and the truth.
"""

from __future__ import annotations

import argparse

import numpy as np

from godfit import fit
from tests.support import random_targets

KINDS = ("triangles", "clouds", "lattice", "ellipses", "terrain")
SHOWN = {"exposure": 0.05, "weight": 0.8}
HELD = 5.0
"""Quoted errors within which a parameter is called found."""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seeds", default="0:10")
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--samples", type=int, default=100)
    parser.add_argument("--decay", type=float, default=0.85)
    given = parser.parse_args()
    first, last = (int(end) for end in given.seeds.split(":"))
    converged, ratios = 0, []
    for seed in range(first, last):
        kind = KINDS[seed % len(KINDS)]
        mask, _, truth = random_targets.draw(seed, kind, size=given.size, samples=given.samples)
        truth |= SHOWN | {"decay": given.decay}
        target = random_targets.to_bytes(random_targets.render64(mask / 255, truth))
        result = fit(target, mask=mask, shader="dawntime", samples=given.samples)
        errors = {
            name: abs(one.value - truth[name]) / one.stderr
            for name, one in result.params.items()
            if one.stderr
        }
        worst = max(errors, key=lambda name: errors[name], default="")
        converged += result.converged
        if result.converged:
            ratios.append(errors.get(worst, np.nan))
        density = result.params["density"]
        print(
            f"{seed:4} {kind:10} {'converged' if result.converged else 'NOT':9} "
            f"{errors.get(worst, np.nan):7.1f} {worst:9} density {density.value:.5f} "
            f"+- {density.stderr or np.nan:.2g}, truth {truth['density']:.5f}",
            flush=True,
        )
    held = sum(ratio < HELD for ratio in ratios)
    print(f"{converged} of {last - first} converged, {held} of these within {HELD:g} errors")


if __name__ == "__main__":
    main()

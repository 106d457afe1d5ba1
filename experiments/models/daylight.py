"""Is Hoffman and Preetham's daylight found again, and told from Mitchell's sum?

    python experiments/models/daylight.py [--seeds FIRST:LAST] [--noise LEVELS ...] [--compare]

Truths are drawn over turbidity 1.2 to 8, g .2 to .9, an optical depth of .1 to 2, the sun up to 10%
outside the frame, views of 40 to 90 degrees, before ridges, bars or blocks that stand nearer than
the sky. Targets of 192x192 bytes are computed in float64 from the published formulas by other code
than the fit's. A truth counts as found if every parameter that the fit says it knows is within four
of its errors, or within half a percent. With --compare, these targets and as many of Mitchell's are
given to `godfit.studies.compare`, which has to prefer the model that made them.
"""

from __future__ import annotations

import argparse

import jax
import numpy as np

from godfit.studies.compare import compare
from tests.support import random_targets
from tests.support.daylight_targets import KINDS, NAMES, SAMPLES, SIZE, attempt, draw


def recovery(first: int, last: int, noises: list[float]) -> None:
    for noise in noises:
        runs = [attempt(seed, kind, noise) for seed in range(first, last) for kind in KINDS]
        for found, converged, _, words in runs:
            if not found or not converged:
                print(f"  {'CONVERGED WRONG ' if converged and not found else ''}{words}")
        z = np.array([run[2] for run in runs])
        covered = [
            f"{name} {np.mean(np.abs(c[~np.isnan(c)]) < 1.96):.3f} of {np.sum(~np.isnan(c))}"
            for name, c in zip(NAMES, z.T, strict=True)
        ]
        print(
            f"noise of {noise:g} levels: {sum(r[0] for r in runs)} of {len(runs)} found, "
            f"{sum(r[1] and not r[0] for r in runs)} wrong but converged\n"
            f"  95% intervals cover: {', '.join(covered)}; "
            f"all {np.mean(np.abs(z[~np.isnan(z)]) < 1.96):.3f}",
            flush=True,
        )


def preference(first: int, last: int) -> None:
    """A line for every pair of targets, one of each model's, and how often each was preferred."""
    right = {"hoffman-preetham": 0, "mitchell": 0}
    count = 0
    for seed in range(first, last):
        for kind, other in zip(KINDS, random_targets.FRESH, strict=True):
            count += 1
            view, image, _ = draw(seed, kind)
            sunny = compare(
                random_targets.to_bytes(image, 0.0, seed),
                mask=view["mask"],
                fov=view["fov"],
                distance=view["distance"],
                samples=SAMPLES,
                shader="dawntime",
            )
            mask, image, truth = random_targets.draw(seed, other, SIZE)
            shaded = compare(
                random_targets.to_bytes(image, 0.0, seed),
                mask=mask,
                fov=60.0,
                distance=1000.0,
                samples=int(truth["samples"]),
                shader="dawntime",
            )
            chosen = [found.best.result.model.name for found in (sunny, shaded)]
            right["hoffman-preetham"] += chosen[0] == "hoffman-preetham"
            right["mitchell"] += chosen[1] == "mitchell"
            print(f"  seed {seed}: {kind} by hoffman-preetham prefers {chosen[0]}, "
                  f"{other} by mitchell prefers {chosen[1]}", flush=True)  # fmt: skip
            jax.clear_caches()
    for name, number in right.items():
        print(f"targets of {name}: {number} of {count} prefer it", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", default="100:107")
    parser.add_argument("--noise", type=float, nargs="+", default=[0.0, 1.0])
    parser.add_argument("--compare", action="store_true")
    options = parser.parse_args()
    first, last = (int(n) for n in options.seeds.split(":"))
    if options.compare:
        preference(first, last)
    else:
        recovery(first, last, options.noise)


if __name__ == "__main__":
    main()

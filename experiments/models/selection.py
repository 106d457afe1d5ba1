"""Does `godfit select` find the rung that a picture was made on?

    python experiments/models/selection.py [--targets N] [--noise LEVELS ...] [--size PIXELS]
    python experiments/models/selection.py --repeats 5 --size 512      # how long it takes, warm

Targets are drawn from the ladder in turn: a veil, the shader's defaults, another light, another
attenuation, density, weight, number of samples, a second light, a colour; everything above the rung
is as the rung holds it. They are rendered in float64 by other code than the fit's, with noise, and
rounded to bytes. Prints how often the rung was found, and the confusions; exit status 1 if one
above the truth was chosen where the truth leaves as little noise. With --repeats, one target of
each rung is selected from again and again, all in turn, once what they need is compiled; prints
medians.
"""

from __future__ import annotations

import argparse
import sys
import time

import jax
import numpy as np

from godfit.studies.select import select
from tests.support import random_targets
from tests.support.ladder_truths import RUNGS, SAMPLES, SHADER, draw


def recovered(targets: int, noise: float, size: int, seed: int) -> int:
    """Prints how many are found on their rung; how many above the truth though it leaves as
    little noise."""
    right, above, seconds = 0, 0, []
    for i in range(targets):
        rung = RUNGS[i % len(RUNGS)]
        mask, image = draw(seed + i, rung, size)
        target = random_targets.to_bytes(image, noise, seed + i)
        began = time.perf_counter()
        found = select(target, mask=mask, shader=SHADER, samples=SAMPLES)
        seconds.append(time.perf_counter() - began)
        got = found.recommended.rung.name
        right += got == rung
        if got != rung:
            names = [row.rung.name for row in found.rows]
            twin = rung in names and names.index(rung) < found.chosen
            noises = {r.rung.name: r.rung.settled.sigma for r in found.rows}
            above += twin and noises[rung] <= noises[got]
            print(f"  seed {seed + i}: {rung} was taken for {got} {noises}", flush=True)
        if i % 12 == 11:
            jax.clear_caches()
    print(
        f"noise of {noise:g} levels: {right} of {targets} on their rung; "
        f"median {np.median(seconds):.1f} s at {size}x{size}",
        flush=True,
    )
    return above


def seconds_taken(repeats: int, noise: float, size: int, seed: int) -> None:
    """Prints medians of warm runs, one target of each rung in turn."""
    drawn = {rung: draw(seed + i, rung, size) for i, rung in enumerate(RUNGS)}
    targets = {r: (m, random_targets.to_bytes(i, noise, seed)) for r, (m, i) in drawn.items()}
    seconds: dict[str, list[float]] = {rung: [] for rung in RUNGS}
    for _ in range(repeats + 1):
        for rung, (mask, target) in targets.items():
            began = time.perf_counter()
            select(target, mask=mask, shader=SHADER, samples=SAMPLES)
            seconds[rung].append(time.perf_counter() - began)
    for rung, (_, *warm) in seconds.items():
        print(
            f"noise of {noise:g} levels, {rung:16s} {np.median(warm):5.2f} s"
            f" ({min(warm):.2f} to {max(warm):.2f})",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--targets", type=int, default=100)
    parser.add_argument("--noise", type=float, nargs="+", default=[0.0, 1.0])
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--repeats", type=int, default=0)
    options = parser.parse_args()
    if options.repeats:
        for noise in options.noise:
            seconds_taken(options.repeats, noise, options.size, options.seed)
        return
    above = sum(
        recovered(options.targets, noise, options.size, options.seed) for noise in options.noise
    )
    print(f"{above} above the truth though it leaves as little noise")
    sys.exit(above > 0)


if __name__ == "__main__":
    main()

"""Is the convention of a picture found among all of them?

    python experiments/accuracy/which_shader.py [--seeds FIRST:LAST] [--size PIXELS]

Each seed draws a convention, a mask and numbers, with the convention's own number of samples, and
renders bytes. The answer is right where that convention is the winner or among those that the
picture does not distinguish from it. It is wrong with "converged" where it is neither, and the fit
of the winner says that it converged.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import godfit
from godfit import CONVENTIONS
from tests.support import random_targets


def made(seed: int, size: int) -> tuple[str, np.ndarray, np.ndarray]:
    """(convention, mask as bytes, target as bytes)."""
    rng = np.random.default_rng([seed, 95])
    name = list(CONVENTIONS)[seed % len(CONVENTIONS)]
    shader = CONVENTIONS[name]
    kind = list(random_targets.MASKS)[int(rng.integers(len(random_targets.MASKS)))]
    light = rng.uniform(0.1, 0.9, 2)
    mask = random_targets.MASKS[kind](rng, size, light)
    mask = np.floor(mask * 255 + 0.5).clip(0, 255).astype(np.uint8)
    decay = float(rng.uniform(0.05, 0.6) ** (1 / shader.samples))
    density, weight = float(rng.uniform(0.5, 0.95)), float(rng.uniform(0.2, 0.9))
    model = godfit.Mitchell(1.0, decay, density, weight, light, shader=name)
    linear = np.asarray(model(mask), float)
    exposure = 0.9 / max(float(np.quantile(linear, 0.99)), 1e-6)
    model = godfit.Mitchell(exposure, decay, density, weight, light, shader=name)
    return name, mask, random_targets.to_bytes(np.asarray(model(mask), float))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", default="0:100")
    parser.add_argument("--size", type=int, default=128)
    given = parser.parse_args()
    first, last = map(int, given.seeds.split(":"))
    right = wrong = 0
    for seed in range(first, last):
        name, mask, target = made(seed, given.size)
        began = time.process_time()
        result = godfit.fit(target, mask=mask, shader="auto")
        (note,) = [n for n in result.notes if n.startswith("shader: ")]
        spoken = note.split("; next comes")[0]
        found = f" {name} with " in spoken
        right, wrong = right + found, wrong + (result.converged and not found)
        seconds = time.process_time() - began
        print(f"{seed} {name:14} {'right' if found else 'WRONG'} {result.converged} ", end="")
        print(f"({seconds:.1f} s)", "" if found else note, flush=True)
    print(f"right {right} of {last - first}; wrong and converged {wrong}")


if __name__ == "__main__":
    main()

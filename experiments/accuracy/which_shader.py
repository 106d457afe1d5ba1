"""Is the convention of a picture found among all of them?

    python experiments/accuracy/which_shader.py [--seeds FIRST:LAST] [--size PIXELS]
                                                [--masks FILE ...]

Each seed draws a convention, a mask and numbers, with the convention's own number of samples, and
renders bytes. Every third mask is one of the files, where there are any. The answer is right where
that convention is the winner or among those that the picture does not distinguish from it. It is
wrong with "converged" where not even their families are the same (docs/shaders.md), and the fit of
the winner says that it converged.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from PIL import Image

import godfit
from godfit import CONVENTIONS
from tests.support import random_targets

EVERY = 3
"""One of so many masks is a file's."""


def from_file(path: str, size: int) -> np.ndarray:
    """(size, size) the mask of a file as bytes: grey, its middle square, read at pixel centres."""
    image = Image.open(path).convert("L")
    left, top = ((side - min(image.size)) // 2 for side in image.size)
    square = image.crop((left, top, left + min(image.size), top + min(image.size)))
    return np.asarray(square.resize((size, size), Image.Resampling.NEAREST))


def made(seed: int, size: int, masks: list[str]) -> tuple[str, np.ndarray, np.ndarray]:
    """(convention, mask as bytes, target as bytes)."""
    rng = np.random.default_rng([seed, 95])
    name = list(CONVENTIONS)[seed % len(CONVENTIONS)]
    shader = CONVENTIONS[name]
    kind = list(random_targets.MASKS)[int(rng.integers(len(random_targets.MASKS)))]
    light = rng.uniform(0.1, 0.9, 2)
    mask = random_targets.MASKS[kind](rng, size, light)
    mask = np.floor(mask * 255 + 0.5).clip(0, 255).astype(np.uint8)
    # Another third of the conventions in every round of them.
    if masks and (seed + seed // len(CONVENTIONS)) % EVERY == 0:
        mask = from_file(masks[seed // EVERY % len(masks)], size)
    if shader.threshold:
        # Under a threshold that nothing exceeds there is no light.
        mask = np.round(mask * (255 / mask.max())).astype(np.uint8)
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
    parser.add_argument("--masks", nargs="*", default=[])
    given = parser.parse_args()
    first, last = map(int, given.seeds.split(":"))
    right = of_family = wrong = 0
    for seed in range(first, last):
        name, mask, target = made(seed, given.size, given.masks)
        began = time.process_time()
        result = godfit.fit(target, mask=mask, shader="auto")
        (note,) = [n for n in result.notes if n.startswith("shader: ")]
        spoken = note.split("; next comes")[0]
        named = [other for other in CONVENTIONS if f" {other} with " in spoken]
        found = name in named
        near = CONVENTIONS[name].family in {CONVENTIONS[other].family for other in named}
        right, of_family = right + found, of_family + near
        wrong += result.converged and not near
        seconds = time.process_time() - began
        verdict = "right" if found else "family" if near else "WRONG"
        print(f"{seed} {name:14} {verdict} {result.converged} ", end="")
        print(f"({seconds:.1f} s)", "" if found else note, flush=True)
    total = last - first
    print(f"right {right}, family right {of_family}, of {total}; wrong and converged {wrong}")


if __name__ == "__main__":
    main()

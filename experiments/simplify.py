"""How many samples do pictures need, and is what `godfit simplify` promises true?

    python experiments/simplify.py [--cases 50] [--tolerance LEVELS] [--by worst] [--size PIXELS]

Random masks and parameters (`scenes.draw`), simplified to within a tolerance that is given or drawn
from 1/2 to 4 levels. The promise is checked against other code: both settings rendered in float64,
tap by tap, the smaller pass read bilinearly by scipy. Prints how often it held and the median
saving; exit status 1 if it was broken.
"""

from __future__ import annotations

import argparse
import sys

import jax
import numpy as np
import scenes
from scipy import ndimage

from godfit import Mitchell
from godfit.io.filters import shrink
from godfit.report.simplify import Simpler
from godfit.studies.simplify import simplify


def truth_of(model: Mitchell) -> dict[str, float]:
    return {k: float(v) for k, v in model.values().items()} | {"samples": model.samples}


def picture64(model: Mitchell, mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(h, w) levels of the model's picture, clamped, in float64 and by other code."""
    light = np.clip(scenes.render64(mask, truth_of(model)), 0, 1)
    if light.shape != size:
        at = [
            (np.arange(n) + 0.5) * low / n - 0.5 for n, low in zip(size, light.shape, strict=True)
        ]
        at = np.meshgrid(*at, indexing="ij")
        light = ndimage.map_coordinates(light, at, order=1, mode="nearest")
    return 255 * light


def attempt(seed: int, tolerance: float | None, by: str, size: int) -> tuple[Simpler, float, float]:
    """(what was found, its true error, the tolerance), in levels."""
    kinds = list(scenes.MASKS)
    mask, _, truth = scenes.draw(seed, kinds[seed % len(kinds)], size)
    tolerance = tolerance or float(np.random.default_rng(seed).uniform(0.5, 4))
    numbers = [truth[k] for k in ("exposure", "decay", "density", "weight")]
    light = [truth["light_x"], truth["light_y"]]
    with jax.enable_x64(False):
        exposure, decay, density, weight = numbers
        model = Mitchell(exposure, decay, density, weight, light, "dawntime", int(truth["samples"]))
        values = (mask / 255).astype(np.float32)
        found = simplify(model, values, tolerance, by=by)
    h, w = (max(1, round(n * found.scale)) for n in mask.shape)
    low = values if found.scale == 1 else shrink(values, (h, w))
    shape = (mask.shape[0], mask.shape[1])
    off = picture64(found.model, low.astype(float), shape)
    off -= picture64(model, values.astype(float), shape)
    true = np.abs(off).max() if by == "worst" else np.sqrt((off**2).mean())
    # Every number of samples is a program of its own.
    jax.clear_caches()
    return found, float(true), tolerance


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--cases", type=int, default=50)
    parser.add_argument("--tolerance", type=float)
    parser.add_argument("--by", choices=["worst", "rms"], default="worst")
    parser.add_argument("--size", type=int, default=192)
    options = parser.parse_args()
    held, samples, savings, smaller = 0, [], [], 0
    for seed in range(options.cases):
        found, true, tolerance = attempt(seed, options.tolerance, options.by, options.size)
        held += true <= tolerance
        if true > tolerance:
            print(f"  BROKEN seed {seed}: {true:.4f} levels, {tolerance:.4f} promised")
        samples.append(found.full.samples / found.model.samples)
        savings.append(found.saving)
        smaller += found.scale < 1
    print(
        f"the promise held in {held} of {options.cases} cases; "
        f"median saving in samples {np.median(samples):.2f} times (quarters "
        f"{np.quantile(samples, 0.25):.2f} and {np.quantile(samples, 0.75):.2f}), in taps "
        f"{np.median(savings):.2f} times; {smaller} take a smaller light pass"
    )
    sys.exit(held < options.cases)


if __name__ == "__main__":
    main()

"""Are random truths found without a hint, and do the quoted errors cover them?

    python experiments/accuracy/recovery.py [--seeds FIRST:LAST] [--noise LEVELS ...]
                                            [--figure FILE] [--made KIND]
                                            [--arithmetic gpu|exact]

Truths are drawn over density .3 to 1, decay^samples .001 to .9, the light up to 20% outside the
frame; targets are 256x256 bytes rendered in float64 by other code than the fit's. A truth counts as
found if every parameter is within the tolerance or within four of its quoted errors, whichever is
larger. Coverage counts every parameter that the fit says is determined and not at a bound.

``--made jpeg`` compresses targets, at qualities from 60 to 95; ``--made upsampled`` makes them with
a light pass of half the size, read bilinearly, whose scale is given. There the pixels' errors are
correlated. ``jittered`` ones have the taps of each ray moved by up to half a step either way,
``dithered`` ones are rounded after uniform noise of a level. ``walk`` ones accumulate their
coordinates in float32, and ``fractions`` ones interpolate with fractions of 1/256 of a texel as
well, as GPUs do.
"""

from __future__ import annotations

import argparse
import time

import jax
import numpy as np

from godfit import fit
from tests.support import gpu_walk, random_targets

ABSOLUTE = {"decay": 5e-5, "density": 5e-4, "light_x": 3e-4, "light_y": 3e-4}
RELATIVE = {"exposure": 0.03, "weight": 0.03}
# Of what is made with correlated errors.
SAMPLES = 80
MADE = ("plain", "jpeg", "upsampled", "jittered", "dithered", "walk", "fractions")
NAMES = ("exposure", "decay", "density", "weight", "light_x", "light_y")


def attempt(seed: int, kind: str, noise: float, made: str = "plain", arithmetic: str = "exact"):
    """One fit: (found, converged, errors over standard errors (6,), seconds, description)."""
    mask, image, truth = random_targets.draw(
        seed, kind, samples=None if made == "plain" else SAMPLES
    )
    scale = None
    if made == "upsampled":
        size = mask.shape[0]
        low = mask.reshape(size // 2, 2, size // 2, 2).mean((1, 3)) / 255
        # Stored in bytes, as a pass is, before it is read.
        stored = random_targets.to_bytes(random_targets.render64(low, truth)) / 255
        image, scale = random_targets.enlarged(stored, size), 0.5
    rng = np.random.default_rng([seed, 11])
    if made in ("walk", "fractions"):
        fractions = 256 if made == "fractions" else None
        image = gpu_walk.walk(mask / 255, "dawntime", truth, fractions)
    if made == "jittered":
        image = random_targets.render64(mask / 255, truth, rng.random(mask.shape) - 0.5)
    if made == "dithered":
        image = image + (rng.random(image.shape) - 0.5) / 255
    target = random_targets.to_bytes(image, noise, seed)
    if made == "jpeg":
        target = random_targets.encoded(
            target, int(np.random.default_rng([seed, 7]).integers(60, 96))
        )
    began = time.perf_counter()
    samples = int(truth["samples"])
    result = fit(target, mask=mask, shader="dawntime", samples=samples, pass_scale=scale,
                 arithmetic=arithmetic)  # fmt: skip
    seconds = time.perf_counter() - began
    if made == "plain":
        # Every number of samples is a program of its own: a hundred of them exhaust what memory
        # maps a process may have.
        jax.clear_caches()
    scores = np.full(len(NAMES), np.nan)
    missed = []
    for i, name in enumerate(NAMES):
        estimate = result.params[name]
        error = estimate.value - truth[name]
        allowed = ABSOLUTE.get(name, RELATIVE.get(name, 0) * truth[name])
        if abs(error) > max(allowed, 4 * (estimate.stderr or 0)):
            missed.append(name)
        if estimate.stderr is not None and not estimate.at_bound:
            scores[i] = error / estimate.stderr
    words = f"seed {seed} {kind}: {', '.join(missed) or 'found'}; {result.message}"
    return not missed, result.converged, scores, seconds, words


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", default="1000:1034")
    parser.add_argument("--noise", type=float, nargs="+", default=[0.0, 1.0])
    parser.add_argument("--kinds", nargs="+", default=list(random_targets.FRESH))
    parser.add_argument("--made", default="plain", choices=MADE)
    parser.add_argument("--arithmetic", choices=("gpu", "exact"))
    parser.add_argument("--figure")
    options = parser.parse_args()
    first, last = (int(n) for n in options.seeds.split(":"))
    # What is computed here in float64 is exact; what is emulated is what the default is for.
    emulated = "gpu" if options.made in ("walk", "fractions") else "exact"
    arithmetic, scores = options.arithmetic or emulated, {}
    for noise in options.noise:
        runs = [
            attempt(seed, kind, noise, options.made, arithmetic)
            for seed in range(first, last)
            for kind in options.kinds
        ]
        for found, converged, _, _, words in runs:
            if not found or not converged:
                print(f"  {'CONVERGED WRONG ' if converged and not found else ''}{words}")
        z = np.array([r[2] for r in runs])
        scores[noise] = z
        covered = [
            f"{name} {np.mean(np.abs(c[~np.isnan(c)]) < 1.96):.3f}"
            for name, c in zip(NAMES, z.T, strict=True)
        ]
        wrong = sum(r[1] and not r[0] for r in runs)
        print(
            f"noise of {noise:g} levels, {len(runs)} truths: {sum(r[0] for r in runs)} found, "
            f"{wrong} wrong but converged, median {np.median([r[3] for r in runs]):.1f} s"
        )
        print(
            f"  95% intervals cover: {', '.join(covered)}; "
            f"all {np.mean(np.abs(z[~np.isnan(z)]) < 1.96):.3f}, worst {np.nanmax(np.abs(z)):.1f}"
        )
        content = z[[r[1] for r in runs]]
        print(
            f"  of the {len(content)} that converged: "
            f"{np.mean(np.abs(content[~np.isnan(content)]) < 1.96):.3f}",
            flush=True,
        )
    if options.figure:
        draw(scores, options.figure)


def draw(scores: dict[float, np.ndarray], path: str) -> None:
    """Errors over standard errors against the normal distribution."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4 * len(scores), 3), layout="constrained")
    grid = np.linspace(-5, 5, 201)
    for i, (noise, z) in enumerate(scores.items()):
        axes = figure.add_subplot(1, len(scores), i + 1)
        axes.hist(z[~np.isnan(z)].clip(-5, 5), bins=41, range=(-5, 5), density=True, color="silver")
        axes.plot(grid, np.exp(-(grid**2) / 2) / np.sqrt(2 * np.pi), color="black", lw=1)
        axes.set_title(f"noise of {noise:g} levels before rounding", fontsize=10)
        axes.set_xlabel("error / standard error")
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main()

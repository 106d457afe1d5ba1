"""How long does the same fit take when it is done otherwise?

    pip install 'godfit[peers]'
    python experiments/speed/peers.py [--repeats N] [--once] [--only WORD ...] [--figure FILE]

512x512 bytes, 150 samples, a hard mask, dawntime. Every peer has the same target, the same start
(10 to 20% off, the light .03) and every core, and stops at the first point that it asks for whose
error is under the tolerance. So does godfit, once from that start and once from none; it is also
timed to its own end, with the errors that it quotes. The error is the rms of what the six
parameters are off: of exposure, density, weight and 1 - decay in shares of the true value, of the
light in shares of the image.

Times are without imports, compilation and what depends on the picture's size alone; runs are
interleaved and medians printed. A peer that has not arrived when its budget is spent, or that gives
up, is shown with a lower bound. Evaluations are of the sum at every pixel, with or without its
derivatives; most of godfit's take a part of the pixels and are not counted.
"""

from __future__ import annotations

import argparse
import importlib.util

import numpy as np

from tests.support import random_targets
from tests.support.peer_fits import NAMES, PEERS, TRUTH, Problem, Run, Solve, timed


def problem_of(size: int, samples: int) -> Problem:
    # Rounding to bytes moves where the least squares lie, by .0004 in this picture; where the mask
    # has few edges it is .01, almost all in how exposure and weight share what they do.
    mask = random_targets.maze(np.random.default_rng(7), size, TRUTH[4:])
    mask = np.floor(mask * 255 + 0.5) / 255
    truth = dict(zip(NAMES, TRUTH.tolist(), strict=True)) | {"samples": float(samples)}
    return Problem(mask, random_targets.to_bytes(random_targets.render64(mask, truth)), samples)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--once", action="store_true", help="peers that take above 10 s run once")
    parser.add_argument("--only", nargs="+", default=[""], help="words of the peers' names")
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--samples", type=int, default=150)
    parser.add_argument("--tolerance", type=float, default=2e-3)
    parser.add_argument("--budget", type=float, default=600, help="seconds for each run")
    parser.add_argument("--figure")
    options = parser.parse_args()
    problem = problem_of(options.size, options.samples)
    solves: dict[str, Solve] = {}
    for name, prepare in PEERS.items():
        if not any(word in name for word in ["godfit", *options.only]):
            continue
        if name.startswith("torch") and importlib.util.find_spec("torch") is None:
            print(f"{name}: left out, pip install 'godfit[peers]' brings it")
        else:
            solves[name] = prepare(problem)
    runs: dict[str, list[Run]] = {name: [] for name in solves}
    for _ in range(options.repeats):
        for name, solve in solves.items():
            if options.once and runs[name] and runs[name][0].seconds > 10:
                continue
            runs[name].append(timed(solve, options.tolerance, options.budget))
    medians = {
        name: sorted(found, key=lambda run: run.seconds)[len(found) // 2]
        for name, found in runs.items()
    }
    print(f"{'':38s} {'seconds':>9s} {'of godfit':>9s} {'error':>8s} evaluations")
    for name, run in medians.items():
        least = "" if run.arrived else ">"
        ratio = f"{least}{run.seconds / medians['godfit'].seconds:.1f}"
        counted = "" if name.startswith("godfit") else run.evaluations
        print(
            f"{name:38s} {least + f'{run.seconds:.2f}':>9s} {ratio:>9s} {run.error:8.1e} {counted}"
        )
    if options.figure:
        draw(medians, options.figure)


def draw(medians: dict[str, Run], path: str) -> None:
    """A bar for each peer, fastest first; an arrow where the time is a lower bound."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.2), layout="constrained")
    axes = figure.add_subplot()
    least = min(run.seconds for run in medians.values())
    for row, (name, run) in enumerate(sorted(medians.items(), key=lambda pair: pair[1].seconds)):
        colour = "tab:orange" if name.startswith("godfit") else "silver"
        axes.barh(row, run.seconds, color=colour)
        ratio = run.seconds / medians["godfit"].seconds
        words = f" {run.seconds:.3g} s" + (f", {ratio:.3g} times" if name != "godfit" else "")
        axes.text(run.seconds, row, words if run.arrived else f" over{words}", va="center")
    axes.set_yticks(range(len(medians)), sorted(medians, key=lambda name: medians[name].seconds))
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xlim(least / 2, 100 * max(run.seconds for run in medians.values()))
    axes.set_xlabel("seconds to the same answer, from the same start")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main()

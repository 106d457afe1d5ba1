"""Where methods fail: every failure that is known of, as a case with a promise.

    python experiments/stability/stability.py [--sizes N N] [--only TEXT] [--figure FILE]

A case is made at two sizes and must end as promised: "recovers" (converged, every determined
parameter within its tolerance or five of its errors), "refuses" (not converged, or an InputError of
one line), "warns" (a warning that says what), "names" (what is undetermined is named, or which
frame), "finds the light" (without a mask: within 2% of the picture), "holds" (a law of the forward
sum). No case may end in a value that is not finite, in a traceback, or in "converged" with a wrong
answer. The exit status is 1 if a promise is broken.
"""

from __future__ import annotations

import argparse
import sys

import jax
import numpy as np

from godfit.runtime.cache import enable_jax_cache
from tests.support.stability_cases import CASES, Case, attempt
from tests.support.stability_judges import Outcome


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--sizes", type=int, nargs="+", default=[64, 128])
    parser.add_argument("--only", default="")
    parser.add_argument("--figure")
    options = parser.parse_args()
    enable_jax_cache()
    cases = [c for c in CASES if options.only in f"{c.failure} {c.name}"]
    table = []
    for case in cases:
        outcomes = [attempt(case, size) for size in options.sizes]
        table.append(outcomes)
        for size, (kept, words) in zip(options.sizes, outcomes, strict=True):
            print(
                f"{case.failure:<20} {case.name:<24} {size:>4}  {case.promise:<20} "
                f"{'kept  ' if kept else 'BROKEN'} {words}",
                flush=True,
            )
        jax.clear_caches()
    tries = len(options.sizes) * len(cases)
    kept = sum(k for row in table for k, _ in row)
    print(f"{len(cases)} rows at {len(options.sizes)} sizes: {kept} of {tries} kept")
    if options.figure:
        draw(cases, table, options.sizes, options.figure)
    return 0 if kept == tries else 1


def draw(cases: list[Case], table: list[list[Outcome]], sizes: list[int], path: str) -> None:
    """The matrix: a row for each case, a column for each size."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.5, 0.23 * len(cases) + 1), layout="constrained")
    axes = figure.subplots()
    kept = np.array([[k for k, _ in row] for row in table], float)
    axes.imshow(kept, cmap="RdYlGn", vmin=-0.3, vmax=1.3, aspect="auto")
    axes.set_xticks(range(len(sizes)), [f"{s}x{s}" for s in sizes])
    axes.xaxis.tick_top()
    axes.set_yticks(range(len(cases)), [f"{c.failure}: {c.name}" for c in cases], fontsize=7)
    for i, (case, row) in enumerate(zip(cases, table, strict=True)):
        for j, (k, _) in enumerate(row):
            text = case.promise if k else "BROKEN: " + case.promise
            axes.text(j, i, text, ha="center", va="center", fontsize=7)
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    sys.exit(main())

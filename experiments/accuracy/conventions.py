"""Are random truths of every convention found from bytes, within five quoted errors?

    python experiments/accuracy/conventions.py [--seeds FIRST:LAST] [SHADER ...]

Targets are 128x128 bytes, rendered in float64 by loops over each convention's formula, which share
no code with the fit. What no picture determines of a convention (docs/shaders.md) is not compared.
"""

from __future__ import annotations

import argparse
import time

import jax

from tests.support import convention_oracle, convention_truths


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("shaders", nargs="*", default=list(convention_oracle.LIGHT_PASSES))
    parser.add_argument("--seeds", default="0:20")
    options = parser.parse_args()
    first, last = (int(n) for n in options.seeds.split(":"))
    print(f"{'convention':14} truths found converged wrong   s each  worst score")
    for shader in options.shaders:
        began, tries = time.process_time(), []
        for seed in range(first, last):
            tries.append(convention_truths.attempt(shader, seed))
            if not tries[-1].found:
                words = ", ".join(f"{n} {s:.3g}" for n, s in tries[-1].scores.items())
                print(f"    seed {seed}: {words}; {tries[-1].message}")
        found = sum(t.found for t in tries)
        converged = sum(t.converged for t in tries)
        wrong = sum(t.converged and not t.found for t in tries)
        worst = max(max(t.scores.values()) for t in tries)
        each = (time.process_time() - began) / len(tries)
        print(
            f"{shader:14} {len(tries):6} {found:5} {converged:9} {wrong:5} {each:8.1f} "
            f"{worst:12.3g}",
            flush=True,
        )
        jax.clear_caches()


if __name__ == "__main__":
    main()

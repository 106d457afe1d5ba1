"""Are wrong models found out, and right ones left alone?

    python experiments/stability/diagnostics.py [--targets N] [--clean N] [--kinds NAME ...]
                                                [--size PIXELS]

Targets are random masks and truths (``tests/support/random_targets.py``), rendered in float64 by
other code than the fit's, with a defect that the fit is not told of. A defect counts as found if a
warning names it. A clean target, with noise of 0 or 1 level before rounding, hard or soft masks,
must get none.
"""

from __future__ import annotations

import argparse
import sys

from godfit.runtime.cache import enable_jax_cache
from tests.support.defects import SAYS, warned


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--targets", type=int, default=20)
    parser.add_argument("--clean", type=int, default=200)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--kinds", nargs="+", default=[*SAYS, "clean"])
    options = parser.parse_args()
    enable_jax_cache()
    kept = True
    for kind in options.kinds:
        count = options.clean if kind == "clean" else options.targets
        hits, converged = 0, 0
        for seed in range(count):
            result = warned(kind, seed, options.size)
            said = " | ".join(result.warnings)
            hit = bool(said) if kind == "clean" else SAYS[kind] in said
            hits, converged = hits + hit, converged + result.converged
            if hit == (kind == "clean"):
                print(
                    f"  {kind} {seed}: noise {result.noise_levels:.2f}, correlation "
                    f"{result.residual_correlation:.2f}: {said or 'silent'}",
                    flush=True,
                )
        kept &= hits <= 0.02 * count if kind == "clean" else hits >= 0.95 * count
        word = "false" if kind == "clean" else "found"
        print(f"{kind:<12} {hits:>3} of {count} {word}, {converged} converged", flush=True)
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())

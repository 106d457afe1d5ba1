"""How many samples do pictures need, and is what `godfit simplify` promises true?

    python experiments/models/simplify.py [--cases 50] [--tolerance LEVELS] [--by worst]
                                          [--size PIXELS]

Random masks and parameters (`tests.support.random_targets.draw`), simplified to within a tolerance
that is given or drawn from 1/2 to 4 levels. The promise is checked against other code: both
settings rendered in float64, tap by tap, the smaller pass read bilinearly by scipy. Prints how
often it held and the median saving; exit status 1 if it was broken.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from tests.support.simplified import attempt


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

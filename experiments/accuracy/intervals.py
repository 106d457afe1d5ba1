"""Do profile intervals cover the truth, at bounds too, and does the posterior agree with them?

    python experiments/accuracy/intervals.py [--seeds FIRST:LAST] [--noise LEVELS]
                                             [--size PIXELS] [--posteriors N]

Random masks and truths (`tests.support.random_targets.draw`, rendered in float64 by other code than
the fit's), with decay at 1, its upper bound, with density at 1, where the taps reach the light, and
as they were drawn. Each is fitted without a hint, and the one parameter profiled. At a bound half
of all estimates lie on it, and 2.5% of all intervals should miss it (Self & Liang, J. Am. Stat.
Assoc. 82 (1987), 605): the answer is never above. Of the first few of each kind whose intervals end
at no bound, NUTS draws the posterior (`pip install 'godfit[posterior]'`), and the widths and ends
of both intervals are compared.
"""

from __future__ import annotations

import argparse

import jax
import numpy as np

from godfit.runtime.cache import enable_jax_cache
from godfit.studies.posterior import posterior, with_posterior
from tests.support.profiled_truths import PROFILED, Profiled, attempt


def apart(one: Profiled) -> tuple[float, float]:
    """The posterior's interval against the profile's: its width over the other's, and by how much
    of that width the ends are apart, most."""
    low, high = one.interval
    drawn = with_posterior(one.result, posterior(one.result)).params[one.name].posterior
    assert drawn is not None
    a, b = drawn
    return (b - a) / (high - low), max(abs(a - low), abs(b - high)) / (high - low)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", default="1000:1040")
    parser.add_argument("--noise", type=float, default=1.0)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--posteriors", type=int, default=8)
    options = parser.parse_args()
    enable_jax_cache()
    first, last = map(int, options.seeds.split(":"))
    regular: list[Profiled] = []
    for name in PROFILED:
        for at in (1.0, None):
            with jax.enable_x64(False):
                found = [
                    attempt(seed, name, options.noise, options.size, at)
                    for seed in range(first, last)
                ]
            believed = [one for one in found if one.result.converged]
            where = "as drawn" if at is None else f"at {at:g}"
            ends = sum(one.result.params[name].at_bound for one in believed)
            print(
                f"{name} {where}: {len(believed)} of {len(found)} converged, {ends} of them within "
                "an error of a bound; the profile's 95% intervals cover "
                f"{sum(one.covers for one in believed)}",
                flush=True,
            )
            if at is None:
                inside = [one for one in believed if one.interval[1] < 1]
                regular += inside[: options.posteriors]
    ratios = np.array([apart(one) for one in regular])
    if len(ratios):
        width, ends = np.abs(ratios[:, 0] - 1), ratios[:, 1]
        print(
            f"posterior against profile, {len(ratios)} intervals: widths differ by "
            f"{100 * np.median(width):.1f}% (most {100 * width.max():.1f}%), ends by "
            f"{100 * np.median(ends):.1f}% of the width (most {100 * ends.max():.1f}%)"
        )


if __name__ == "__main__":
    main()

"""Does a hint name what was done to a frame, and does the option that it names help?

    python experiments/accuracy/hints.py [--seeds FIRST:LAST] [--size PIXELS] [--kinds KIND ...]

Twenty distortions of a frame of DawnTime's are fitted as if nothing had been done. A hint is right
where one of the warnings, or the message, says what tests/support/distortions.py has for it. Where
a hint names an option, the frame is fitted again with it, and the noise of that fit is printed.
Undistorted frames must get no hint.
"""

from __future__ import annotations

import argparse
import time

import godfit
from tests.support import distortions, random_targets

ROUNDING = 0.125
"""Noise in levels that an option must leave at most."""


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", default="0:3")
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--kinds", nargs="*", default=list(distortions.SAYS))
    given = parser.parse_args()
    first, last = map(int, given.seeds.split(":"))
    right = helped = options = total = false = 0
    for seed in range(first, last):
        mask, truth = distortions.frame(seed, given.size)
        target = random_targets.to_bytes(random_targets.render64(mask / 255, truth))
        clean = godfit.fit(target, mask=mask, shader="dawntime", samples=distortions.SAMPLES)
        false += bool(clean.warnings) or not clean.converged
        print(f"{seed} clean{'':12} {clean.noise_levels:7.3f} {clean.message} {clean.warnings}")
        for kind in given.kinds:
            began = time.process_time()
            target, known, _ = distortions.made(kind, seed, given.size)
            result = godfit.fit(target, **known)
            spoken = [*result.warnings, result.message]
            named = any(distortions.SAYS[kind] in words for words in spoken)
            right, total = right + named, total + 1
            line = f"{seed} {kind:16} {result.noise_levels:7.3f} {'named' if named else 'MISSED'}"
            if kind in distortions.OPTIONS:
                again = godfit.fit(target, **(known | distortions.OPTIONS[kind]))
                options, helped = options + 1, helped + (again.noise_levels <= ROUNDING)
                line += f", {again.noise_levels:.3f} with its option"
            seconds = time.process_time() - began
            print(f"{line} ({seconds:.1f} s)", "" if named else spoken, flush=True)
    print(f"named {right} of {total}; options that explain all {helped} of {options}; ", end="")
    print(f"false hints on {false} of {last - first} clean frames")


if __name__ == "__main__":
    main()

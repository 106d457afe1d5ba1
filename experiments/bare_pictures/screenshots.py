"""How well a picture is read that comes with nothing: screenshots made for it, none used before.

    python experiments/bare_pictures/screenshots.py [--kinds KIND ...] [--seeds A:B]

For every screenshot: the light's error as a share of the picture, errors of decay^samples (share),
density and exposure*weight*samples (share), the same over what was quoted, and what the fit says of
itself. Panels are given with --ignore, as a user would. Kind "photograph": rays of all that is
bright, read with --bright-pass. Kind "rayless": pictures with no rays in them, of which it is asked
whether the fit says so.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

import godfit
from godfit.runtime.cache import enable_jax_cache
from tests.support.synthetic import photographs, screens

PHOTOGRAPH = "photograph"


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument(
        "--kinds", nargs="+", default=[*screens.BACKGROUNDS, PHOTOGRAPH, screens.RAYLESS]
    )
    parser.add_argument("--seeds", default="1000:1020")
    options = parser.parse_args()
    enable_jax_cache()
    first, last = map(int, options.seeds.split(":"))
    for kind in options.kinds:
        if kind == screens.RAYLESS:
            told = [says_so(seed) for seed in range(first, last)]
            print(f"{kind}: {sum(told)} of {len(told)} are said to show no rays")
            continue
        rows = [judged(kind, seed) for seed in range(first, last)]
        report(kind, rows)
    return 0


def judged(kind: str, seed: int) -> dict[str, float]:
    """A screenshot read: errors, errors over what is quoted, converged, warned."""
    screen = (
        photographs.make_photograph(seed)
        if kind == PHOTOGRAPH
        else screens.make_screenshot(seed, kind)
    )
    began = time.perf_counter()
    result = fitted(screen)
    row = errors(screen, result) | {"seconds": time.perf_counter() - began}
    print(
        f"{kind:<10}{seed:>5}  light {row['light']:.4f}  "
        + "  ".join(f"{n} {row[n]:+.3f} ({row[n + '/']:+.1f})" for n in JUDGED)
        + f"  {'converged' if row['converged'] else result.message[:60]}"
        + f"{', warned' if row['warned'] else ''}  {row['seconds']:.1f} s",
        flush=True,
    )
    return row


def says_so(seed: int) -> bool:
    """Whether the fit of a picture without rays ends with that."""
    began = time.perf_counter()
    subject, picture = screens.without_rays(seed)
    result = godfit.fit(picture, shader=screens.SCREENSHOT_SHADER)
    told = not result.converged and "no rays" in result.message
    seconds = time.perf_counter() - began
    print(f"{subject:<9}{seed:>5}  {result.message[:70]}  {seconds:.1f} s", flush=True)
    return told


def fitted(screen: screens.Screenshot | photographs.Photograph) -> godfit.FitResult:
    samples = int(screen.truth["samples"])
    if isinstance(screen, photographs.Photograph):
        return godfit.fit(
            screen.image, bright_pass=True, shader=screens.SCREENSHOT_SHADER, samples=samples
        )
    valid = np.ones(screen.image.shape[:2], bool)
    for x, y, w, h in screen.panels:
        valid[y : y + h, x : x + w] = False
    return godfit.fit(screen.image, shader=screens.SCREENSHOT_SHADER, samples=samples, valid=valid)


JUDGED = ("light_x", "light_y", "decay", "density", "gain")


def errors(
    screen: screens.Screenshot | photographs.Photograph, result: godfit.FitResult
) -> dict[str, float]:
    """Errors by name (decay and gain as shares), and name/ over what is quoted."""
    truth, params = screen.truth, result.params
    n = truth["samples"]

    def value(name: str) -> float:
        return params[name].value

    row = {}
    for name in ("light_x", "light_y", "density", "decay"):
        off = value(name) - truth[name]
        quoted = params[name].stderr
        row[name], row[name + "/"] = off, off / quoted if quoted else np.nan
    row["decay"] = (value("decay") / truth["decay"]) ** n - 1
    gain, found = truth["exposure"] * truth["weight"], result.combined["exposure*weight"]
    row["gain"] = found.value / gain - 1
    row["gain/"] = (found.value - gain) / found.stderr if found.stderr else np.nan
    row["light"] = float(np.hypot(row["light_x"], row["light_y"]))
    row["converged"] = result.converged
    row["warned"] = bool(result.warnings)
    return row


def report(kind: str, rows: list[dict[str, float]]) -> None:
    count = len(rows)
    print(f"{kind}: {count} screenshots")
    for share in (0.005, 0.02):
        near = sum(r["light"] <= share for r in rows)
        print(f"  light within {100 * share:g}% of the picture: {near}")
    good = [
        abs(r["decay"]) <= 0.1 and abs(r["density"]) <= 0.05 and abs(r["gain"]) <= 0.1 for r in rows
    ]
    print(f"  decay^samples and gain within 10%, density within .05: {sum(good)}")
    believed = [r for r in rows if r["converged"]]
    for name in JUDGED:
        known = [abs(r[name + "/"]) for r in believed if np.isfinite(r[name + "/"])]
        inside = sum(k <= 1.96 for k in known)
        print(f"  {name}: 95% intervals cover {inside} of {len(known)}")
    silent = sum(not r["warned"] and any(abs(r[n + "/"]) > 5 for n in JUDGED) for r in believed)
    print(f"  converged without a warning and over five errors off: {silent}")
    seconds = np.median([r["seconds"] for r in rows])
    print(f"  not converged: {count - len(believed)}, median {seconds:.1f} s")


if __name__ == "__main__":
    sys.exit(main())

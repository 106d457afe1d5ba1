"""How much better ten frames of a clip tell a shader than one.

    python experiments/bare_pictures/clips.py [--clips A:B] [--frames N] [--kind KIND]

Each clip is made of screenshots (``screens.py``) with one shader, a light that moves on a line, and
objects and backgrounds of their own. For every parameter of the scattering: its error for all
frames together, what was quoted, and the root mean squares of the frames' own errors and of what
they quote; at the end by how much errors, and what is quoted, have shrunk.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

import godfit
from godfit.report.clip import ClipResult, Frame
from godfit.runtime.cache import enable_jax_cache
from tests.support.synthetic import screens

JUDGED = ("decay", "density", "gain")
Estimates = ClipResult | Frame
SHARED = ("decay", "density", "weight", "exposure", "samples")


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--clips", default="3000:3005")
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--kind", default="flat", choices=screens.BACKGROUNDS)
    options = parser.parse_args()
    enable_jax_cache()
    first, last = map(int, options.clips.split(":"))
    rows = [judged(seed, options.frames, options.kind) for seed in range(first, last)]
    print("by how much the error shrinks: all clips together; what is quoted, median clip")
    for i, name in enumerate(JUDGED):
        own, joint = (np.sqrt(np.mean([r[i, k] ** 2 for r in rows])) for k in (0, 1))
        quoted = np.median([r[i, 2] / r[i, 3] for r in rows])
        inside = sum(abs(r[i, 1]) <= 1.96 * r[i, 3] for r in rows)
        print(f"  {name:<8} {own / joint:.2f}  {quoted:.2f}  95% intervals cover {inside}")
    return 0


def clip(seed: int, count: int, kind: str, size: tuple[int, int] = (270, 480)):
    """The truth and the frames (bytes) of a seed."""
    rng = np.random.default_rng(seed)
    ends = rng.uniform(0.2, 0.8, (2, 2))
    truth = screens.make_screenshot(seed, kind, size, frame=screens.ClipFrame(ends[0])).truth
    shared = {name: truth[name] for name in SHARED}
    path = ends[0] + (ends[1] - ends[0]) * np.linspace(0, 1, count)[:, None]
    frames = (
        screens.make_screenshot(
            100 * seed + i, kind, size, frame=screens.ClipFrame(at, shared)
        ).image
        for i, at in enumerate(path)
    )
    return shared, path, frames


def judged(seed: int, count: int, kind: str) -> np.ndarray:
    """(parameter, 4): rms error of single frames, error of all together, and what both quote."""
    began = time.perf_counter()
    truth, path, frames = clip(seed, count, kind)
    samples = int(truth["samples"])
    result = godfit.fit_clip(frames, shader=screens.SCREENSHOT_SHADER, samples=samples)
    used = [f for f in result.frames if not f.message]
    out = np.array(
        [
            [
                rms([error(f, truth, name) for f in used]),
                error(result, truth, name),
                rms([quoted(f, name, samples) for f in used]),
                quoted(result, name, samples),
            ]
            for name in JUDGED
        ]
    )
    light = max(np.abs(f.light - p).max() for f, p in zip(result.frames, path, strict=True))
    print(
        f"{kind} {seed}: {len(used)} of {count} frames, light within {light:.4f}  "
        + "  ".join(
            f"{n} {o[1]:+.4f} quoted {o[3]:.4f} (one frame {o[0]:.4f}, {o[2]:.4f})"
            for n, o in zip(JUDGED, out, strict=True)
        )
        + f"  {'converged' if result.converged else result.message}"
        + f"  {time.perf_counter() - began:.0f} s",
        flush=True,
    )
    return out


def rms(values: list[float]) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


def error(estimates: Estimates, truth: dict[str, float], name: str) -> float:
    """Of density, or as a share of decay^samples and exposure*weight."""
    if name == "gain":
        gain = truth["exposure"] * truth["weight"]
        return estimates.combined["exposure*weight"].value / gain - 1
    value = estimates.params[name].value
    if name == "density":
        return value - truth[name]
    return (value / truth[name]) ** truth["samples"] - 1


def quoted(estimates: Estimates, name: str, n: int) -> float:
    """Of density; of the rest as a share, see ``error``. NaN where nothing is."""
    e = estimates.combined["exposure*weight"] if name == "gain" else estimates.params[name]
    if e.stderr is None:
        return float("nan")
    return e.stderr * {"density": 1, "decay": n / e.value, "gain": 1 / e.value}[name]


if __name__ == "__main__":
    sys.exit(main())

"""How much time does each way of summing take, and how wrong is it?

    python experiments/speed/speed_accuracy.py [--quick] [--repeats N] [--figure FILE]
    python experiments/speed/speed_accuracy.py --holdout N

Four kinds of masks, 8-bit, float32: hard (a disc light behind triangles), soft (clouds), struts (a
lattice) and off screen (a maze, the light outside). The light pass is dawntime's, exposed so that
its 98th percentile is level 255. Times are medians of warm runs, methods in turn. Errors are over
all pixels, unclamped, against the float64 reference (its strips where there are more than 10^8
taps: they agree to rounding): PSNR in dB of the peak level 255, and the largest, in levels.
A method is on the front if none is both faster and, by PSNR, more accurate; from 100 dB on all
count as exact: what is seen there is that float32 rounds the decay. Memory is what XLA sets aside
for a compiled program beside its arguments and result; what numba's strips take within a call is
not in it, some kB.

``--holdout`` draws N random masks, lights and parameters, asks for the cheapest method within half
a level, and compares all pixels with the exact sum.
"""

from __future__ import annotations

import argparse
import functools
import statistics
from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np

from godfit.scattering.conventions import convention
from godfit.scattering.radial import EXACT, METHODS, cheapest, radial_sum
from godfit.scattering.taps import Taps
from tests.support import random_targets
from tests.support.timing import timed

KINDS = {
    "hard": ("triangles", (0.56, 0.6)),
    "soft": ("clouds", (0.45, 0.55)),
    "struts": ("lattice", (0.52, 0.63)),
    "off screen": ("maze", (1.25, 1.3)),
}
DENSITY, WEIGHT, END = 0.85, 0.7, 0.1
SIZES = {"256": (256, 256), "512": (512, 512), "1024": (1024, 1024), "1080p": (1080, 1920)}
SAMPLES = (20, 50, 150, 400, 1000)
TOLERANCE = 0.5
EXACT_DB = 100.0

total = jax.jit(radial_sum, static_argnames="method")


def mask_of(kind: str, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """(h, w) values k/255 and the light. A picture that is not square is the middle of one."""
    name, light = KINDS[kind]
    h, w = size
    square = random_targets.MASKS[name](np.random.default_rng(5), max(size), np.array(light))
    top = (max(size) - h) // 2
    mask = np.floor(square[top : top + h, :w] * 255 + 0.5).clip(0, 255) / 255
    return mask, np.array(light)


def case(kind: str, size: tuple[int, int], samples: int):
    """Mask and light in float64, taps, and the exact sum."""
    mask, light = mask_of(kind, size)
    shader = convention("dawntime")
    decay = END ** (1 / samples)
    method = "reference" if mask.size * samples <= 1e8 else "auto"
    with jax.enable_x64(True):
        taps = shader.taps(1.0, decay, DENSITY, WEIGHT, samples)[0]
        exact = np.asarray(total(jnp.asarray(mask), jnp.asarray(light), taps, method=method))
    exposure = 1 / np.quantile(exact, 0.98)
    taps = shader.taps(float(exposure), decay, DENSITY, WEIGHT, samples)[0]
    return jnp.asarray(mask, jnp.float32), jnp.asarray(light, jnp.float32), taps, exposure * exact


def measure(kinds, size, samples, methods, repeats) -> dict[str, dict[str, tuple]]:
    """{kind: {method: (seconds, dB, levels, bytes)}}"""
    found = {}
    for kind in kinds:
        mask, light, taps, exact = case(kind, size, samples)
        programs = {
            name: jax.jit(radial_sum, static_argnames="method")
            .lower(mask, light, taps, method=name)
            .compile()
            for name in methods
        }
        errors, seconds = {}, {name: [] for name in methods}
        for name, program in programs.items():
            errors[name] = 255 * np.abs(np.asarray(program(mask, light, taps)) - exact)
        for _ in range(repeats):
            for name, program in programs.items():
                seconds[name].append(timed(functools.partial(program, mask, light, taps)))
        found[kind] = {
            name: (
                statistics.median(seconds[name]),
                -10 * np.log10(np.mean((errors[name] / 255) ** 2) + 1e-20),
                errors[name].max(),
                memory(programs[name]),
            )
            for name in methods
        }
    return found


def memory(program: jax.stages.Compiled) -> float:
    analysis = program.memory_analysis()
    return float("nan") if analysis is None else analysis.temp_size_in_bytes


def front(rows: dict[str, tuple]) -> list[str]:
    """Methods that no other beats in both time and PSNR, fastest first."""
    best, found = -np.inf, []
    for name in sorted(rows, key=lambda name: rows[name][0]):
        quality = min(rows[name][1], EXACT_DB)
        if quality > best:
            best = quality
            found.append(name)
    return found


def table(title: str, found: dict[str, dict[str, tuple]]) -> None:
    print(f"\n{title}: ms, dB, largest error in levels; * on the front")
    print(f"{'':10s}" + "".join(f"{kind:>27s}" for kind in found))
    fronts = {kind: front(rows) for kind, rows in found.items()}
    for name in next(iter(found.values())):
        line = f"{name:10s}"
        for kind, rows in found.items():
            time, quality, worst, _ = rows[name]
            star = "*" if name in fronts[kind] else " "
            line += f"{1000 * time:10.1f} {quality:6.1f} {worst:7.3f} {star} "
        print(line, flush=True)


def growth(title: str, labels, columns: list[dict[str, tuple]]) -> None:
    print(f"\n{title}: ms, and MB set aside")
    print(f"{'':10s}" + "".join(f"{label!s:>16s}" for label in labels))
    for name in columns[0]:
        cells = [
            f"{1000 * c[name][0]:8.1f} {c[name][3] / 2**20:7.1f}" if name in c else f"{'-':>16s}"
            for c in columns
        ]
        print(f"{name:10s}" + "".join(cells), flush=True)


def holdout(count: int) -> None:
    """The promise of a tolerance on masks and parameters that nothing was tuned on."""
    chosen: Counter[str] = Counter()
    worst, kept = 0.0, 0
    for seed in range(count):
        mask, light, taps = drawn(seed)
        method = cheapest(mask, light, taps, TOLERANCE)
        error = 255 * np.abs(
            np.asarray(total(mask, light, taps, method=method))
            - np.asarray(total(mask, light, taps))
        )
        chosen[method] += 1
        worst, kept = max(worst, error.max()), kept + (error.max() <= TOLERANCE)
        # Compiled programs are of no use to the next size.
        jax.clear_caches()
    print(f"{kept} of {count} within {TOLERANCE} levels, worst {worst:.3f}")
    print(", ".join(f"{name} {times}" for name, times in chosen.most_common()))


def drawn(seed: int) -> tuple[jax.Array, jax.Array, Taps]:
    """A random mask of any kind and shape, light on or off screen, parameters and exposure."""
    rng = np.random.default_rng([2024, seed])
    kind, size = (
        list(random_targets.MASKS)[seed % len(random_targets.MASKS)],
        int(rng.choice([128, 256, 384, 512])),
    )
    spot = rng.uniform(-0.5, 1.5, 2)
    square = random_targets.MASKS[kind](rng, size, spot)[: int(size * rng.uniform(0.5, 1))]
    mask = jnp.asarray(np.floor(square * 255 + 0.5).clip(0, 255) / 255, jnp.float32)
    light = jnp.asarray(spot, jnp.float32)
    samples = int(np.exp(rng.uniform(np.log(20), np.log(1000))))
    decay = float(rng.uniform(0.001, 0.95) ** (1 / samples))
    density, weight = (float(z) for z in rng.uniform((0.3, 0.2), (1, 1)))
    shader = convention("dawntime")
    taps = shader.taps(1.0, decay, density, weight, samples)[0]
    bright = np.quantile(np.asarray(total(mask, light, taps)), 0.98)
    exposure = float(rng.uniform(0.3, 1.2) / max(bright, 1e-3))
    return mask, light, shader.taps(exposure, decay, density, weight, samples)[0]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true", help="few sizes and samples")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--figure")
    parser.add_argument("--holdout", type=int)
    options = parser.parse_args()
    if options.holdout:
        return holdout(options.holdout)
    sizes = ["256", "512"] if options.quick else list(SIZES)
    samples = [20, 150] if options.quick else list(SAMPLES)
    repeats = options.repeats
    chart = {}
    by_size, by_samples = {}, {}
    for size in sizes:
        for n in samples:
            # Every kind where charts are drawn, one kind for growth elsewhere.
            kinds = list(KINDS) if n == 150 or size == "512" else ["hard"]
            found = measure(kinds, SIZES[size], n, list(METHODS), repeats)
            h, w = SIZES[size]
            table(f"{w}x{h}, n = {n}", found)
            if (size, n) == ("512", 150):
                chart = found
            if n == 150:
                by_size[size] = found["hard"]
            if size == "512":
                by_samples[n] = found["hard"]
    growth("hard mask, n = 150, by pixels", by_size, list(by_size.values()))
    growth("hard mask, 512x512, by n", by_samples, list(by_samples.values()))
    if options.figure:
        draw(chart, by_size, by_samples, options.figure)
    return None


def draw(chart, by_size, by_samples, path: str) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 10.5), layout="constrained")
    grid = figure.subplots(3, 2)
    families = {
        "exact": ("o", "k", list(EXACT)),
        "merged taps": ("s", "C0", ["merged/2", "merged/4", "merged/8"]),
        "low resolution": ("^", "C1", ["half", "quarter"]),
        "polar": ("D", "C2", ["polar"]),
        "Gauss nodes": ("v", "C3", ["gauss/16", "gauss/32"]),
    }
    style = {
        name: (marker, color)
        for marker, color, names in families.values()
        for name in names
        if name in METHODS
    }
    for at, (kind, rows) in zip(grid.flat, chart.items(), strict=False):
        shown = {n: (1000 * r[0], min(r[1], EXACT_DB)) for n, r in rows.items()}
        line = front(rows)
        at.step(*np.transpose([shown[n] for n in line]), where="post", color="0.7", zorder=0)
        for name, (x, y) in shown.items():
            marker, color = style[name]
            on = name in line
            at.plot(x, y, marker, color=color, ms=7, mfc=color if on else "w")
        label(at, shown)
        at.set_xscale("log")
        # Room for names on both sides.
        times = [x for x, _ in shown.values()]
        ticks(at.xaxis, times)
        at.set(xlim=(min(times) / 3, max(times) * 1.8), ylim=(15, 122))
        at.set(title=f"{kind}, 512x512, n = 150", xlabel="time, ms", ylabel="PSNR, dB")
        at.grid(color="0.92")
    pixels = [SIZES[s][0] * SIZES[s][1] for s in by_size]
    for at, x, columns, title, xlabel, names in (
        (grid[2, 0], pixels, by_size, "hard, n = 150", "pixels", list(SIZES)),
        (grid[2, 1], list(by_samples), by_samples, "hard, 512x512", "n", None),
    ):
        for name in ("reference", "pairs", "packed", "strips", "merged/4", "half", "polar"):
            if name in style:
                dash = {"reference": ":", "pairs": "--", "packed": "-."}.get(name, "-")
                y = [1000 * c[name][0] for c in columns.values()]
                marker, color = style[name]
                at.loglog(x, y, dash, marker=marker, color=color, ms=4, label=name)
        at.set(title=title, xlabel=xlabel, ylabel="time, ms")
        at.set_xticks(x, [str(n) for n in x] if names is None else list(by_size))
        at.set_xticks([], minor=True)
        times = [1000 * r[0] for c in columns.values() for r in c.values()]
        ticks(at.yaxis, times)
        # Room for the legend.
        at.set_ylim(min(times) / 1.5, 8 * max(times))
        at.grid(color="0.92")
        at.legend(fontsize=7, ncols=2)
    figure.savefig(path, dpi=100)


def ticks(axis, values) -> None:
    """1, 2, 5, 10, ... within the values' range and a little about it."""
    marks = [m * 10.0**e for e in range(-2, 5) for m in (1, 2, 5)]
    marks = [m for m in marks if min(values) / 1.5 < m < max(values) * 1.5]
    axis.set_ticks(marks, [f"{m:g}" for m in marks])
    axis.set_ticks([], minor=True)


def label(at, shown: dict[str, tuple[float, float]]) -> None:
    """Names beside the points: those of merged taps to the left, out of the others' way; those of
    exact methods, all at one height, in turn above and below."""
    turn = 0
    for name, (x, y) in sorted(shown.items(), key=lambda item: item[1]):
        if y >= EXACT_DB:
            turn += 1
            above = turn % 2 == 1
            # The first below is the left one.
            across = "center" if above else "right" if turn == 2 else "left"
            shift = 0 if above else 10 if turn == 2 else -10
            where, up = (shift, 7 if above else -7), "bottom" if above else "top"
        elif name.startswith("merged"):
            where, across, up = (-7, 2), "right", "bottom"
        else:
            where, across, up = (7, -1), "left", "top"
        at.annotate(name, (x, y), where, textcoords="offset points", ha=across, va=up, fontsize=8)


if __name__ == "__main__":
    main()

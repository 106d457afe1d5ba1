"""How long does a fit take, and how much memory? Are its sums right?

    python experiments/speed/benchmark.py [--repeats N]

512x512 and 1920x1080 pixels, 150 samples, one channel, float32: the sum and its Jacobian (six
parameters) of a hard mask, most of which is flat, and of noise, of which nothing is, with their
largest error against the reference in float64 as a share of the largest value in that column; fits
without an initial guess. The parts are run in turn, again and again, and medians are printed. The
whole command is a process of its own, first with an empty cache of compiled programs; its memory is
what it takes beyond an interpreter that has imported JAX.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from godfit import Mitchell, fit, write_image
from tests.support import random_targets
from tests.support.timing import timed

SIZES = ((512, 512), (1080, 1920))
SAMPLES = 150
TRUTH = {"exposure": 0.05, "decay": 0.985, "density": 0.85, "weight": 0.7}
LIGHT = (0.56, 0.6)
# Kinds and seeds of masks: where density is in doubt at first, a fit takes longer.
FITTED = (("triangles", 5), ("triangles", 6), ("ellipses", 5), ("ellipses", 6), ("lattice", 5),
          ("lattice", 6), ("maze", 5))  # fmt: skip
# Of this process alone: what getrusage says would hold that of the one that started it.
PEAK = "print(next(line for line in open('/proc/self/status') if 'VmHWM' in line).split()[1])"


def masks(size: tuple[int, int]) -> dict[str, np.ndarray]:
    """Bytes, (h, w)."""
    rng, (h, w) = np.random.default_rng(5), size
    hard = random_targets.triangles(rng, max(size), np.array(LIGHT))[:h, :w]
    return {
        "hard": np.floor(hard * 255 + 0.5).astype(np.uint8),
        "noise": rng.integers(0, 256, size, dtype=np.uint8),
    }


def targets(
    size: tuple[int, int], light_pass: Callable[[np.ndarray], object]
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Masks and targets of several kinds, bytes, exposed so that few pixels clip."""
    found = {}
    for kind, seed in FITTED:
        rng, (h, w) = np.random.default_rng(seed), size
        mask = random_targets.MASKS[kind](rng, max(size), np.array(LIGHT))[:h, :w]
        mask = np.floor(mask * 255 + 0.5).clip(0, 255).astype(np.uint8)
        image = np.asarray(light_pass(mask), np.float64)
        found[f"{kind} {seed}"] = (
            mask,
            random_targets.to_bytes(image * (0.9 / np.quantile(image, 0.98))),
        )
    return found


def forward(point, mask, method: str = "auto"):
    model = Mitchell(**TRUTH, light=LIGHT, shader="dawntime", samples=SAMPLES)
    return model.moved(point)(mask, method=method)


def both(point, mask, method: str = "auto"):
    """Value and Jacobian."""

    def value(z):
        out = forward(z, mask, method)
        return out, out

    jacobian, out = jax.jacfwd(value, has_aux=True)(point)
    return out, jacobian


def errors(mask: np.ndarray, point: np.ndarray) -> tuple[float, float, float]:
    """Against the reference in float64 at the same point, as shares of the largest value in a
    column: of the sum, of the Jacobian, and the share of the Jacobian's entries beyond 1e-5.
    Across a texel's border the bilinear mask has two slopes, and which one a tap within rounding
    of a border has is anybody's guess."""
    values = mask / np.float32(255)
    single = jax.jit(both)(jnp.asarray(point), jnp.asarray(values))
    with jax.enable_x64(True):
        exact = jax.jit(both, static_argnames="method")(
            jnp.asarray(point, float), jnp.asarray(values, float), method="reference"
        )
    out, jacobian = (
        np.abs(np.asarray(a, float) - np.asarray(b)) / np.abs(b).max((0, 1))
        for a, b in zip(single, exact, strict=True)
    )
    return float(out.max()), float(jacobian.max()), float((jacobian > 1e-5).mean())


def command(arguments: list[str], cache: Path) -> tuple[float, float]:
    """Seconds and peak memory (MB) of a whole command."""
    program = f"import sys, os; from godfit.__main__ import main; main(sys.argv[1:]); {PEAK}"
    # As the command itself ends: an orderly shutdown would come on top.
    program += "; sys.stdout.flush(); os._exit(0)"
    began = time.perf_counter()
    run = subprocess.run(
        [sys.executable, "-c", program, *arguments],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"GODFIT_CACHE": str(cache)},
    )
    return time.perf_counter() - began, int(run.stdout.split()[-1]) / 1024


def commands(mask: np.ndarray, target: np.ndarray, firsts: int, repeats: int) -> None:
    program = "import jax; jax.numpy.ones(1).sum();" + PEAK
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    base = int(run.stdout) / 1024
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_image(folder / "m.png", mask / np.float32(255))
        write_image(folder / "t.png", target / np.float32(255))
        arguments = ["fit", str(folder / "t.png"), "--mask", str(folder / "m.png"), "-q"]
        arguments += ["--shader", "dawntime", "--samples", str(SAMPLES)]
        first = [command(arguments, folder / f"cache{i}") for i in range(firsts)]
        later = [command(arguments, folder / "cache0") for _ in range(repeats)]
        # One after the other, so that both meet the same machine.
        pairs = [
            [command([*arguments, page], folder / "cache0")[0] for page in ("--html", "--no-html")]
            for _ in range(repeats)
        ]
        size = (folder / "t.godfit" / "report.html").stat().st_size
    say("command with fit.png, first", statistics.median(s for s, _ in first))
    say("command with fit.png, later", statistics.median(s for s, _ in later))
    say("what report.html adds", statistics.median(one - other for one, other in pairs))
    print(f"  {'size of report.html':28s} {size / 1e6:9.2f} MB")
    print(f"  {'memory, first and later':28s} {max(m for _, m in first) - base:9.0f} MB"
          f" {max(m for _, m in later) - base:9.0f} MB")  # fmt: skip


def say(name: str, seconds: float) -> None:
    print(f"  {name:28s} {1000 * seconds:9.1f} ms", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=7)
    repeats = parser.parse_args().repeats
    model = Mitchell(**TRUTH, light=LIGHT, shader="dawntime", samples=SAMPLES)
    point = np.asarray(model.coordinates())
    one, two = jax.jit(forward), jax.jit(both)
    for size in SIZES:
        print(f"{size[1]}x{size[0]} pixels, {SAMPLES} samples")
        parts: dict[str, Callable[[], object]] = {}
        for kind, mask in masks(size).items():
            values = jnp.asarray(mask, jnp.float32) / 255
            parts[f"{kind}: sum"] = lambda values=values: one(point, values)
            parts[f"{kind}: sum and Jacobian"] = lambda values=values: two(point, values)
            off = point * np.float32(1.0137)
            found = errors(mask, off)
            print("  {}: errors {:.1e}, Jacobian {:.1e}, {:.1e} beyond".format(kind, *found))
        pairs = targets(size, lambda mask: one(point, jnp.asarray(mask, jnp.float32) / 255))
        for name, (mask, target) in pairs.items():
            parts[f"fit: {name}"] = lambda mask=mask, target=target: (
                fit(target, mask=mask, shader="dawntime", samples=SAMPLES).rmse_levels
            )
        for part in parts.values():
            timed(part)
        seconds = [[timed(part) for part in parts.values()] for _ in range(repeats)]
        medians = [statistics.median(found) for found in zip(*seconds, strict=True)]
        for name, median in zip(parts, medians, strict=True):
            say(name, median)
        fits = [m for name, m in zip(parts, medians, strict=True) if name.startswith("fit")]
        say("fit: median of these", statistics.median(fits))
        commands(*next(iter(pairs.values())), 3 if size == SIZES[0] else 1, 5)


if __name__ == "__main__":
    main()

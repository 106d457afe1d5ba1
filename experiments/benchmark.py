"""How long does a fit take, and how much memory?

    python experiments/benchmark.py [--repeats N]

512x512 pixels, 150 samples, one channel. The parts are run in turn, again and again, and medians
are printed; the whole command is a process of its own, first with an empty compilation cache.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import scenes

from godfit import Mitchell, fit, write_image

SIZE, SAMPLES = 512, 150
TRUTH = {"exposure": 0.05, "decay": 0.985, "density": 0.85, "weight": 0.7}
LIGHT = (0.56, 0.6)


def timed(function) -> float:
    began = time.perf_counter()
    jax.block_until_ready(function())
    return time.perf_counter() - began


def command(folder: Path, cache: Path) -> tuple[float, float]:
    """Seconds and peak memory (MB) of the whole command."""
    arguments = ["fit", folder / "t.png", "--mask", folder / "m.png", "--shader", "dawntime"]
    arguments += ["--samples", str(SAMPLES), "--json", "-q"]
    program = (
        "import resource, sys; from godfit.__main__ import main; main(sys.argv[1:]);"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, file=sys.stderr)"
    )
    began = time.perf_counter()
    run = subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"GODFIT_CACHE": str(cache)},
    )
    return time.perf_counter() - began, int(run.stderr.split()[-1]) / 1024


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=7)
    repeats = parser.parse_args().repeats
    rng = np.random.default_rng(5)
    mask = np.floor(scenes.triangles(rng, SIZE, np.array(LIGHT)) * 255 + 0.5).astype(np.uint8)
    values = jnp.asarray(mask, jnp.float32) / 255
    model = Mitchell(**TRUTH, light=LIGHT, shader="dawntime", samples=SAMPLES)
    forward = jax.jit(lambda z: model.moved(z)(values))
    both = jax.jit(
        lambda z: (model.moved(z)(values), jax.jacfwd(lambda z: model.moved(z)(values))(z))
    )
    naive = jax.jit(jax.jacfwd(lambda z: model.moved(z)(values, method="reference")))
    point = model.coordinates()
    target = scenes.to_bytes(np.asarray(forward(point), np.float64))
    parts = {
        "forward": lambda: forward(point),
        "value and Jacobian": lambda: both(point),
        "Jacobian by jacfwd of the reference": lambda: naive(point),
        "fit, warm": lambda: fit(target, mask=mask, shader="dawntime", samples=SAMPLES).rmse_levels,
    }
    for part in parts.values():
        timed(part)
    seconds: dict[str, list[float]] = {name: [] for name in parts}
    for _ in range(repeats):
        for name, part in parts.items():
            seconds[name].append(timed(part))
    for name, found in seconds.items():
        print(f"{name:38s} {statistics.median(found):8.3f} s")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_image(folder / "m.png", mask / np.float32(255))
        write_image(folder / "t.png", target / np.float32(255))
        first = [command(folder, folder / f"cache{i}") for i in range(3)]
        later = [command(folder, folder / "cache0") for _ in range(3)]
    print(f"{'whole command, first time':38s} {statistics.median(s for s, _ in first):8.3f} s")
    print(
        f"{'whole command, from the second on':38s} {statistics.median(s for s, _ in later):8.3f} s"
    )
    print(f"{'peak memory of the command':38s} {max(m for _, m in first + later):8.0f} MB")


if __name__ == "__main__":
    main()

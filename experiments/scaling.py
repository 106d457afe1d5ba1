"""How many fits a second does one machine make, and how far are the sums from what it can do?

    python experiments/scaling.py [--processes N ...] [--fits N] [--figure FILE]

512x512 bytes, 150 samples, dawntime, two masks: hard triangles, most of them flat, and noise, of
which nothing is.

Fits: targets of random truths behind one mask, shared out among warm processes. Each process has
its own cores, and XLA makes no more threads than it has cores.

Roofline: a sum reads the mask once and writes the picture once (8 bytes a pixel). Each tap is at
least an interpolation along the columns (3 operations) of a share 1 - t of the rows, then one
along the rows that is added up (2 multiplications, 2 additions), where nothing is flat:
taps x pixels x (4 + 3 mean(1 - t)) operations. Methods are held against the measured rates of
multiplications and additions and of copies, in memory and in the cache that holds mask and picture.
How much they read of it differs: 16 bytes a tap and pixel, or the strips' 8 + 8 mean(1 - t). All
methods of ``godfit.scattering.radial.METHODS`` that are exact take part: within 1e-5 of white of float64.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import statistics
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numba
import numpy as np
import scenes

from godfit import Mitchell, fit
from godfit.scattering.radial import METHODS

SIZE, SAMPLES = 512, 150
DENSITY, LIGHT = 0.85, (0.56, 0.6)
TAPS = SAMPLES - 1
# The mean of 1 - t over the taps.
LEFT = 1 - DENSITY * SAMPLES / 2 / SAMPLES
OPERATIONS = TAPS * SIZE**2 * (4 + 3 * LEFT)
# Bytes that a tap reads for each pixel: of the mask, or of strips of it.
READS = {"strips": 8 + 8 * LEFT}
EXACT = 1e-5


def cores() -> list[int]:
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def shares(places: list[int], count: int) -> list[list[int]]:
    """``places`` for each of ``count`` processes; with more processes than places, in turn."""
    return [places[i::count] or [places[i % len(places)]] for i in range(count)]


# Fits a second.


def targets(count: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """A mask of bytes and pictures (bytes) of random truths."""
    rng = np.random.default_rng(7)
    mask = np.floor(hard_mask() * 255 + 0.5).astype(np.uint8)
    made = []
    for _ in range(count):
        truth = {
            "exposure": 1.0,
            "decay": rng.uniform(0.005, 0.5) ** (1 / SAMPLES),
            "density": rng.uniform(0.5, 1.0),
            "weight": rng.uniform(0.3, 1.0),
            "light_x": LIGHT[0] + rng.uniform(-0.1, 0.1),
            "light_y": LIGHT[1] + rng.uniform(-0.1, 0.1),
            "samples": SAMPLES,
        }
        image = scenes.render64(mask / 255, truth)
        made.append(scenes.to_bytes(image / image.max()))
    return mask, made


def one(mask: np.ndarray, target: np.ndarray) -> bool:
    return fit(target, mask=mask, shader="dawntime", samples=SAMPLES).converged


def work(places, mask, queue, done, ready) -> None:
    """A process: takes its cores before XLA counts them, warms up, then fits what is queued."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, places)
    one(mask, queue.get())
    ready.wait()
    while (target := queue.get()) is not None:
        done.put(one(mask, target))


def throughput(processes: int, mask: np.ndarray, pictures: list[np.ndarray]) -> tuple[float, int]:
    """Fits a second, and how many of them converged."""
    context = multiprocessing.get_context("spawn")
    queue, done, ready = context.Queue(), context.Queue(), context.Barrier(processes + 1)
    # Each takes one of the first to warm up with and waits; none is left over.
    for target in [pictures[0]] * processes:
        queue.put(target)
    workers = [
        context.Process(target=work, args=(places, mask, queue, done, ready), daemon=True)
        for places in shares(cores(), processes)
    ]
    for worker in workers:
        worker.start()
    ready.wait()
    began = time.perf_counter()
    for target in pictures + [None] * processes:
        queue.put(target)
    converged = sum(done.get() for _ in pictures)
    seconds = time.perf_counter() - began
    for worker in workers:
        worker.join()
    return len(pictures) / seconds, converged


# What the machine can do.


@numba.njit(parallel=True, cache=True)
def copy(source, target, times):
    """Each thread copies its own part, ``times`` over."""
    for part in numba.prange(source.shape[0]):
        for _ in range(times):
            for i in range(source.shape[1]):
                target[part, i] = source[part, i]


@numba.njit(parallel=True, fastmath=True, cache=True)
def multiply_add(values, times):
    """``times`` multiplications and additions of each of values (parts, 64), float32: enough of
    them side by side to hide how long each takes."""
    a, b = np.float32(0.999), np.float32(0.001)
    for part in numba.prange(values.shape[0]):
        row = values[part].copy()
        for _ in range(times):
            for i in range(64):
                row[i] = a * row[i] + b
        values[part] = row


def seconds(function: Callable[[], object], repeats: int = 7) -> float:
    """Median of a warm function."""
    jax.block_until_ready(function())
    found = []
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(function())
        found.append(time.perf_counter() - began)
    return statistics.median(found)


def bandwidth(numbers: int, times: int) -> float:
    """Bytes a second, read and written, of copies of ``numbers`` float32 by every core."""
    parts = len(cores())
    source = np.ones((parts, numbers // parts), np.float32)
    target = np.empty_like(source)
    return 2 * source.nbytes * times / seconds(lambda: copy(source, target, times))


def arithmetic() -> float:
    """Multiplications and additions of float32 a second, every core."""
    values, times = np.ones((16 * len(cores()), 64), np.float32), 100_000
    return 2 * values.size * times / seconds(lambda: multiply_add(values, times))


# Where the methods stand.


def hard_mask() -> np.ndarray:
    return scenes.triangles(np.random.default_rng(5), SIZE, np.array(LIGHT))


def exact(mask: np.ndarray, size: int = 64) -> list[str]:
    """Names of the methods that give the reference's numbers, on a corner of ``mask``."""
    part = mask[:size, :size]
    truth = {"exposure": 0.02, "decay": 0.985, "density": DENSITY, "weight": 0.7}
    expected = scenes.render64(
        part, truth | {"light_x": LIGHT[0], "light_y": LIGHT[1], "samples": SAMPLES}
    )
    model = Mitchell(**truth, light=LIGHT, shader="dawntime", samples=SAMPLES)

    def worst(method):
        found = model.light_pass(jnp.asarray(part, jnp.float32), method=method)
        return np.abs(np.asarray(found) - expected).max()

    return [method for method in METHODS if worst(method) < EXACT]


def sum_seconds(mask: np.ndarray, method: str) -> float:
    model = Mitchell(0.02, 0.985, DENSITY, 0.7, LIGHT, "dawntime", SAMPLES)
    values = jnp.asarray(mask, jnp.float32)
    forward = jax.jit(lambda z: model.moved(z).light_pass(values, method=method))
    point = model.coordinates()
    return seconds(lambda: forward(point))


def roofline(figure: str | None) -> None:
    rate = arithmetic()
    # More than caches hold; and as large as the mask and the picture are.
    memory, cache = bandwidth(1 << 26, 1), bandwidth(SIZE**2, 200)
    print(
        f"arithmetic {rate / 1e9:.1f} GFLOP/s; copies {memory / 1e9:.1f} GB/s from memory, ", end=""
    )
    print(f"{cache / 1e9:.1f} GB/s from the cache")
    least = 8 * SIZE**2
    print(
        f"the sum: {OPERATIONS / 1e6:.0f} M operations, at least {OPERATIONS / rate * 1e3:.2f} ms;",
        end="",
    )
    print(f" {least / 1e6:.1f} MB, at least {least / memory * 1e3:.2f} ms")
    masks = {"noise": np.random.default_rng(5).random((SIZE, SIZE)), "triangles": hard_mask()}
    points = []
    print(f"{'':12s} {'mask':10s} {'ms':>7s} {'GFLOP/s':>8s} of arithmetic")
    for method in exact(masks["noise"]):
        for kind, mask in masks.items():
            spent = sum_seconds(mask, method)
            reached = OPERATIONS / spent
            row = f"{method:12s} {kind:10s} {spent * 1e3:7.1f} {reached / 1e9:8.1f}"
            print(f"{row} {reached / rate:6.0%}")
            read = TAPS * SIZE**2 * READS.get(method, 16)
            points.append((method, kind, OPERATIONS / read, reached))
    if figure:
        draw(rate, memory, cache, points, figure)


def draw(rate: float, memory: float, cache: float, points, path: str) -> None:
    """Operations a second against operations for each byte that is read."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot()
    intensity = np.geomspace(0.05, 300, 200)
    for roof, words, style in ((cache, "cache", "-"), (memory, "memory", "--")):
        height = np.minimum(rate, roof * intensity) / 1e9
        label = f"{rate / 1e9:.0f} GFLOP/s, {roof / 1e9:.0f} GB/s from {words}"
        axes.plot(intensity, height, style, color="black", lw=1, label=label)
    whole = OPERATIONS / (8 * SIZE**2)
    axes.axvline(whole, color="silver", lw=1)
    axes.text(whole, rate / 1e10, "mask and picture once ", ha="right", fontsize=8)
    for method, kind, at, reached in points:
        colour = f"C{sorted(METHODS).index(method)}"
        face = colour if kind == "noise" else "none"
        axes.plot(at, reached / 1e9, "o", color=colour, markerfacecolor=face)
        name = f"  {method}" + ("" if kind == "noise" else ", flat in parts")
        above = "bottom" if method == "reference" else "top"
        axes.text(at, reached / 1e9, name, va=above, fontsize=8, color=colour)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("least operations / bytes read")
    axes.set_ylabel("least operations / time, GFLOP/s")
    axes.legend(frameon=False, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=100)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--processes", type=int, nargs="+", default=sorted({1, len(cores())}))
    parser.add_argument("--fits", type=int, default=24)
    parser.add_argument("--figure")
    options = parser.parse_args()
    roofline(options.figure)
    mask, pictures = targets(options.fits)
    for processes in options.processes:
        rate, converged = throughput(processes, mask, pictures)
        each = len(shares(cores(), processes)[0])
        print(
            f"{processes} processes of {each} cores: {rate:.2f} fits/s, "
            f"{converged} of {options.fits} converged",
            flush=True,
        )


if __name__ == "__main__":
    main()

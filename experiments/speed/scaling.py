"""How many fits a second does one machine make, and how far are the sums from what it can do?

    python experiments/speed/scaling.py [--processes N ...] [--fits N] [--figure FILE]

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
methods of ``godfit.scattering.radial.METHODS`` that are exact take part: within 1e-5 of white of
float64.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import time

import numpy as np

from godfit import fit
from godfit.scattering.radial import METHODS
from tests.support import random_targets
from tests.support.roofline import (
    LIGHT,
    OPERATIONS,
    READS,
    SAMPLES,
    SIZE,
    TAPS,
    arithmetic,
    bandwidth,
    cores,
    exact,
    hard_mask,
    shares,
    sum_seconds,
)

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
        image = random_targets.render64(mask / 255, truth)
        made.append(random_targets.to_bytes(image / image.max()))
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


# Where the methods stand.


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

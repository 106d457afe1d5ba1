"""How many fits a second does a batch make, and what would limit a cluster of such machines?

    python experiments/speed/batch_scaling.py [--frames N] [--size N] [--workers N ...]
                                              [--machines N ...]

Frames of random truths with a mask each, 60 samples. A run of few frames is taken from one of many,
so that what is left is the fits alone; the run of few frames is the start. Each run is a command of
its own, after one that fills the cache of compiled programs. ``apart`` is one command a core, each
with its shard, which share nothing: what the workers of one command are compared with.

Processor time is that of the command and its workers, and is little changed by other work on the
machine, which wall time is not. A worker has one core: a fit's processor time is its wall time on
an idle machine.

What limits N machines is computed from the parts: a fit's time on a core, what one record costs
the journal (a commit by the client) and the way (a task out and a record back, on the loopback),
and the start of a worker with and without compiled programs.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from godfit.runtime.parallel import cores
from godfit.studies.batch import engine
from godfit.studies.batch.engine import Engine, outcomes
from godfit.studies.batch.jobs import Job
from godfit.studies.batch.journal import Journal
from godfit.studies.batch.worker import Task
from tests.support import batch_work

FEW = 4
"""Frames of the run that stands for the start."""
COMMITS = 300
"""Commits that are timed."""
TASKS = 400
"""Tasks that are sent and come back."""
FRAMES_OF_A_JOB = 10_000
"""Frames of the batch whose time on a cluster is computed."""


class Cost(NamedTuple):
    """Seconds: wall and processor."""

    wall: float
    processor: float

    def minus(self, other: Cost, count: int) -> Cost:
        """The difference, for each of ``count``."""
        return Cost((self.wall - other.wall) / count, (self.processor - other.processor) / count)


def cost(commands: list[list[str]], environment: dict[str, str]) -> Cost:
    """What commands cost that run at the same time."""

    def processor() -> float:
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime

    began, before = time.perf_counter(), processor()
    quiet = {"env": environment, "stdout": subprocess.DEVNULL}
    running = [subprocess.Popen(command, **quiet) for command in commands]
    for process in running:
        if process.wait() not in (0, 3):
            raise SystemExit(f"expected fits, got status {process.returncode}")
    return Cost(time.perf_counter() - began, processor() - before)


def command(folder: Path, run: str, frames: int, *options: str) -> list[str]:
    """A batch of the first ``frames`` frames."""
    names = [str(folder / "frames" / f"f_{i}.png") for i in range(frames)]
    return [
        sys.executable, "-m", "godfit", "batch", *names, "-q", "-o", str(folder / run),
        "--mask", str(folder / "masks" / "{stem}.png"), "--shader", "dawntime",
        "--samples", str(batch_work.SAMPLES), *options,
    ]  # fmt: skip


def line(each: Cost) -> str:
    """A line of the table, for one fit."""
    return f"{1 / each.wall:8.2f} {each.wall:8.3f} {each.processor:18.3f}"


def commit_seconds(folder: Path, workers: int) -> tuple[float, int]:
    """Seconds of a commit, and bytes of a record with its thumbnail."""
    with Journal(folder / f"few{workers}" / "journal.sqlite", writes=False) as few:
        outcome = next(row.outcome for row in few.rows() if row.outcome)
        (size,) = few.connection.execute(
            "select avg(length(record) + length(thumbnail)) from fits"
        ).fetchone()
    with Journal(folder / "commits.sqlite") as journal:
        began = time.perf_counter()
        for i in range(COMMITS):
            journal.add(f"{i:064}", outcome)
        return (time.perf_counter() - began) / COMMITS, round(size)


def way_seconds(folder: Path) -> float:
    """Seconds of a task's way to a worker and back, with work that takes none."""
    target = str(folder / "frames" / "f_0.png")
    jobs = [Job(target, (target,), {}, str(i)) for i in range(TASKS + 1)]
    fit_one, engine.fit_one = engine.fit_one, batch_work.stand_in
    try:
        found = outcomes(jobs, lambda job: Task(job.targets, {}, os.getcwd()), Engine(2))
        next(found)
        began = time.perf_counter()
        count = sum(1 for _ in found)
    finally:
        engine.fit_one = fit_one
    return (time.perf_counter() - began) / count


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--workers", type=int, nargs="+", default=sorted({1, cores()}))
    parser.add_argument("--machines", type=int, nargs="+", default=[1, 10, 100, 1000])
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cache = folder / "cache"
        cache.mkdir(mode=0o700)
        environment = os.environ | {"GODFIT_CACHE": str(cache), "JAX_PLATFORMS": "cpu"}
        batch_work.write_frames(folder, given.frames, given.size)
        cold = cost([command(folder, "cold", 1, "--workers", "1")], environment)
        warm = cost([command(folder, "warm", 1, "--workers", "1")], environment)
        for what, start in (("nothing is compiled", cold), ("all is compiled", warm)):
            print(f"start where {what}: {start.wall:.1f} s, processor {start.processor:.1f} s")
        print(f"{'':>12} {'fits/s':>8} {'s a fit':>8} {'processor s a fit':>18}")
        one = 0.0
        for workers in given.workers:
            options = ("--workers", str(workers))
            few = cost([command(folder, f"few{workers}", FEW, *options)], environment)
            many = cost([command(folder, f"many{workers}", given.frames, *options)], environment)
            each = many.minus(few, given.frames - FEW)
            one = one or each.processor
            print(
                f"{workers:>4} workers {1 / each.wall:8.2f} {each.wall:8.3f} {each.processor:18.3f}"
            )
        count = max(given.workers)
        shards = [("--workers", "1", "--shard", f"{i}/{count}") for i in range(1, count + 1)]
        few = cost([command(folder, "apart few", FEW, *s) for s in shards], environment)
        many = cost([command(folder, "apart", given.frames, *s) for s in shards], environment)
        each = many.minus(few, given.frames - FEW)
        print(f"{count:>5} apart  {line(each)}")
        # In kilobytes, the largest of all processes that were waited for.
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
        commit, size = commit_seconds(folder, given.workers[0])
        way = way_seconds(folder)
    print(f"memory of the largest process: {peak / 1e6:.2f} GB")
    print(
        f"journal: {1e3 * commit:.2f} ms a record of {size:,} bytes; way: {1e3 * way:.2f} ms a task"
    )
    print(f"\n{FRAMES_OF_A_JOB:,} frames on N machines of {cores()} cores, computed:")
    print(f"{'N':>6} {'fits/s':>9} {'minutes':>8}  limit")
    for machines in given.machines:
        rates = {
            "fits": machines * cores() / one,
            "journal and way, one client": 1 / (commit + way),
        }
        limit = min(rates, key=lambda part: rates[part])
        begin, work = cold.processor, FRAMES_OF_A_JOB / rates[limit]
        said = f"{limit}; the start is {100 * begin / (begin + work):.0f}% of the time"
        print(f"{machines:>6} {rates[limit]:9.1f} {(begin + work) / 60:8.1f}  {said}")


if __name__ == "__main__":
    main()

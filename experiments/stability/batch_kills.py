"""Does a batch that is killed at random moments end with the table of one that was not?

    python experiments/stability/batch_kills.py [--moments N] [--seconds S] [--frames N]
                                                    [--real] [--seed N]

At each moment one of three is killed by SIGKILL: the client, a worker, or the client with all its
workers. A client that was killed is started again with the same command, until a run ends by
itself. Then every frame must be in the table once, and the table must be that of an undisturbed
run, byte for byte. Work that depends on the frame's bytes stands for the fits, .2 s each; with
``--real`` frames are fitted. A line for each moment; the exit status is 1 if a table differs.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

from tests.support import batch_work
from tests.support.paths import ROOT

SIZE = 64
"""Pixels of a side of the frames."""


def command(folder: Path, run: str, real: bool, *options: str) -> list[str]:
    """The batch of all frames."""
    program = "godfit" if real else "tests.support.batch_work"
    return [
        sys.executable, "-m", program, "batch", str(folder / "frames" / "*.png"), "-q",
        "--mask", str(folder / "masks" / "{stem}.png"), "--shader", "dawntime",
        "--samples", str(batch_work.SAMPLES), "-o", str(folder / run), *options,
    ]  # fmt: skip


def victims(client: subprocess.Popen, kind: str, rng: random.Random) -> list[psutil.Process]:
    """The processes that are killed."""
    parent = psutil.Process(client.pid)
    below = [p for p in parent.children(recursive=True) if "spawn_main" in " ".join(p.cmdline())]
    if kind == "client" or not below:
        return [parent]
    return [rng.choice(below)] if kind == "worker" else [parent, *below]


def disturbed(
    arguments: list[str], environment: dict[str, str], moments: list[tuple[str, float]], seed: int
) -> int:
    """Start and kill until a run ends by itself; returns how often something was killed."""
    rng, left, killed = random.Random(seed), list(moments), 0
    while True:
        client = subprocess.Popen(arguments, env=environment, cwd=ROOT, stdout=subprocess.DEVNULL)
        while left:
            kind, seconds = left[0]
            try:
                client.wait(seconds)
                break
            except subprocess.TimeoutExpired:
                left.pop(0)
            try:
                chosen = victims(client, kind, rng)
            except psutil.Error:
                break
            for process in chosen:
                try:
                    process.send_signal(signal.SIGKILL)
                    killed += 1
                except psutil.NoSuchProcess:
                    continue
            print(f"  {kind} killed after {seconds:.1f} s ({len(chosen)} processes)", flush=True)
            if chosen[0].pid == client.pid:
                break
        status = client.wait()
        if status >= 0:
            return killed
        time.sleep(0.1)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moments", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=8.0, help="latest moment after a start")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--real", action="store_true")
    given = parser.parse_args()
    rng = random.Random(given.seed)
    environment = os.environ | {
        "PYTHONPATH": str(ROOT), batch_work.SECONDS_VARIABLE: "0.2", "JAX_PLATFORMS": "cpu",
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        batch_work.write_frames(folder, given.frames, SIZE)
        tables = [folder / "whole.csv", folder / "killed.csv"]
        subprocess.run(
            command(folder, "whole", given.real, "--table", str(tables[0])),
            env=environment, cwd=ROOT, stdout=subprocess.DEVNULL, check=False,
        )  # fmt: skip
        moments = [
            (kind, rng.uniform(0.3, given.seconds))
            for kind in rng.choices(("client", "worker", "all"), k=given.moments)
        ]
        killed = disturbed(
            command(folder, "killed", given.real, "--table", str(tables[1])),
            environment, moments, given.seed,
        )  # fmt: skip
        whole, found = (table.read_text() for table in tables)
    paths = [line.split(",")[0] for line in found.splitlines()[1:]]
    same = found == whole
    print(
        f"{killed} processes killed; {len(paths)} lines, {len(set(paths))} frames of "
        f"{given.frames}; the table is {'the same' if same else 'ANOTHER'}"
    )
    return 0 if same and len(set(paths)) == len(paths) == given.frames else 1


if __name__ == "__main__":
    sys.exit(main())

"""Does a fit survive a damaged cache, a folder that is not its own, a signal, a full disk?

    python experiments/stability/faults.py [--only KIND ...]

Each line is one fault and what came of it. After a fault the same picture is fitted twice: both
answers must be those of an undisturbed fit, nothing that was laid into the cache may run, and at
most one warning may come. An interrupted fit must end with 130 and one line. A full disk is a small
file system in memory, which only root may mount. The exit status is 1 if one line fails.

The first moment is the interpreter's own: before it has set its handlers a signal ends it. That
moment alone may end so, and is marked "interpreter".
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

TARGET = Path(__file__).parents[2] / "data_synthetic" / "disc.png"
FLIPS = 200
"""Bytes that are changed in a file, or all of a shorter one."""
MOMENTS = 20
"""Signals, spread evenly over SPAN seconds from the start."""
SPAN = 4.0
"""Seconds within which the signals come."""
KILLS = 10
"""Processes that are killed at moments of SPAN, on an empty cache."""
AT_ONCE = 6
"""Processes that start at the same time on an empty cache."""
DISK = "200k"
"""Size of the full disk: less than one compiled program."""


class Planted:
    """Unpickled, it makes a file: the proof that the cache ran what it found."""

    def __init__(self, sign: Path):
        self.sign = sign

    def __reduce__(self):
        return os.mkdir, (str(self.sign),)


class Bench:
    """Fits of one picture in ``folder``, with a cache folder of their own."""

    def __init__(self, folder: Path):
        self.folder, self.cache, self.sign = folder, folder / "cache", folder / "has_run"
        self.fit()
        expected, lines = self.fit()
        if expected is None:
            sys.exit(f"expected an undisturbed fit to succeed, got {lines}")
        self.expected = expected

    def start(self, out: str = "out", **variables: str) -> subprocess.Popen:
        command = [sys.executable, "-m", "godfit", "fit", str(TARGET), "-o", str(self.folder / out)]
        environment = os.environ | {"GODFIT_CACHE": str(self.cache), "NO_COLOR": "1"} | variables
        environment = {name: value for name, value in environment.items() if value}
        pipe = subprocess.PIPE
        return subprocess.Popen(
            [*command, "-q"], cwd=self.folder, env=environment, stdout=pipe, stderr=pipe, text=True
        )

    def ended(self, process: subprocess.Popen, out: str = "out"):
        """The parameters, None where there are none, and the lines on stderr."""
        _, said = process.communicate(timeout=600)
        lines = said.strip().splitlines()
        if process.returncode:
            return None, [f"exit {process.returncode}", *lines]
        record = json.loads((self.folder / out / "fit.json").read_text())
        return {name: p["value"] for name, p in record["params"].items()}, lines

    def fit(self, **variables: str):
        return self.ended(self.start(**variables))

    def right_twice(self, **variables: str) -> str:
        """The fault's outcome: "right", or what is wrong."""
        for turn in ("first", "second"):
            found, lines = self.fit(**variables)
            if found is None:
                return f"{turn} run: {' | '.join(lines)[:200]}"
            if not all(np.isclose(found[k], v, rtol=1e-6) for k, v in self.expected.items()):
                return f"{turn} run: wrong answer {found}"
            if len(lines) > 1:
                return f"{turn} run: {len(lines)} warnings"
        return "WHAT WAS LAID THERE HAS RUN" if self.sign.exists() else "right"

    def files(self) -> list[Path]:
        return [path for path in sorted(self.cache.rglob("*")) if path.is_file()]


def damaged(bench: Bench) -> Iterator[tuple[str, str]]:
    """Every file of a warm cache, in each way that a file can be damaged."""
    rng = np.random.default_rng(0)

    def flipped(data: bytes) -> bytes:
        values = np.frombuffer(data, np.uint8).copy()
        places = rng.choice(len(values), min(FLIPS, len(values)), replace=False)
        values[places] ^= rng.integers(1, 256, len(places)).astype(np.uint8)
        return values.tobytes()

    ways: dict[str, Callable[[bytes], bytes]] = {
        "emptied": lambda _: b"",
        "cut": lambda data: data[: len(data) // 2],
        "flipped": flipped,
        "a pickle": lambda _: pickle.dumps(Planted(bench.sign)),
    }
    for name, change in ways.items():
        bench.fit()
        for path in bench.files():
            path.write_bytes(change(path.read_bytes()))
        yield f"every file {name}", bench.right_twice()


def folders(bench: Bench) -> Iterator[tuple[str, str]]:
    """Folders that the cache must leave alone, with files in them that would run."""
    bench.fit()
    for path in bench.files():
        path.write_bytes(pickle.dumps(Planted(bench.sign)))
    bench.cache.chmod(0o777)
    yield "mode 0777", bench.right_twice()
    bench.cache.chmod(0o700)
    yield "relative XDG_CACHE_HOME", bench.right_twice(GODFIT_CACHE="", XDG_CACHE_HOME="cache")
    if os.geteuid():
        print("another user's folder, full disk: not tried, as they need root")
        return
    os.chown(bench.cache, 12345, 12345)
    yield "another user's folder", bench.right_twice()
    os.chown(bench.cache, 0, 0)
    disk = bench.folder / "disk"
    for name, options in (("full disk", f"size={DISK},mode=700"), ("read-only disk", "ro")):
        disk.mkdir(exist_ok=True)
        mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "none", str(disk)])
        if mounted.returncode:
            print(f"{name}: not tried, as nothing can be mounted here")
            continue
        yield name, bench.right_twice(GODFIT_CACHE=str(disk))
        subprocess.run(["umount", str(disk)], check=True)


def interrupted(bench: Bench) -> Iterator[tuple[str, str]]:
    """SIGINT at moments of a warm fit."""
    bench.fit()
    for moment in np.linspace(0, SPAN, MOMENTS):
        process = bench.start("stopped")
        time.sleep(moment)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
        lines, code = said.strip().splitlines(), process.returncode
        ours = any("godfit" in line for line in lines)
        if code == 0 or (code == 130 and len(lines) == 1):
            outcome = "right"
        elif moment == 0 and code == -signal.SIGINT and not ours:
            outcome = "interpreter"
        else:
            outcome = f"exit {code}: {' | '.join(lines)[:200]}"
        yield f"SIGINT at {moment:.2f} s", outcome


def killed(bench: Bench) -> Iterator[tuple[str, str]]:
    """SIGKILL while the cache is filled, and several processes that fill it at once."""
    for number in range(KILLS):
        bench.cache = bench.folder / f"killed_{number}"
        process = bench.start("stopped")
        time.sleep(SPAN * (number + 1) / KILLS)
        process.kill()
        process.communicate()
        yield f"kill -9 at {SPAN * (number + 1) / KILLS:.1f} s", bench.right_twice()
    bench.cache = bench.folder / "at_once"
    names = [f"out_{number}" for number in range(AT_ONCE)]
    found = [bench.ended(process, out) for out, process in [(n, bench.start(n)) for n in names]]
    same = all(
        values is not None and all(np.isclose(values[k], v) for k, v in bench.expected.items())
        for values, _ in found
    )
    yield f"{AT_ONCE} at once", "right" if same else str(found)[:300]


KINDS = {"damaged": damaged, "folders": folders, "interrupted": interrupted, "killed": killed}


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--only", nargs="+", choices=KINDS, default=list(KINDS))
    options = parser.parse_args()
    failed = 0
    with tempfile.TemporaryDirectory() as name:
        for kind in options.only:
            folder = Path(name) / kind
            folder.mkdir()
            for fault, outcome in KINDS[kind](Bench(folder)):
                failed += outcome not in ("right", "interpreter")
                print(f"{fault:28} {outcome}", flush=True)
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())

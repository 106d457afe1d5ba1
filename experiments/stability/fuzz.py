"""Does a damaged or hostile file end in anything but one line?

    python experiments/stability/fuzz.py [--count N] [--seed N] [--keep FOLDER]

Valid files of every format are cut, flipped, and filled with nested brackets, endless numbers and
terminal escapes, and read as the program reads them, in processes of their own. A file fails where
reading raises anything but InputError, ends the process, takes over 20 s, or more than 2 GB. The
exit status is 1 if one fails; ``--keep`` keeps those files.
"""

from __future__ import annotations

import argparse
import collections
import os
import resource
import shutil
import signal
import sys
import tempfile
from pathlib import Path

from tests.support.hostile_files import attempt, valid_files, write_hostile

BATCH = 250
"""Files that one process reads: starting one takes a second."""
SECONDS = 20
"""Time in which a file must be read."""
MEMORY = 2 << 30
"""Memory that a process may take, in bytes."""


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path)
    options = parser.parse_args()
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    files, failed = valid_files(), []
    table: dict[str, collections.Counter] = collections.defaultdict(collections.Counter)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for other in ("mask.png", "part.obj"):
            (folder / other).write_bytes(files.get(other, files["grey.png"]))
        seed, end = options.seed, options.seed + options.count
        while seed < end:
            for at, outcome in in_process(folder, files, range(seed, min(seed + BATCH, end))):
                kind = sorted(files)[at % len(files)]
                good = outcome in ("read", "refused")
                table[kind][outcome if good else "FAILED"] += 1
                seed = at + 1
                (folder / "part.obj").write_bytes(files["part.obj"])
                if good:
                    continue
                failed.append(at)
                print(f"{kind} seed {at}: {outcome}", flush=True)
                if options.keep:
                    options.keep.mkdir(parents=True, exist_ok=True)
                    path = write_hostile(folder, files, at)
                    shutil.copy(path, options.keep / f"{at}-{path.name}")
    print(f"\n{'file':16} read refused failed")
    for kind, row in sorted(table.items()):
        print(f"{kind:16} {row['read']:4} {row['refused']:7} {row['FAILED']:6}")
    print(f"{options.count} files, {len(failed)} failed")
    return 1 if failed else 0


def in_process(folder: Path, files: dict[str, bytes], seeds: range):
    """(seed, outcome) of each of ``seeds``, up to one that ends the process that reads them."""
    receiver, sender = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(receiver)
        read_all(folder, files, seeds, sender)
        os._exit(0)
    os.close(sender)
    done = 0
    with open(receiver, encoding="utf-8") as lines:
        for line in lines:
            yield seeds[done], line.rstrip("\n")
            done += 1
    status, used = os.wait4(child, 0)[1:]
    if done < len(seeds):
        number = os.waitstatus_to_exitcode(status)
        name = signal.Signals(-number).name if number < 0 else f"status {number}"
        yield seeds[done], f"ended in {'a hang' if name == 'SIGALRM' else name}"
    elif used.ru_maxrss << 10 > MEMORY:
        print(f"seeds {seeds}: took {used.ru_maxrss >> 10} MiB", flush=True)


def read_all(folder: Path, files: dict[str, bytes], seeds: range, sender: int) -> None:
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    # Address space is more than memory: JAX reserves some that it does not use.
    resource.setrlimit(resource.RLIMIT_AS, (2 * MEMORY, 2 * MEMORY))
    for seed in seeds:
        signal.alarm(SECONDS)
        outcome = attempt(write_hostile(folder, files, seed))
        signal.alarm(0)
        (folder / "part.obj").write_bytes(files["part.obj"])
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
        if peak > MEMORY:
            outcome = f"took {peak >> 20} MiB"
        os.write(sender, (" ".join(outcome.split()) + "\n").encode(errors="replace"))
        if peak > MEMORY:
            os._exit(0)


if __name__ == "__main__":
    sys.exit(main())

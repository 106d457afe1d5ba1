"""The cores of a process, and one of its own.

XLA makes as many threads as the process has cores when JAX is imported, and affinity is the only
limit that it obeys. The number of threads changes the order of some sums, and so the last digits of
a fit. A process with one core leaves the others to others, and its results depend on no machine's
number of cores.
"""

from __future__ import annotations

import contextlib
import os
import socket


def cores() -> int:
    """Number of cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


class OneCore:
    """The threads of this process run on one core, which no other process has that does the same.

    A core is claimed by a socket in Linux's abstract namespace, which ends with the process. Where
    all are claimed, one is shared. Nothing happens on systems without affinity.
    """

    def __init__(self) -> None:
        self.claim: socket.socket | None = None
        self.before: set[int] = set()
        if not hasattr(os, "sched_setaffinity"):
            return
        self.before = os.sched_getaffinity(0)
        cores = sorted(self.before)
        free = next((core for core in cores if self._claimed(core)), None)
        _move_threads({cores[os.getpid() % len(cores)] if free is None else free})

    def release(self) -> None:
        """The process has the cores that it had before."""
        if self.claim is not None:
            self.claim.close()
            self.claim = None
        if self.before:
            _move_threads(self.before)

    def _claimed(self, core: int) -> bool:
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            claim.bind(f"\0godfit-core-{os.getuid()}-{core}")
        except OSError:
            claim.close()
            return False
        self.claim = claim
        return True


def _move_threads(cores: set[int]) -> None:
    """All threads of this process run on ``cores``; new ones inherit that."""
    for thread in os.listdir("/proc/self/task") if os.path.isdir("/proc/self/task") else ["0"]:
        with contextlib.suppress(OSError):
            os.sched_setaffinity(int(thread), cores)

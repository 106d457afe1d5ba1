"""What a worker of dask is set up with. This file alone needs dask to be imported."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
from typing import Any

from distributed import WorkerPlugin


class OneCore(WorkerPlugin):
    """Each worker takes a core of its own before JAX is imported.

    Affinity is the only limit on threads that XLA obeys. A core is claimed by a socket in Linux's
    abstract namespace, which ends with the process. Elsewhere nothing is claimed. With ``local``
    an interrupt is left to the process that has started the worker.
    """

    name = "godfit-one-core"
    idempotent = True

    def __init__(self, local: bool) -> None:
        self.local = local
        self.claim: socket.socket | None = None
        self.cores: set[int] = set()

    def setup(self, worker: Any = None) -> None:
        if self.local:
            # A plugin is set up in the main thread, except where a program has started the worker.
            with contextlib.suppress(ValueError):
                signal.signal(signal.SIGINT, signal.SIG_IGN)
        if not hasattr(os, "sched_setaffinity"):
            return
        self.cores = os.sched_getaffinity(0)
        free = next((core for core in sorted(self.cores) if self._claimed(core)), None)
        ordered = sorted(self.cores)
        _move_threads({ordered[os.getpid() % len(ordered)] if free is None else free})

    def teardown(self, worker: Any = None) -> None:
        """The worker of another's cluster has the cores that it had."""
        if self.claim is not None:
            self.claim.close()
            self.claim = None
        if self.cores:
            _move_threads(self.cores)

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

"""What a worker of dask is set up with. This file alone needs dask to be imported."""

from __future__ import annotations

import contextlib
import signal
from typing import Any

from distributed import WorkerPlugin

from godfit.runtime.one_core import OneCore


class WorkerSetup(WorkerPlugin):
    """Each worker takes a core of its own before JAX is imported. With ``local`` an interrupt is
    left to the process that has started the worker."""

    name = "godfit-worker-setup"
    idempotent = True

    def __init__(self, local: bool) -> None:
        self.local = local
        self.core: OneCore | None = None

    def setup(self, worker: Any) -> None:
        if self.local:
            # A worker that a program runs within itself is not in the main thread.
            with contextlib.suppress(ValueError):
                signal.signal(signal.SIGINT, signal.SIG_IGN)
                # A queue of jobs sends it to all processes; the client alone prints a line.
                signal.signal(signal.SIGTERM, signal.SIG_DFL)
        self.core = OneCore()

    def teardown(self, worker: Any) -> None:
        """A worker of another's cluster has its cores again."""
        if self.core is not None:
            self.core.release()

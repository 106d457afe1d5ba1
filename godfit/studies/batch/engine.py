"""Workers that fit jobs: dask.distributed on this machine or on a cluster, or this process alone.

dask.distributed was chosen for what it does when a process dies: of 20 tasks, one that raises and
two whose process is killed, it finishes the others and names the two. The pools of the standard
library and of loky end with the first process that is killed.
"""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import os
import signal
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

from godfit.errors import InputError
from godfit.runtime.memory import FIT_BYTES, available_memory
from godfit.runtime.parallel import cores
from godfit.studies.batch.jobs import Job
from godfit.studies.batch.worker import CRASHED, FAILED, Outcome, Task, fit_one

BASE_BYTES = 1_200_000_000
"""Memory of a worker for small pictures, in bytes: its programs, JAX, and what a compilation
takes."""
OUTSTANDING = 4
"""Jobs that a worker has at once, so that it never waits for the client."""
ALLOWED_DEATHS = 1
"""Workers that may end during a fit before the fit is suspected to end them."""
SETTINGS = {
    "distributed.scheduler.allowed-failures": ALLOWED_DEATHS,
    # A worker holds no second job, which would be suspected when the first one ends the process.
    "distributed.scheduler.worker-saturation": 1.0,
    # Records are small: memory is that of compiled programs, which cannot be spilled.
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 0.95,
    "distributed.worker.profile.enabled": False,
}
"""Settings of dask for the workers that are started here."""
START_TRIES = 3
"""Times that the workers are started, until all are there."""
CONNECT_SECONDS = 30.0
"""Time to reach a scheduler, in seconds."""
ANY_PORT = "127.0.0.1:0"
"""Address of dask's page, which cannot be left out: a free port that this machine alone reaches."""
LOGGERS = ("distributed", "tornado", "asyncio")
"""Loggers of dask and of what it is made of."""
QUIET_TRACKER = "ignore::UserWarning:multiprocessing.resource_tracker"
"""A filter of warnings for processes that are started."""
WITHOUT_DASK = "needs the package distributed; pip install 'godfit[batch]'"


class Engine(NamedTuple):
    """Who fits: ``workers`` processes of this machine (None for as many as it has room for, 1 for
    this process alone), or those of the ``scheduler`` at an address or named by a file.
    ``own_process`` says that this process may be set up for fits alone."""

    workers: int | None = None
    scheduler: str | None = None
    own_process: bool = False


class Queue:
    """Jobs in the order of their fits: one of each group first, so that programs are compiled once.
    With ``hold`` the others of a group wait for it."""

    def __init__(self, jobs: Sequence[Job], hold: bool) -> None:
        self.ready: deque[Job] = deque()
        self.held: dict[str, list[Job]] = {}
        for job in jobs:
            if job.group in self.held:
                self.held[job.group].append(job)
            else:
                self.ready.append(job)
                self.held[job.group] = []
        if not hold:
            for group in list(self.held):
                self.release(group)

    def next(self) -> Job | None:
        """A job that may begin, None while all that are left are held."""
        return self.ready.popleft() if self.ready else None

    def release(self, group: str) -> None:
        """The first job of a group has ended: the others may begin."""
        self.ready.extend(self.held.pop(group, ()))


def outcomes(
    jobs: Sequence[Job], task_of: Callable[[Job], Task], engine: Engine
) -> Iterator[tuple[Job, Outcome]]:
    """Fit all jobs; each comes with how its fit ended, in the order in which they end. Workers
    that were started here end with the iterator.

    Raises InputError where there is no scheduler, or its packages are of other versions.
    """
    if not jobs:
        return
    count = 1 if engine.scheduler else _worker_count(jobs, engine.workers)
    if engine.scheduler is None and count == 1:
        for job in Queue(jobs, hold=False).ready:
            yield job, fit_one(task_of(job)._replace(own_process=engine.own_process))
        return
    with _connected(count, engine.scheduler) as client:
        yield from _distributed(client, jobs, task_of, local=engine.scheduler is None)


def has_dask() -> bool:
    """Whether several processes can fit."""
    return importlib.util.find_spec("distributed") is not None


def _worker_count(jobs: Sequence[Job], wanted: int | None) -> int:
    """Processes that fit at once: as many as this machine has cores and memory for, and no more
    than there are jobs. Raises InputError for several without dask."""
    if not has_dask():
        if (wanted or 1) > 1:
            raise InputError(f"--workers {wanted}: {WITHOUT_DASK}, or give --workers 1")
        return 1
    if wanted is None:
        room = available_memory()
        need = BASE_BYTES + FIT_BYTES * max(job.pixels for job in jobs)
        wanted = cores() if room is None else min(cores(), room // need)
    return max(1, min(wanted, len(jobs)))


@contextlib.contextmanager
def _connected(count: int, scheduler: str | None) -> Iterator[Any]:
    """A client of ``scheduler``, or of ``count`` workers that are started here and end with it."""
    try:
        import dask.config
        from distributed import Client, LocalCluster

        from godfit.studies.batch.plugin import WorkerSetup
    except ImportError as error:
        raise InputError(f"--scheduler: {WITHOUT_DASK}") from error
    environment = {"JAX_PLATFORMS": os.environ.get("JAX_PLATFORMS", "cpu")}
    settings = {**SETTINGS, "distributed.nanny.pre-spawn-environ": environment}
    with contextlib.ExitStack() as stack:
        stack.enter_context(_quiet_loggers())
        if scheduler is not None:
            client = _client_of(scheduler)
        else:
            stack.enter_context(dask.config.set(settings))
            stack.enter_context(_importable())
            with _undisturbed():
                cluster = _cluster(count, LocalCluster)
                stack.callback(_ended, cluster.close)
                client = Client(cluster, set_as_default=False)
        stack.callback(_ended, client.close)
        try:
            client.get_versions(check=True)
        except ValueError as error:
            raise InputError(
                f"--scheduler: expected one version of each package on all machines, got others: "
                f"{' '.join(str(error).split())}"
            ) from error
        plugin = WorkerSetup(local=scheduler is None)
        try:
            client.register_plugin(plugin)
        except Exception as error:
            raise InputError(
                f"--scheduler: expected godfit {metadata.version('godfit')} on all machines, got "
                f"{error}"
            ) from error
        if scheduler is not None:
            # A cluster of others is left as it was.
            stack.callback(_ended, client.unregister_worker_plugin, plugin.name)
        yield client


def _ended(end: Callable[..., Any], *arguments: Any) -> None:
    """Call what ends a part of dask. What it could not end in time ends with this process."""
    with contextlib.suppress(Exception):
        end(*arguments)


def _cluster(count: int, start: Callable[..., Any]) -> Any:
    """``count`` workers of this machine. A process that is killed while it starts is no reason to
    end the run: all are started again. Raises InputError where that fails each time."""
    for left in reversed(range(START_TRIES)):
        try:
            return start(
                n_workers=count, threads_per_worker=1, processes=True, host="127.0.0.1",
                memory_limit=_memory_limit(count), dashboard_address=ANY_PORT,
                silence_logs=logging.CRITICAL,
            )  # fmt: skip
        except RuntimeError as error:
            if not left:
                raise InputError(
                    f"--workers: expected {count} processes to start, got '{error}'; what was "
                    "fitted is kept: give the same command again, or fewer --workers"
                ) from error
    raise AssertionError


def _client_of(scheduler: str) -> Any:
    """A client of the scheduler at an address, or of the one that a file names."""
    from distributed import Client

    is_file = "://" not in scheduler
    if is_file and not os.path.isfile(scheduler):
        raise InputError(
            f"--scheduler: expected an address such as tcp://host:8786 or a scheduler's file, got "
            f"'{scheduler}'"
        )
    place: dict[str, Any] = {"scheduler_file" if is_file else "address": scheduler}
    try:
        return Client(**place, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, KeyError) as error:
        raise InputError(
            f"--scheduler: expected a scheduler at '{scheduler}', got none within "
            f"{CONNECT_SECONDS:g} s ({type(error).__name__}); start `dask scheduler` there"
        ) from error


@contextlib.contextmanager
def _quiet_loggers() -> Iterator[None]:
    """Dask's reports of workers that end: the outcomes have them."""
    loggers = [logging.getLogger(name) for name in LOGGERS]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


@contextlib.contextmanager
def _importable() -> Iterator[None]:
    """Processes that are started inside import this package from where it is. ``python -m godfit``
    takes the current folder off the path, which may be the package's. Here it comes after
    all other packages, so that no file in it is taken for one of them."""
    root = str(Path(__file__).parents[3])
    if root in sys.path:
        yield
        return
    others = [i for i, place in enumerate(sys.path) if os.path.isdir(os.path.join(place, "godfit"))]
    sys.path.insert(min(others, default=len(sys.path)), root)
    try:
        yield
    finally:
        sys.path.remove(root)


def _memory_limit(count: int) -> int:
    """Bytes of memory that each of ``count`` workers may hold; 0 for no limit."""
    room = available_memory()
    return 0 if room is None else int(room // count)


@contextlib.contextmanager
def _undisturbed() -> Iterator[None]:
    """Threads and processes that are started inside have interrupts blocked: Ctrl-C reaches every
    process of a terminal, and only the client answers it. A client that is killed leaves
    semaphores; the process of Python that removes them says nothing."""
    before = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, [before, QUIET_TRACKER]))
    blocks = hasattr(signal, "pthread_sigmask")
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if blocks else None
    try:
        yield
    finally:
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if before is None:
            del os.environ["PYTHONWARNINGS"]
        else:
            os.environ["PYTHONWARNINGS"] = before


def _distributed(
    client: Any, jobs: Sequence[Job], task_of: Callable[[Job], Task], local: bool
) -> Iterator[tuple[Job, Outcome]]:
    """The outcomes of jobs that the client's workers fit."""
    from distributed import as_completed

    # On a cluster each machine compiles for itself, and none waits for another.
    queue = Queue(jobs, hold=local)
    running: dict[Any, Job] = {}
    suspects: list[Job] = []
    completed = as_completed(loop=client.loop)

    def begin(job: Job, attempt: str = "") -> None:
        key = f"godfit-{attempt}{job.key}"
        # Not pure: dask would keep the results of equal calls.
        future = client.submit(fit_one, task_of(job), key=key, pure=False)
        running[future] = job
        completed.add(future)

    def fill() -> None:
        room = OUTSTANDING * max(1, len(client.nthreads()))
        while len(running) < room and (job := queue.next()) is not None:
            begin(job)

    fill()
    for future in completed:
        job = running.pop(future)
        queue.release(job.group)
        outcome = _outcome_of(future)
        future.release()
        if outcome is None:
            suspects.append(job)
        fill()
        if outcome is not None:
            yield job, outcome
    for job in suspects:
        # A worker's end is blamed on all jobs that it had. Alone, a job is blamed for its own.
        begin(job, "alone-")
        for future in completed:
            running.pop(future)
            outcome = _outcome_of(future)
            future.release()
            ended = f"its worker ended {2 * (ALLOWED_DEATHS + 1)} times, without an error"
            yield job, outcome or Outcome(CRASHED, error=ended)


def _outcome_of(future: Any) -> Outcome | None:
    """What a future has come to; None where its worker ended. Raises InputError where the
    scheduler went away."""
    from concurrent.futures import CancelledError

    from distributed.scheduler import KilledWorker

    try:
        return future.result()
    except KilledWorker:
        return None
    except CancelledError as error:
        raise InputError(
            "the scheduler ended; what was fitted is kept: give the same command again"
        ) from error
    except Exception as error:
        return Outcome(FAILED, error=f"worker: {type(error).__name__}: {error}")

"""A run: jobs go through the engine into the journal."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import metadata
from typing import Any, NamedTuple

from godfit.errors import InputError
from godfit.studies.batch.engine import Engine, outcomes
from godfit.studies.batch.jobs import Job, jobs_of
from godfit.studies.batch.journal import NAME, Journal, stored_name
from godfit.studies.batch.worker import CONVERGED, FAILED, NOT_CONVERGED, Outcome, Task

PICTURES = "frames"
"""The folder of a run in which each fit has a folder with its pictures."""


class FrameFit(NamedTuple):
    """A frame of a batch and its fit: ``record`` is the contents of fit.json, None where the fit
    failed or crashed, which ``error`` explains. ``status`` is one of ``worker.STATUSES``.

    >>> import godfit
    >>> godfit.FrameFit("frame.png", "failed", None, "no such file", 0.0, "here").error
    'no such file'
    """

    path: str
    status: str
    record: dict[str, Any] | None
    error: str
    seconds: float
    host: str

    @staticmethod
    def of(path: str, outcome: Outcome) -> FrameFit:
        """The frame ``path`` with the outcome of its fit."""
        return FrameFit(
            path, outcome.status, outcome.record, outcome.error, outcome.seconds, outcome.host
        )


class Settings(NamedTuple):
    """What a run does beside its fits: ``retry_failed`` fits the frames that failed and no others;
    ``folder`` is the run's, in which fits leave ``pictures`` if wanted, and with ``html`` their
    pages too; ``command`` is kept in the records."""

    folder: str = ""
    retry_failed: bool = False
    pictures: bool = False
    command: str = ""
    html: bool = False


def batch(
    paths: str | Sequence[str],
    *,
    output: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    retry_failed: bool = False,
    **options: Any,
) -> Iterator[FrameFit]:
    """Fit many pictures and clips; returns an iterator of their fits as they come.

    **Arguments:**

    - `paths`: names of files, or patterns such as `"frames/*.png"`. A video is one clip.
    - `output`: the folder of the run, in which `journal.sqlite` keeps every fit. The same call goes
      on with an interrupted run: what was fitted comes first, from the journal. None keeps nothing.
    - `workers`: processes that fit, by default one for each core. With 1 this process fits.
      Processes are spawned, so a script needs `if __name__ == "__main__":` around the call.
    - `scheduler`: the address or the file of a scheduler of dask, in place of own workers.
    - `retry_failed`: fit those that failed before, and no others.
    - `options`: of `godfit.fit`, with names of files in place of images. In them {stem} and
      {folder} stand for those of the picture: `mask="masks/{stem}.png"`. The file beside a picture
      is read as on the command line.

    **Returns:** an iterator of `FrameFit`. Closing it ends the workers. Raises `InputError` for
    patterns without files; what is wrong with one frame is that frame's error.

    >>> import godfit
    >>> frames = godfit.batch(
    ...     "frame.png", mask="mask.png", shader="dawntime", samples=30, workers=1
    ... )
    >>> [frame.status for frame in frames]
    ['converged']
    """
    patterns = [paths] if isinstance(paths, str) else [os.fspath(path) for path in paths]
    jobs = jobs_of(patterns, options)
    engine = Engine(workers, scheduler)
    folder = "" if output is None else os.fspath(output)

    def fits() -> Iterator[FrameFit]:
        with opened_journal(folder) as journal:
            settings = Settings(folder, retry_failed)
            if not retry_failed:
                journal.plan([(job.path, job.key) for job in jobs])
                for job in jobs:
                    known = journal.outcome(job.key)
                    if known is not None:
                        yield FrameFit.of(job.path, known)
            yield from run_jobs(jobs, journal, engine, settings)

    return fits()


def opened_journal(folder: str, name: str = NAME) -> Journal:
    """The journal of a run in ``folder``, which is made if need be; one in memory without a
    folder. Raises InputError for a folder that cannot be written."""
    if not folder:
        return Journal(":memory:")
    try:
        os.makedirs(folder, exist_ok=True)
        return Journal(os.path.join(folder, name))
    except OSError as error:
        raise InputError(
            f"output: '{folder}': {error.strerror or error}; choose another folder with -o"
        ) from error


def to_do(jobs: Sequence[Job], journal: Journal, settings: Settings) -> list[Job]:
    """The jobs that have not been fitted, or with ``retry_failed`` those that failed."""
    if settings.retry_failed:
        failed = journal.failed_paths()
        return [job for job in jobs if stored_name(job.path) in failed]
    done = journal.done()
    left = [job for job in jobs if job.key not in done]
    last = "report.html" if settings.html else "fit.png"
    if settings.pictures or settings.html:
        # A fit that was made without its pictures is made again.
        lacking = {CONVERGED, NOT_CONVERGED}
        left += [
            job
            for job in jobs
            if done.get(job.key) in lacking
            and not os.path.isfile(os.path.join(_folder(job, settings), last))
        ]
    return left


def run_jobs(
    jobs: Sequence[Job],
    journal: Journal,
    engine: Engine,
    settings: Settings,
    begin: Callable[[int], None] | None = None,
) -> Iterator[FrameFit]:
    """Fit what is to do among the jobs, and keep each fit as it ends. Frames of equal keys share a
    fit. ``begin`` is called with the number of frames to do."""
    left = to_do(jobs, journal, settings)
    alike: dict[str, list[str]] = {}
    for job in left:
        alike.setdefault(job.key, []).append(job.path)
    if begin is not None:
        begin(len(left))
    wrong = {job.key: job for job in left if job.error}
    for key, job in wrong.items():
        yield from _kept(journal, alike[key], key, Outcome(FAILED, error=job.error))
    once = {job.key: job for job in left if job.key not in wrong}
    version = metadata.version("godfit")

    def task_of(job: Job) -> Task:
        wanted = settings.pictures or settings.html
        folder = os.path.abspath(_folder(job, settings)) if wanted else ""
        return Task(
            job.targets, job.options, os.getcwd(), folder, settings.command, version,
            page=settings.html,
        )  # fmt: skip

    for job, outcome in outcomes(list(once.values()), task_of, engine):
        yield from _kept(journal, alike[job.key], job.key, outcome)


def _kept(journal: Journal, paths: Sequence[str], key: str, outcome: Outcome) -> Iterator[FrameFit]:
    """Keep an outcome, then yield it for each of its frames."""
    journal.add(key, outcome, paths)
    for path in paths:
        yield FrameFit.of(path, outcome)


def _folder(job: Job, settings: Settings) -> str:
    """Where the pictures of a job go: its name, and enough of its key to be the only one."""
    name = os.path.splitext(os.path.basename(os.path.normpath(job.path)))[0]
    return os.path.join(settings.folder, PICTURES, f"{name}-{job.key[:8]}")


def exit_status(counts: Mapping[str, int]) -> int:
    """0 if all frames converged, 3 if some did not, 1 if some have no fit."""
    fitted = counts[CONVERGED] + counts[NOT_CONVERGED]
    if sum(counts.values()) > fitted:
        return 1
    return 3 if counts[NOT_CONVERGED] else 0

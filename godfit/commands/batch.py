"""``godfit batch``: the parameters of many pictures and clips."""

from __future__ import annotations

import glob
import json
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING, Any

import click

from godfit.commands.batch_progress import BatchProgress
from godfit.commands.options import (
    BRIGHT_PASS,
    JSON,
    MAX_SEED,
    PICTURE_OPTIONS,
    QUIET,
    Command,
    Run,
    assignments,
    with_run,
)
from godfit.commands.progress import warn
from godfit.commands.study import command_line, start_jax
from godfit.runtime.interrupts import report_on_interrupt

if TYPE_CHECKING:
    from godfit.studies.batch.engine import Engine
    from godfit.studies.batch.journal import Journal
    from godfit.studies.batch.run import Settings

SLURM = "slurm"
"""The value of --shard for the place of this task in Slurm's array of jobs."""
SHOWN_FAILURES = 20
"""Frames that failed and are named on stderr; the table has all."""


@click.command(cls=Command)
@click.argument("targets", nargs=-1)
@PICTURE_OPTIONS
@click.option(
    "--occluder", help="Without a mask: an image that is not black where further objects are."
)
@BRIGHT_PASS
@click.option("--model", help="mitchell, hoffman-preetham or flatland. [default: mitchell]")
@click.option(
    "--free", multiple=True, metavar="NAME", help="Fit this quantity of the scenes as well."
)
@click.option("--lights", type=int, help="Number of lights. [default: 1]")
@click.option(
    "--fix",
    multiple=True,
    metavar="NAME[=VALUE]",
    callback=assignments,
    help="Hold a parameter fixed.",
)
@click.option(
    "--start",
    multiple=True,
    metavar="NAME=VALUE",
    callback=assignments,
    help="Start the search of a parameter at a value.",
)
@click.option("--every", type=click.IntRange(1), help="Use every N-th frame of a clip.")
@click.option("--clips", is_flag=True, help="The frames of each folder are one clip.")
@click.option(
    "--seed", type=click.IntRange(0, MAX_SEED), help="Seed of the random choice of pixels."
)
@click.option("--workers", type=click.IntRange(1), help="Processes. [default: one a core]")
@click.option(
    "--scheduler",
    metavar="ADDRESS|FILE",
    help="Fit on the cluster of this scheduler of dask, in place of own processes.",
)
@click.option(
    "--shard",
    metavar="I/N",
    help="Fit every N-th frame, from the I-th on; 'slurm' takes both from an array of jobs.",
)
@click.option("--merge", is_flag=True, help="TARGETs are runs or journals: gather them in one.")
@click.option("--retry-failed", is_flag=True, help="Fit the frames that failed, and no others.")
@click.option("--pictures", is_flag=True, help="Write fit.json, fit.png and render.png of each.")
@click.option("--html", is_flag=True, help="Write report.html of each too, see `godfit view`.")
@click.option("--table", metavar="FILE", help="Write a table, .csv or .parquet.")
@click.option("--report", is_flag=True, help="Write DIR/report.html, a page with all frames.")
@with_run(
    click.option("-o", "--output", metavar="DIR", required=True, help="Folder of the run."),
    JSON,
    QUIET,
)
def batch(
    targets: tuple[str, ...],
    workers: int | None,
    scheduler: str | None,
    shard: str | None,
    run: Run,
    **given: Any,
) -> int:
    """Fit many TARGETs: pictures, videos, and patterns of them in quotes.

    The results go to DIR/journal.sqlite, one by one. The same command goes on with a run that was
    interrupted, and fits what is new or has changed. Each x.png may have its x.toml. In names of
    files {stem} and {folder} stand for those of the target, as in --mask 'masks/{stem}.png'.

    Without TARGETs, --table and --report are written from the journal. The exit status is 0 if all
    frames converged, 3 if some did not, and 1 if some failed.
    """
    from godfit.studies.batch.engine import Engine
    from godfit.studies.batch.jobs import jobs_of
    from godfit.studies.batch.run import Settings, exit_status, opened_journal
    from godfit.studies.batch.table import check_name, write_table

    merge, clips, retry, pictures, table, report = (
        given.pop(name)
        for name in ("merge", "clips", "retry_failed", "pictures", "table", "report")
    )
    assert run.output is not None
    place = None if shard is None else shard_place(shard)
    if table is not None:
        check_name(table)
    if not targets and not table and not report:
        raise click.UsageError("expected TARGETs, --table or --report, got none of them")
    if merge and (workers or scheduler or shard):
        raise click.UsageError("--merge: expected no --workers, --scheduler or --shard with it")
    jobs = jobs_of(targets, given, clips, place) if targets and not merge else []
    name = "journal.sqlite" if place is None else f"journal-{place[0]}-of-{place[1]}.sqlite"
    with opened_journal(run.output, name) as journal:
        if merge:
            merge_runs(journal, targets)
        # A frame that failed and has changed since is planned when it is fitted: until then the
        # journal has it among those that failed.
        journal.plan([] if retry else [(job.path, job.key) for job in jobs], place)
        if jobs:
            settings = Settings(run.output, retry, pictures, command_line(), run.html)
            engine = Engine(workers, scheduler, own_process=True)
            fit_all(jobs, journal, engine, settings, run)
        counts = journal.counts()
        written = [journal.path]
        if table is not None:
            write_table(table, journal.rows())
            written.append(table)
        if report:
            from godfit.studies.batch.report import write_report

            written.append(write_report(run.output, journal))
        print_summary(journal, counts, written, run)
    return exit_status(counts)


def shard_place(text: str) -> tuple[int, int]:
    """``I/N`` as (I, N), or the place of this task in Slurm's array."""
    if text == SLURM:
        return slurm_place(os.environ)
    match = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", text)
    number, count = map(int, match.groups()) if match else (0, 0)
    if not 1 <= number <= count:
        raise click.UsageError(
            f"--shard: expected I/N with I from 1 to N, or {SLURM}, got '{text}'"
        )
    return number, count


def slurm_place(environment: Any) -> tuple[int, int]:
    """The place of this task among those of Slurm's array, whose numbers may begin anywhere."""
    names = ("ID", "COUNT", "MIN", "MAX")
    found = [environment.get(f"SLURM_ARRAY_TASK_{name}", "") for name in names]
    if not all(text.isdecimal() for text in found[:2]):
        raise click.UsageError(
            f"--shard {SLURM}: expected SLURM_ARRAY_TASK_ID and SLURM_ARRAY_TASK_COUNT in the "
            "environment, got none; give I/N"
        )
    number, count = int(found[0]), int(found[1])
    first, last = (int(text) if text.isdecimal() else None for text in found[2:])
    first = 1 if first is None else first
    step = 1 if last is None or count < 2 else (last - first) // (count - 1)
    place = (number - first) // max(step, 1) + 1
    if not 1 <= place <= count:
        raise click.UsageError(f"--shard {SLURM}: expected a task of {count}, got number {number}")
    return place, count


def merge_runs(journal: Journal, sources: Iterable[str]) -> None:
    """Add the journals of other runs, and of the shards in their folders."""
    from godfit.studies.batch.journal import Journal

    files = []
    for source in sources:
        found = sorted(glob.glob(os.path.join(glob.escape(source), "journal*.sqlite")))
        if os.path.isdir(source) and not found:
            raise click.UsageError(f"--merge: expected the folder of a run, got '{source}'")
        files += found if os.path.isdir(source) else [source]
    for file in files:
        if not (os.path.exists(file) and os.path.samefile(file, journal.path)):
            with Journal(file, writes=False) as other:
                journal.merge(other)
    missing = journal.missing_shards()
    if missing:
        warn(f"shards {', '.join(map(str, missing))} are missing: the run is not whole")


def fit_all(
    jobs: list[Any], journal: Journal, engine: Engine, settings: Settings, run: Run
) -> None:
    """Fit what is to do, with progress and the frames that failed on stderr."""
    from godfit.studies.batch.engine import WITHOUT_DASK, has_dask
    from godfit.studies.batch.run import run_jobs, to_do

    left = len(to_do(jobs, journal, settings))
    if engine.workers is None and not has_dask() and left > 1 and not run.quiet:
        warn(f"one process fits: more of them {WITHOUT_DASK}")
    alone = engine.scheduler is None and (engine.workers == 1 or not has_dask())
    with (
        BatchProgress(len(jobs), left, run.quiet) as progress,
        reported(progress, journal),
        one_core() if left and alone else nullcontext(),
    ):
        for frame in run_jobs(jobs, journal, engine, settings):
            progress.add(frame)
            if frame.error and not run.quiet and progress.failed <= SHOWN_FAILURES:
                warn(f"{frame.path}: {frame.status}: {frame.error}")


@contextmanager
def reported(progress: BatchProgress, journal: Journal) -> Iterator[None]:
    """An interrupt inside says how far the run has come."""

    def state() -> str:
        count = f"{progress.fitted} of {progress.total} frames"
        return f"{count} are in '{journal.path}'; the same command goes on"

    report_on_interrupt(state)
    try:
        yield
    finally:
        report_on_interrupt(None)


@contextmanager
def one_core() -> Iterator[None]:
    """This process fits inside: it has one core, as workers have, so that results are the same."""
    from godfit.runtime.one_core import OneCore

    core = OneCore()
    try:
        start_jax()
        yield
    finally:
        core.release()


def print_summary(journal: Journal, counts: dict[str, int], written: list[str], run: Run) -> None:
    """The numbers of frames by status, and the files, or JSON of both."""
    total = sum(counts.values())
    if run.as_json:
        failed = sorted(journal.failed_paths())
        record = {"frames": total, **counts, "failures": failed, "files": written}
        click.echo(json.dumps(record, indent=1, ensure_ascii=False))
        return
    parts = [f"{count} {status}" for status, count in counts.items() if count]
    click.echo(f"  {total} frames: {', '.join(parts) or 'none'}")
    click.echo(f"\n  {', '.join(written)}")

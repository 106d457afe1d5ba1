"""``godfit rerun``: the same fits with this version, and what changed."""

from __future__ import annotations

import json
import math
import os
import shlex
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from godfit.commands.batch import one_core
from godfit.commands.fit import fit
from godfit.commands.lights import lights_given
from godfit.commands.options import JSON, QUIET, VERBOSE, Command, Run, with_run
from godfit.commands.progress import Progress, warn
from godfit.errors import InputError

if TYPE_CHECKING:
    from godfit.studies.batch.jobs import Job
    from godfit.studies.batch.rerun import Rerun

CHANGED = 3
"""Exit status where something changed by more than the tolerance."""
TOLERANCE = 0.1
"""Quoted errors that count as no change: a tenth of an error changes no conclusion."""
NAMED = 10
"""Frames of a run that are named, those that changed most."""


@click.command(cls=Command)
@click.argument("source", metavar="FIT.JSON|RUN")
@click.option(
    "--tolerance",
    type=click.FloatRange(0),
    default=TOLERANCE,
    help="Changes in quoted errors that count as none. [default: 0.1]",
)
@click.option("--workers", type=click.IntRange(1), help="Processes. [default: one a core]")
@with_run(JSON, QUIET, VERBOSE)
def rerun(source: str, tolerance: float, workers: int | None, run: Run) -> int:
    """Fit the inputs of FIT.JSON, or of all frames of the folder RUN, again with this version.

    The hashes of the inputs are checked, and the change of every number is printed in quoted
    errors. Names of files are relative to the folder in which the fit was run. The exit status is 0
    if nothing changed by more than the tolerance, and 3 if something did.
    """
    from godfit.studies.batch.engine import Engine, has_dask
    from godfit.studies.batch.rerun import rerun

    fits = recorded_fits(source)
    workers = workers or (1 if len(fits) == 1 or not has_dask() else None)
    engine = Engine(workers, own_process=True)
    found = []
    with Progress(run.quiet, run.verbose) as progress:
        progress("fitting again")
        if workers == 1:
            with one_core():
                found.extend(rerun(fits, engine))
        else:
            for count, one in enumerate(rerun(fits, engine), 1):
                found.append(one)
                progress(f"{count} of {len(fits)} fits")
    place = {job.path: i for i, (job, _) in enumerate(fits)}
    found.sort(key=lambda one: place[one.path])
    if not run.quiet:
        for one in found:
            for note in (*one.notes, *filter(None, [one.after.error])):
                warn(f"{one.path}: {note}")
    if run.as_json:
        click.echo(json.dumps([_record(one) for one in found], indent=1, ensure_ascii=False))
    elif len(found) == 1:
        click.echo(_table(found[0], tolerance))
    else:
        click.echo(_summary(found, tolerance))
    if any(one.after.record is None for one in found):
        return 1
    return CHANGED if any(one.largest > tolerance for one in found) else 0


def recorded_fits(source: str) -> list[tuple[Job, Mapping[str, Any]]]:
    """The jobs and records of a fit.json, or of a run's folder or journal."""
    from godfit.report.record import read_record
    from godfit.studies.batch.journal import NAME, Journal
    from godfit.studies.batch.rerun import recorded_job

    journal = os.path.join(source, NAME) if os.path.isdir(source) else source
    fit_json = os.path.join(source, "fit.json")
    if os.path.isdir(source) and not os.path.exists(journal) and os.path.exists(fit_json):
        source = fit_json
    elif os.path.isdir(source) or source.endswith(".sqlite"):
        with Journal(journal, writes=False) as run:
            rows = [(row.path, row.outcome.record) for row in run.rows() if row.outcome]
        if not any(record for _, record in rows):
            raise InputError(f"'{journal}': expected a run with fits, got none")
        return [(recorded_job(path, record), record) for path, record in rows if record]
    record = read_record(source)
    if "options" in record:
        return [(recorded_job(source, record), record)]
    return [(_job_of_command(source, record), record)]


def _job_of_command(source: str, record: Mapping[str, Any]) -> Job:
    """The job of a fit whose record has its command line."""
    from godfit.studies.batch.jobs import job_for

    try:
        name, command, *arguments = shlex.split(record.get("command", ""))
    except ValueError:
        name, command, arguments = "", "", []
    if (name, command) != ("godfit", "fit"):
        raise InputError(
            f"'{source}': expected a fit of `godfit fit` or `godfit batch`, got one that does not "
            "say how it was made"
        )
    with fit.make_context("fit", arguments) as context:
        given = dict(context.params)
    targets = given.pop("target")
    lights = lights_given(given.pop("light"), given.pop("light_px"), given.pop("light_origin"))
    for other in ("output", "as_json", "quiet", "verbose", "html", "profile", "posterior"):
        given.pop(other, None)
    if "size" in record and lights.places:
        starts = lights.starts(tuple(record["size"][::-1]))
        given["start"] = {**given["start"], **starts}
        given["lights"] = given["lights"] or len(lights.places)
    job = job_for(targets, given)
    if job.error:
        raise InputError(job.error)
    return job._replace(path=source)


def _table(one: Rerun, tolerance: float) -> str:
    lines = [f"  {'':<16} {'before':>14} {'now':>14}   change in quoted errors"]
    for change in one.changes:
        marked = "  *" if change.errors > tolerance else ""
        lines.append(
            f"  {change.name:<16} {_number(change.before):>14} {_number(change.after):>14}   "
            f"{_errors(change.errors)}{marked}"
        )
    return "\n".join([*lines, "", f"  {_verdict(one, tolerance)}"])


def _verdict(one: Rerun, tolerance: float) -> str:
    before = "converged" if one.before["converged"] else "not converged"
    if one.after.status != before:
        return f"{before} before, {one.after.status} now"
    if one.largest <= tolerance:
        return f"no change above {tolerance:g} quoted errors; {before}, as before"
    return f"the largest change is {_errors(one.largest)} quoted errors; {before}, as before"


def _summary(found: list[Rerun], tolerance: float) -> str:
    names = dict.fromkeys(change.name for one in found for change in one.changes)
    lines = [f"  {'':<16} {'median':>10} {'largest':>10}   changes in quoted errors"]
    for name in names:
        sizes = sorted(c.errors for one in found for c in one.changes if c.name == name)
        lines.append(f"  {name:<16} {_errors(sizes[len(sizes) // 2]):>10} {_errors(sizes[-1]):>10}")
    changed = sorted((one for one in found if one.largest > tolerance), key=lambda o: -o.largest)
    lines += ["", f"  {len(changed)} of {len(found)} fits changed by more than {tolerance:g}"]
    lines += [f"  {one.path}: {_verdict(one, tolerance)}" for one in changed[:NAMED]]
    return "\n".join(lines)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.8g}"


def _errors(size: float) -> str:
    return "another" if math.isinf(size) else f"{size:.3f}"


def _record(one: Rerun) -> dict[str, Any]:
    record = one.after.record
    return {
        "path": one.path,
        "converged": [one.before["converged"], bool(record and record["converged"])],
        "error": one.after.error,
        "changes": {
            c.name: {
                "before": c.before,
                "after": c.after,
                "errors": None if math.isinf(c.errors) else c.errors,
            }
            for c in one.changes
        },
        "notes": list(one.notes),
    }

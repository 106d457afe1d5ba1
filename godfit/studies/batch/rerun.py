"""Fits made again with this version: what changed, in quoted errors."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from godfit.errors import InputError
from godfit.io.regular_files import read_regular
from godfit.studies.batch.engine import Engine, outcomes
from godfit.studies.batch.jobs import Job
from godfit.studies.batch.worker import Outcome, Task

EQUAL = 1e-6
"""Relative difference up to which two numbers without errors are equal: that of float32."""


class Change(NamedTuple):
    """A number of a fit ``before`` and ``after``, and the difference in quoted errors: infinite
    where there is no error to quote and the numbers differ, and where one fit lacks it."""

    name: str
    before: float | None
    after: float | None
    errors: float


class Rerun(NamedTuple):
    """A fit that was made again: its ``path``, what it was (``before``) and is (``after``), the
    ``changes`` of its numbers, and ``notes`` on inputs that are no longer those of the fit."""

    path: str
    before: Mapping[str, Any]
    after: Outcome
    changes: tuple[Change, ...]
    notes: tuple[str, ...]

    @property
    def largest(self) -> float:
        """The largest change in quoted errors; infinite where the verdict is another one."""
        record = self.after.record
        if record is None or record["converged"] != self.before["converged"]:
            return math.inf
        return max((change.errors for change in self.changes), default=0.0)


def recorded_job(path: str, record: Mapping[str, Any]) -> Job:
    """The job of a batch's record, by the options in it. Raises InputError where it has none."""
    options = dict(record.get("options", {}))
    targets = tuple(options.pop("targets", ()))
    if not targets:
        raise InputError(
            f"'{path}': expected a fit of `godfit fit` or `godfit batch`, got one that does not "
            "say how it was made"
        )
    return Job(path, targets, options, path, str(record.get("size")))


def changed_inputs(path: str, record: Mapping[str, Any]) -> tuple[str, ...]:
    """A sentence for each input of a record whose file is another one now. Raises InputError for a
    file that is missing."""
    notes = []
    for role, entry in record.get("inputs", {}).items():
        file, digest = entry.get("path"), entry.get("sha256")
        if not file:
            continue
        if not os.path.isfile(file):
            raise InputError(
                f"{role}: expected '{file}', as '{path}' has it, got no such file here; run this "
                "where the fit was run"
            )
        now = hashlib.sha256(read_regular(file, "an image or a scene")).hexdigest()
        if digest and now != digest:
            notes.append(f"{role}: '{file}' has changed since the fit was made")
    return tuple(notes)


def rerun(fits: Sequence[tuple[Job, Mapping[str, Any]]], engine: Engine) -> Iterator[Rerun]:
    """Fit every job again, and compare the result with its record; each comes as it ends."""
    befores = {job.key: record for job, record in fits}
    notes = {job.key: changed_inputs(job.path, record) for job, record in fits}

    def task_of(job: Job) -> Task:
        return Task(job.targets, job.options, os.getcwd())

    for job, outcome in outcomes([job for job, _ in fits], task_of, engine):
        before = befores[job.key]
        found = () if outcome.record is None else changes(before, outcome.record)
        yield Rerun(job.path, before, outcome, found, notes[job.key])


def changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> tuple[Change, ...]:
    """The numbers of two records, those of clips' frames among them, with their differences."""
    old, new = _numbers(before), _numbers(after)
    return tuple(
        Change(
            name,
            old.get(name, {}).get("value"),
            new.get(name, {}).get("value"),
            _difference(old.get(name), new.get(name)),
        )
        for name in dict.fromkeys((*old, *new))
    )


def _numbers(record: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    found = {**record["params"], **record.get("combined", {})}
    for frame in record.get("frames", ()):
        found |= {f"{name} of {frame['path']}": frame[name] for name in ("light_x", "light_y")}
    return found


def _difference(old: Mapping[str, Any] | None, new: Mapping[str, Any] | None) -> float:
    """The difference of two estimates in the error that was quoted first."""
    if old is None or new is None:
        return math.inf
    a, b = old["value"], new["value"]
    if a is None or b is None:
        return 0.0 if a is b else math.inf
    error = old.get("stderr") or new.get("stderr")
    if error:
        return abs(b - a) / error
    return 0.0 if math.isclose(a, b, rel_tol=EQUAL, abs_tol=EQUAL) else math.inf

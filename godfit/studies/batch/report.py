"""The page of a run."""

from __future__ import annotations

import os
from collections.abc import Iterator

from godfit.report.batch_page import PageRow, page
from godfit.runtime.files import atomic_write
from godfit.studies.batch.journal import Journal, Row
from godfit.studies.batch.table import TO_DO

PAGE = "report.html"
"""The page's file in the folder of a run."""


def write_report(folder: str, journal: Journal) -> str:
    """Write the page of a run into its ``folder``, whole or not at all; returns its name."""
    path = os.path.join(folder, PAGE)
    rows = [line for row in journal.rows() for line in page_rows(row)]
    atomic_write(path, page(rows, os.path.basename(os.path.abspath(folder))))
    return path


def page_rows(row: Row) -> Iterator[PageRow]:
    """The lines of a frame on the page: one, or of a clip one for each of its frames."""
    outcome = row.outcome
    if outcome is None or outcome.record is None:
        status = TO_DO if outcome is None else outcome.status
        yield PageRow(row.path, status, {}, "" if outcome is None else outcome.error)
        return
    record, remark = outcome.record, []
    if not record["converged"]:
        remark.append(record["message"])
    remark += [warning["text"] for warning in record["warnings"]]
    text = "; ".join(remark)
    numbers = {**record["params"], **record.get("combined", {})}
    if "frames" not in record:
        yield PageRow(row.path, outcome.status, numbers, text, outcome.thumbnail)
        return
    for frame in record["frames"]:
        own = {**numbers, "light_x": frame["light_x"], "light_y": frame["light_y"]}
        said = "; ".join(filter(None, [frame["message"], text]))
        yield PageRow(frame["path"], outcome.status, own, said, outcome.thumbnail)

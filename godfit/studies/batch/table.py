"""The table of a run: a line for every frame, as CSV or Parquet.

It holds what the fits are, and neither times nor hosts. So it depends on the inputs alone, however
often the run was interrupted and wherever its frames were fitted.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from godfit.errors import InputError
from godfit.report.schema import column_types
from godfit.runtime.files import atomic_write
from godfit.studies.batch.journal import Row

FORMATS = (".csv", ".parquet")
"""Suffixes of tables."""
TO_DO = "to do"
"""Status of a frame that has not been fitted."""
FIRST = (
    "path", "frame", "status", "message", "error", "model", "shader", "samples", "width", "height",
)  # fmt: skip
"""Columns before those of the parameters."""
LAST = (
    "noise_levels", "rmse_levels", "psnr_db", "residual_correlation", "log_likelihood", "pixels",
    "pixels_clipped", "undetermined", "warnings", "key",
)  # fmt: skip
"""Columns after those of the parameters."""


def check_name(path: str) -> None:
    """Raise InputError, before the work, for a name under which no table can be written."""
    suffix, folder = Path(path).suffix.lower(), os.path.dirname(path) or "."
    if suffix not in FORMATS:
        raise InputError(f"--table: expected a name in .csv or .parquet, got '{path}'; rename it")
    if not os.path.isdir(folder) or not os.access(folder, os.W_OK):
        raise InputError(f"--table: expected a folder that can be written, got '{folder}'")
    if suffix == ".parquet":
        _parquet()


def write_table(path: str, rows: Iterable[Row]) -> int:
    """Write the table, whole or not at all; returns the number of its lines. Raises InputError for
    another suffix, and OSError."""
    check_name(path)
    lines = [line for row in rows for line in lines_of(row)]
    columns = columns_of(lines)
    write = _as_parquet if Path(path).suffix.lower() == ".parquet" else _as_csv
    atomic_write(path, write(lines, columns))
    return len(lines)


def columns_of(lines: Iterable[dict[str, Any]]) -> list[str]:
    """The columns of a table, those of the parameters in the order in which they first occur."""
    found: dict[str, None] = {}
    for line in lines:
        found |= dict.fromkeys(line)
    return [*FIRST, *(name for name in found if name not in (*FIRST, *LAST)), *LAST]


def lines_of(row: Row) -> Iterator[dict[str, Any]]:
    """The lines of a frame: one, or of a clip one for each of its frames, which share the shader's
    parameters. Values that there are none of are left out."""
    outcome = row.outcome
    line: dict[str, Any] = {
        "path": row.path,
        "status": TO_DO if outcome is None else outcome.status,
        "key": row.key,
    }
    if outcome is None or outcome.record is None:
        yield line | {"error": outcome.error if outcome else ""}
        return
    record = outcome.record
    line |= {name: record.get(name) for name in (*FIRST, *LAST) if name in record}
    for name, entry in (record["params"] | record.get("combined", {})).items():
        line |= _numbers(name, entry)
    if "size" in record:
        line["width"], line["height"] = record["size"]
    line["warnings"] = ";".join(warning["code"] for warning in record["warnings"])
    line["undetermined"] = ";".join(record["undetermined"])
    for frame in record.get("frames", [None]):
        if frame is None:
            yield line
            continue
        # The light that a clip's parameters have is its first frame's.
        own = {"frame": frame["path"], "message": frame["message"] or record["message"]}
        own |= _numbers("light_x", frame["light_x"]) | _numbers("light_y", frame["light_y"])
        yield line | own


def _numbers(name: str, entry: dict[str, Any]) -> dict[str, Any]:
    return {
        name: entry["value"],
        f"{name}_stderr": entry["stderr"],
        f"{name}_fixed": entry.get("fixed", False),
        f"{name}_at_bound": entry.get("at_bound", False),
    }


def _as_csv(lines: list[dict[str, Any]], columns: list[str]) -> bytes:
    """UTF-8, a line of names first; numbers with all their digits, nothing for what is missing."""
    out = io.StringIO(newline="")
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    for line in lines:
        writer.writerow([_text(line.get(column)) for column in columns])
    return out.getvalue().encode(errors="backslashreplace")


def _text(value: Any) -> str:
    if value is None:
        return ""
    return {True: "true", False: "false"}[value] if isinstance(value, bool) else str(value)


def _as_parquet(lines: list[dict[str, Any]], columns: list[str]) -> bytes:
    arrow, parquet = _parquet()
    kinds = {
        "string": arrow.string(),
        "integer": arrow.int64(),
        "number": arrow.float64(),
        "boolean": arrow.bool_(),
    }
    types = column_types(columns)
    arrays = []
    for column in columns:
        values = [line.get(column) for line in lines]
        if types[column] == "string":
            # As in CSV, where an empty text and none are one.
            values = [value or "" for value in values]
        arrays.append(arrow.array(values, kinds[types[column]]))
    out = io.BytesIO()
    parquet.write_table(arrow.table(dict(zip(columns, arrays, strict=True))), out)
    return out.getvalue()


def _parquet() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(
            "--table: .parquet needs the package pyarrow; pip install 'godfit[parquet]', or give a "
            ".csv"
        ) from error
    return pyarrow, pyarrow.parquet

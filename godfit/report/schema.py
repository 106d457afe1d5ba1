"""JSON Schemas (draft 2020-12) of fit.json and of a batch's table: the files beside this one."""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any


@functools.cache
def schema(name: str) -> dict[str, Any]:
    """The schema "fit" or "table"."""
    return json.loads(Path(__file__).with_name(f"{name}.schema.json").read_text(encoding="utf-8"))


def column_types(columns: Iterable[str]) -> dict[str, str]:
    """The type of each column of a table, as JSON Schema names it: "string", "integer", "number" or
    "boolean"."""
    return {column: _type(column) for column in columns}


def _type(column: str) -> str:
    table = schema("table")
    entry = table["properties"].get(column)
    if entry is None:
        patterns = table["patternProperties"].items()
        found = (entry for pattern, entry in patterns if re.search(pattern, column))
        entry = next(found, table["additionalProperties"])
    kind = entry["type"]
    return kind if isinstance(kind, str) else kind[0]

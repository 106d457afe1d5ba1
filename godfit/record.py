"""What fit.json says, read again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from godfit.errors import InputError


def read_params(path: str) -> dict[str, Any]:
    """Shader, samples and parameters of a fit.json."""
    try:
        record = json.loads(Path(path).read_text(encoding="utf-8"))
        given = ("model", "shader", "samples", "rays", "phase", "fov", "distance")
        return {
            **{key: record[key] for key in given if key in record},
            **{name: entry["value"] for name, entry in record["params"].items()},
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"'{path}': expected a fit.json, got {type(error).__name__}: {error}"
        ) from error

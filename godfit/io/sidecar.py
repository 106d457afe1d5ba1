"""``x.toml`` beside ``x.png``: the mask, scene or canvas, shader and samples that belong to a
target."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from godfit.errors import InputError

FILES = ("mask", "scene", "canvas", "background")
SCATTERING: dict[str, type | tuple[type, ...]] = {
    "shader": str,
    "samples": int,
    "lights": int,
    "pass_scale": (int, float),
    "transfer": str,
    "model": str,
    "rays": int,
}


def read_sidecar(target: str) -> dict[str, Any]:
    """What stands in the file beside ``target``, paths made relative to it; empty without one.

    Raises InputError naming the file, the key, what was expected and what was got.
    """
    path = Path(target).with_suffix(".toml")
    if not path.is_file():
        return {}
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: expected TOML, got {error}; mend or remove the file") from error
    scattering = data.pop("scattering", {})
    if not isinstance(scattering, dict):
        raise InputError(f"{path}: scattering: expected a table, got {scattering!r}")
    found: dict[str, Any] = {}
    for key, value in data.items():
        _check(path, key, value, dict.fromkeys(FILES, str))
        found[key] = str(path.parent / value)
    for key, value in scattering.items():
        _check(
            path, f"scattering.{key}", value, {f"scattering.{k}": t for k, t in SCATTERING.items()}
        )
        found[key] = value
    return found


def _check(path: Path, key: str, value: Any, known: dict[str, Any]) -> None:
    if key not in known:
        raise InputError(f"{path}: {key}: expected one of {', '.join(known)}; remove the key")
    kinds = known[key] if isinstance(known[key], tuple) else (known[key],)
    if not isinstance(value, kinds) or isinstance(value, bool):
        names = " or ".join(kind.__name__ for kind in kinds)
        raise InputError(f"{path}: {key}: expected {names}, got {value!r}")

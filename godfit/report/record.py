"""fit.json: a fit as a record, and the model and images that a record names."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import platform
from collections.abc import Iterable
from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np

from godfit.errors import InputError, Remark, shown
from godfit.io.filters import shrink
from godfit.io.image import read_image
from godfit.io.regular_files import MAX_TEXT_BYTES, read_regular
from godfit.models.build import mitchell_at
from godfit.models.mitchell import Mitchell
from godfit.scattering.conventions import convention
from godfit.scattering.conventions.shader_file import from_definition
from godfit.scenes.scene import read_scene
from godfit.scenes.view import drawn_mask, resized

if TYPE_CHECKING:
    from godfit.inference.estimates import Estimate
    from godfit.report.result import FitResult

SCHEMA = 2
"""Version of fit.json's layout: it grows with every change that breaks readers. Since 2, warnings
and notes are objects; both layouts are read."""
MODEL_SETTINGS = (
    "model", "shader", "shader_definition", "samples", "rays", "phase", "fov", "distance",
    "pass_scale", "border",
)  # fmt: skip
"""Keys of fit.json that describe the model and its light pass and are not fitted."""


_NUMBER = {"type": "number", "minimum": -1e18, "maximum": 1e18}
_SIDES = {
    "type": "array",
    "items": {"type": "integer", "minimum": 1, "maximum": 2**20},
    "minItems": 2,
    "maxItems": 2,
}
_TEXT = {"type": "string", "maxLength": 4096}
FIT_SCHEMA: dict[str, Any] = {
    "type": "object",
    "required": ["params"],
    "properties": {
        "params": {
            "type": "object",
            "additionalProperties": {
                "type": "object",
                "required": ["value"],
                "properties": {"value": _NUMBER},
            },
        },
        "inputs": {
            "type": "object",
            "additionalProperties": {
                "type": "object",
                "properties": {"path": _TEXT, "sha256": _TEXT},
            },
        },
        **dict.fromkeys(("model", "shader", "phase", "transfer", "border"), _TEXT),
        **{key: {"type": "integer", "minimum": 1, "maximum": 10**6} for key in ("samples", "rays")},
        "shader_definition": {"type": "object", "maxProperties": 64},
        **dict.fromkeys(("fov", "distance"), _NUMBER),
        **dict.fromkeys(("size", "pass_size", "mask_size"), _SIDES),
    },
}
"""What is read from a fit.json, as JSON Schema (draft 2020-12)."""


def fit_record(result: FitResult, command: str = "") -> dict[str, Any]:
    """The contents of fit.json; numbers that are not finite become null."""
    model = result.model
    return {
        "schema": SCHEMA,
        "converged": result.converged,
        "message": result.message,
        "model": model.name,
        **model.settings,
        "params": {name: estimate(e) for name, e in result.params.items()},
        "combined": {name: estimate(e) for name, e in result.combined.items()},
        "correlations": {pair: round(value, 6) for pair, value in result.correlations.items()},
        "undetermined": list(result.undetermined),
        "warnings": remarks(result.warnings, "warning"),
        "notes": remarks(result.notes, "note"),
        "noise_levels": _finite(result.noise_levels),
        "rmse_levels": _finite(result.rmse_levels),
        "psnr_db": _finite(result.psnr_db),
        "residual_correlation": _finite(result.residual_correlation),
        "residual_tails": _finite(result.residual_tails),
        "log_likelihood": _finite(result.log_likelihood),
        "size": list(result.picture.size[::-1]),
        "pass_size": list(result.picture.pass_size(model)[::-1]),
        "mask_size": list(result.picture.mask.shape[1::-1]),
        "pass_scale": result.pass_scale,
        "transfer": result.picture.transfer,
        "arithmetic": result.picture.arithmetic,
        "prior": {n: {"value": v, "sigma": s} for n, (v, s) in result.prior.items()},
        "pixels": result.pixels,
        "pixels_effective": round(result.pixels_effective, 1),
        "starts_agreed": result.starts_agreed,
        "pixels_clipped": result.pixels_clipped,
        "timing_s": {k: round(v, 4) for k, v in result.timing_s.items()},
        "inputs": result.inputs,
        "versions": versions(),
        "command": command,
    }


def remarks(sentences: Iterable[str], code: str) -> list[dict[str, str | None]]:
    """Notes or warnings as fit.json has them; ``code`` is that of a sentence without one."""
    said = [s if isinstance(s, Remark) else Remark(s, code) for s in sentences]
    return [{"code": s.code, "text": str(s), "option": s.option} for s in said]


def estimate(e: Estimate) -> dict[str, Any]:
    """A parameter's entry in fit.json."""
    return {
        "value": _finite(e.value),
        "stderr": _finite(e.stderr),
        "fixed": e.fixed,
        "at_bound": e.at_bound,
        **({"interval95": list(e.interval)} if e.interval else {}),
        **({"posterior95": list(e.posterior)} if e.posterior else {}),
    }


def versions() -> dict[str, str]:
    """Versions of the program and of the packages that its numbers depend on."""
    names = ("godfit", "jax", "jaxlib", "equinox", "optimistix", "numpy")
    return {"python": platform.python_version()} | {n: metadata.version(n) for n in names}


@dataclasses.dataclass(frozen=True, eq=False)
class Recorded:
    """A model and its images, from a fit.json. ``mask`` (h, w) or (h, w, 3) is the occlusion that
    the light pass reads, at its own size; ``size`` is the picture's (rows, columns); ``notes`` name
    the inputs that have changed since."""

    model: Mitchell
    mask: np.ndarray
    background: np.ndarray | None
    size: tuple[int, int]
    transfer: str
    notes: tuple[str, ...]


def read_record(path: str) -> dict[str, Any]:
    """The whole of a fit.json. Raises InputError for anything else."""
    # Imported here: most commands read no record.
    from jsonschema import Draft202012Validator
    from jsonschema.exceptions import best_match

    def refuse(name: str) -> None:
        raise ValueError(f"{name} is no number of JSON")

    data = read_regular(path, "a fit.json", MAX_TEXT_BYTES)
    try:
        record = json.loads(data.decode(), parse_constant=refuse)
        error = best_match(Draft202012Validator(FIT_SCHEMA).iter_errors(record))
    except RecursionError:
        raise InputError(f"'{path}': expected a fit.json, got brackets nested too deeply") from None
    except ValueError as error:  # Not UTF-8, not JSON, or a number of thousands of digits.
        raise InputError(f"'{path}': expected a fit.json, got {error}") from error
    if error is not None:
        where = ".".join(map(str, error.absolute_path)) or "the whole"
        rule, value = error.validator, error.validator_value
        expected = f"{rule if rule != 'type' else 'the type'} {shown(value)}"
        raise InputError(
            f"'{path}': expected a fit.json; {where}: expected {expected}, "
            f"got {shown(error.instance)}"
        )
    return record


def read_params(path: str) -> dict[str, Any]:
    """Shader, samples, size of the light pass (``pass_size`` in rows and columns), whether it reads
    a mask of another size (``full_size``), and parameters of a fit.json."""
    record = read_record(path)
    low = _pair(record, "pass_size")
    settings = {key: record[key] for key in MODEL_SETTINGS if record.get(key) is not None}
    definition = settings.pop("shader_definition", None)
    if definition is not None:
        # A user's own shader comes with the fit: its file may have changed, or be elsewhere.
        settings["shader"] = convention(from_definition(definition, path)).key
    return {
        **({} if low is None else {"pass_size": low}),
        **({"full_size": True} if _pair(record, "mask_size") not in (None, low) else {}),
        **settings,
        **{name: entry["value"] for name, entry in record["params"].items()},
    }


def recorded(
    path: str,
    *,
    mask: str | None = None,
    scene: str | None = None,
    background: str | None = None,
) -> Recorded:
    """The fit in the file ``path``. Its images are those given, or those at the paths in it,
    relative to the working folder. Raises InputError where they cannot be found or do not fit."""
    record, settings, notes = read_record(path), read_params(path), []
    if settings.get("model", Mitchell.name) != Mitchell.name:
        raise InputError(f"'{path}': expected a fit of mitchell, got {settings['model']}")
    if mask is not None and scene is not None:
        raise InputError("simplify: expected --mask or --scene, got both")
    model = mitchell_at(settings, {}, [])
    transfer = record.get("transfer", "none")
    files = record.get("inputs", {})

    def found(role: str, given: str | None) -> str | None:
        if given is not None:
            return given
        old = files.get(role, {}).get("path") or None
        if old is not None and not os.path.isfile(old):
            raise InputError(
                f"{role}: expected '{old}', as '{path}' has it, got no such file here; "
                f"give --{role} or run this where the fit was run"
            )
        return old

    place = found("mask", mask) if scene is None else None
    stage = found("scene", scene) if place is None else None
    if place is not None:
        image = read_image(place)
        if mask is None and image.sha256 != files["mask"].get("sha256", image.sha256):
            notes.append(f"mask: '{place}' has changed since the fit was made")
        occlusion = image.values
    elif stage is not None:
        drawn = read_scene(stage)
        drawn = (
            resized(drawn, _pair(record, "pass_size") or drawn.size) if drawn.any_size else drawn
        )
        notes += [f"scene: {note}" for note in drawn.notes]
        occlusion = drawn_mask(drawn, drawn.antialias is not False)
    else:
        raise InputError(f"'{path}': expected the path of a mask in it, got none; give --mask")
    place = found("background", background)
    back = None if place is None else read_image(place, transfer=transfer).values
    default = occlusion.shape[:2] if back is None else back.shape[:2]
    size = _pair(record, "size") or (default[0], default[1])
    # What the light pass reads: a mask of its own size where nothing else is recorded.
    low = _pair(record, "mask_size") or _pair(record, "pass_size") or occlusion.shape[:2]
    if low[0] > occlusion.shape[0] or low[1] > occlusion.shape[1]:
        h, w = occlusion.shape[:2]
        raise InputError(
            f"mask: expected at least the pass's {low[1]}x{low[0]} pixels, got {w}x{h}"
        )
    if low != occlusion.shape[:2]:
        occlusion = shrink(occlusion, low)
    if back is not None and back.shape[:2] != size:
        h, w = back.shape[:2]
        raise InputError(f"background: expected {size[1]}x{size[0]} pixels, got {w}x{h}")
    return Recorded(model, occlusion, back, size, transfer, tuple(notes))


def _pair(record: dict[str, Any], key: str) -> tuple[int, int] | None:
    """``[columns, rows]`` -> (rows, columns)."""
    if key not in record:
        return None
    columns, rows = record[key]
    return rows, columns


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None

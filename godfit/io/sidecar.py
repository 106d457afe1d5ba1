"""``x.toml`` beside ``x.png``: a target's mask, scene or canvas, shader and samples."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from godfit.io.toml_table import Table

SIDECAR_FILES = ("mask", "scene", "canvas", "background")
"""Keys whose values are paths, relative to the file."""
SIDECAR_SCATTERING: dict[str, type] = {
    "shader": str,
    "samples": int,
    "lights": int,
    "pass_scale": float,
    "transfer": str,
    "arithmetic": str,
    "model": str,
    "rays": int,
}
"""Keys of [scattering] and the kinds of their values (``toml_table.VALUE_KINDS``)."""


def read_sidecar(target: str) -> dict[str, Any]:
    """The options in the file beside ``target``, paths made relative to it; none without a file.

    Raises InputError naming the file, the key, what was expected and what was got.
    """
    path = Path(target).with_suffix(".toml")
    if not os.path.isfile(path):
        return {}
    root = Table.read(path, "a file of options")
    options: dict[str, Any] = {}
    for key in SIDECAR_FILES:
        name = root.text(key)
        if name is not None:
            options[key] = str(path.parent / name)
    scattering = root.table("scattering", {})
    for key, kind in SIDECAR_SCATTERING.items():
        value = scattering.optional(key, kind)
        if value is not None:
            options[key] = value
    if "shader" in options:
        options["shader"] = shader_beside(path, options["shader"])
    root.finish()
    scattering.finish()
    return options


def shader_beside(path: Path, shader: str) -> str:
    """The shader that a file at ``path`` names: one in a file of its own lies beside that one."""
    return str(path.parent / shader) if shader.lower().endswith(".toml") else shader

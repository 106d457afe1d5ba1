"""``x.toml`` beside ``x.png``: a target's mask, scene or canvas, shader and samples."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from godfit.errors import InputError
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
FOREIGN = {
    "mitchell": ("canvas", "rays"),
    "hoffman-preetham": ("canvas", "rays", "shader", "lights"),
    "flatland": ("mask", "scene", "background", "shader", "samples", "lights", "pass_scale"),
}
"""Settings of the file beside a target that a model does not have."""
CLIP_OPTIONS = (
    "shader", "samples", "pass_scale", "transfer", "arithmetic", "fix", "start", "ignore", "mask",
    "scene", "background",
)  # fmt: skip
"""Options of ``godfit fit`` that frames take too."""
OF_ALL_FRAMES = ("shader", "samples", "pass_scale", "transfer", "arithmetic")
"""Settings that all frames share."""
OF_EACH_FRAME = ("mask", "scene", "background")
"""Options whose values may name a file for each frame."""


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


def options_beside(target: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """The options in the file beside ``target``, overridden by those that are ``given`` and not
    None. A mask or a scene that is given replaces the other one of the file."""
    options = read_sidecar(target) | {k: v for k, v in given.items() if v is not None}
    for one, other in (("mask", "scene"), ("scene", "mask")):
        if given.get(one) is not None and given.get(other) is None:
            options.pop(other, None)
    drop_foreign(options, given)
    return options


def drop_foreign(options: dict[str, Any], given: Mapping[str, Any]) -> None:
    """Drop the settings of the file beside the target that the model of the command line does not
    have, and the model of the file where options of another one were given."""
    if given.get("model") is None and any(given.get(n) is not None for n in ("shader", "lights")):
        options.pop("model", None)
    for name in FOREIGN.get(options.get("model", ""), ()):
        if given.get(name) is None:
            options.pop(name, None)


def keep_one_source(options: dict[str, Any], given: Mapping[str, Any]) -> None:
    """Keep either a canvas or a mask and scene: those given on the command line, or those that the
    model needs. At most one of them is given."""
    if "canvas" not in options:
        return
    instead = given.get("mask") is not None or given.get("scene") is not None
    alone = "mask" not in options and "scene" not in options
    if instead and given.get("model") is None:
        options.pop("model", None)
    plane = given.get("canvas") is not None or alone or options.get("model") == "flatland"
    unused = ("mask", "scene", "samples", "shader", "lights") if plane else ("canvas", "rays")
    for name in unused:
        if given.get(name) is None:
            options.pop(name, None)
    if plane and given.get("model") is None:
        options["model"] = "flatland"


def shared_settings(sidecars: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The settings that the files beside the frames agree on. Raises InputError where they do not:
    frames of a clip have one shader."""
    shared: dict[str, Any] = {}
    for target, settings in sidecars.items():
        for name in OF_ALL_FRAMES:
            value = settings.get(name)
            if value is not None and shared.setdefault(name, value) != value:
                raise InputError(
                    f"'{target}': expected {name} {shared[name]} as of the other frames, got "
                    f"{value}; give it as an option, or fit the frames one by one"
                )
    return shared


def sources_of(
    path: str, number: int, sidecar: Mapping[str, Any], files: Mapping[str, str]
) -> dict[str, str]:
    """Mask, scene and background of a frame: those of the options ``files``, as
    ``named_after`` has them, else those of the file beside it."""
    found = {name: sidecar[name] for name in OF_EACH_FRAME if name in sidecar}
    for one, other in (("mask", "scene"), ("scene", "mask")):
        if one in files:
            found.pop(other, None)
    return found | named_after(path, number, files)


def named_after(path: str, number: int, patterns: Mapping[str, str]) -> dict[str, str]:
    """The patterns with {stem} replaced by a frame's name without suffix, {folder} by its folder
    and {number} by its place."""
    file = Path(path.rsplit("#")[0])
    words = {"{stem}": file.stem, "{folder}": str(file.parent), "{number}": str(number)}
    found = dict(patterns)
    for name, text in found.items():
        for word, value in words.items():
            text = text.replace(word, value)
        found[name] = text
    return found

"""A shader's convention as a TOML file: the user's own, or a shipped one printed in its terms.

The keys are the fields of ``Convention``; those that are left out have its defaults.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from godfit.errors import shown
from godfit.io.toml_table import MAX_TOML_NUMBER, Table
from godfit.scattering.conventions.convention import SCATTERING_NAMES, Convention
from godfit.scattering.parameters import MAX_DENSITY

SHADER_SUFFIX = ".toml"
"""How the name of a shader's file ends."""
MOST_DROPPED = 1000
"""Most samples that a loop leaves out or adds: no published one does so with more than one."""
MOST_ORDER = 8
"""Largest offset of the exponent of decay: a published one is 0 or 1."""
MOST_TAPS = 100_000
"""Largest end of a loop: that of the number of samples."""
MOST_FITTED_DENSITY = 100.0
"""Largest density that a file may allow: ten times that of any published shader."""
BLENDS = ("add", "screen", "modulate", "towards")
PASSES = {"sun-beams": (), "godot4": ("radius", "gaussian"), "jmonkey": ("start",)}
"""Sums that are no sequence of taps, and the names of their further numbers."""
OPEN_ENDS = {"exposure": MAX_TOML_NUMBER, "decay": 1.0, "weight": MAX_TOML_NUMBER}
"""Largest values of the parameters that stand for absent ones, or are defaults."""


def read_shader(path: str | Path) -> Convention:
    """The convention that a file defines. Raises InputError, naming the file and the key, for a
    file that is missing, is not TOML, or has a key or a value that a convention cannot have."""
    table = Table.read(Path(path), "a file of a shader's convention")
    return _read(table, Path(path).stem)


def from_definition(data: dict[str, Any], where: str) -> Convention:
    """The convention of a ``definition``, as fit.json holds it in the file ``where``. Raises
    InputError as ``read_shader`` does."""
    return _read(Table(Path(where), "", data), "shader")


def _read(table: Table, stem: str) -> Convention:
    name = table.text("name") or stem
    passes = table.text("passes") or ""
    if passes and passes not in PASSES:
        raise table.error("passes", f"one of {', '.join(PASSES)}", shown(passes))
    blend: Any = table.text("blend") or "add"
    if blend not in BLENDS:
        raise table.error("blend", f"one of {', '.join(BLENDS)}", shown(blend))
    most_density = table.number("most_density", MAX_DENSITY, 0.0, MOST_FITTED_DENSITY)
    ends = OPEN_ENDS | {"density": most_density}
    options = table.table("pass_options", {})
    found = Convention(
        name,
        table.text("formula") or "",
        own=_not_negative(table, "own", 1.0),
        drop=table.whole("drop", -MOST_DROPPED, MOST_DROPPED, 0),
        order=table.whole("order", -MOST_ORDER, MOST_ORDER, 1),
        gain=table.number("gain", 1.0, 0.0),
        box=_shares(table, "box"),
        defaults=_parameters(table, "defaults", ends, samples=True),
        blend=blend,
        background_gain=_not_negative(table, "background_gain", 1.0),
        density_slider=_optional(table, "density_slider"),
        pass_scale=table.number("pass_scale", 1.0, 0.0, 1.0 + 1e-9),
        half_floats=_switch(table, "half_floats", False),
        remarks=table.text("remarks") or "",
        own_scaled=_switch(table, "own_scaled", True),
        averaged=_switch(table, "averaged", False),
        saturated=_switch(table, "saturated", False),
        step_drop=table.whole("step_drop", -MOST_DROPPED, 1, 0),
        lag=table.number("lag", 0.0, -1.0 - 1e-9, 1.0 + 1e-9),
        most_taps=_whole(table, "most_taps", 1, MOST_TAPS),
        absent=_parameters(table, "absent", ends),
        threshold=table.number("threshold", 0.0, -1e-9, 1.0),
        luma=_switch(table, "luma", False),
        power=table.number("power", 1.0, 0.0),
        blurs=_shares(table, "blurs"),
        blur_taps=table.whole("blur_taps", 2, MOST_TAPS, 6),
        passes=passes,
        pass_options={key: options.number(key, None, 0.0) for key in PASSES.get(passes, ())},
        names=_names(table),
        source=table.text("source") or "",
        most_density=most_density,
        family=table.text("family") or "",
        own_file=True,
    )
    options.finish()
    table.finish()
    if sum(map(bool, (found.box, found.blurs, found.passes))) > 1:
        raise table.error("box", "one of box, blurs and passes", "more than one; keep one")
    if "exposure" in found.absent:
        raise table.error("absent", "decay, density or weight in it", "exposure; leave it out")
    return found


def _not_negative(table: Table, key: str, default: float) -> float:
    value = table.number(key, default)
    if value < 0:
        raise table.error(key, "a number of 0 or more", f"{value:g}")
    return value


def _optional(table: Table, key: str) -> float | None:
    """A number above 0; None if the key is missing."""
    table.may_have(key)
    return table.number(key, above=0.0) if key in table.data else None


def _whole(table: Table, key: str, least: int, most: int) -> int | None:
    """A whole number; None if the key is missing."""
    table.may_have(key)
    return table.whole(key, least, most) if key in table.data else None


def _switch(table: Table, key: str, default: bool) -> bool:
    value = table.switch(key)
    return default if value is None else value


def _shares(table: Table, key: str) -> tuple[float, ...]:
    """Numbers above 0, any number of them; none if the key is missing."""
    value = table.get(key, [], "numbers above 0")
    good = isinstance(value, list) and all(
        isinstance(v, (int, float)) and not isinstance(v, bool) and 0 < v < MAX_TOML_NUMBER
        for v in value
    )
    if not good:
        raise table.error(key, "a list of numbers above 0", shown(value))
    return tuple(float(v) for v in value)


def _parameters(
    table: Table, key: str, ends: dict[str, float], samples: bool = False
) -> dict[str, float]:
    """The table [key] of parameters' values."""
    part, found = table.table(key, {}), {}
    for name in SCATTERING_NAMES:
        if name in part.data:
            found[name] = part.number(name, above=-1e-9, below=ends[name] * (1 + 1e-9))
    part.may_have(*SCATTERING_NAMES)
    if samples:
        count = _whole(part, "samples", 2, MOST_TAPS)
        found |= {} if count is None else {"samples": count}
    part.finish()
    return found


def _names(table: Table) -> dict[str, str]:
    """The table [names]: the engine's own names, by godfit's."""
    part = table.table("names", {})
    return {key: part.text(key) or key for key in part.data}


def shader_text(convention: Convention) -> str:
    """The convention as the text of such a file; reading it gives the same convention."""
    lines, tables = [], []
    for key, value in convention.definition().items():
        if isinstance(value, dict):
            tables += ["", f"[{key}]", *(f"{_key(k)} = {_toml(v)}" for k, v in value.items())]
        else:
            lines.append(f"{key} = {_toml(value)}")
    return "\n".join([*lines, *tables]) + "\n"


def _key(name: str) -> str:
    return name if name.replace("_", "").replace("-", "").isalnum() else _toml(name)


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        text = value.replace("\\", "\\\\").replace('"', '\\"')
        for character, escape in (("\n", "\\n"), ("\r", "\\r"), ("\t", "\\t")):
            text = text.replace(character, escape)
        return f'"{text}"'
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return repr(value)

"""``godfit fit`` with several frames of one clip."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from godfit.commands.options import look_away
from godfit.commands.study import (
    NOT_CONVERGED,
    command_line,
    concluded,
    folder_for,
    made_ready,
    working,
    written,
)

# What is fitted to a clip's frames needs these of the options.
TAKEN = ("shader", "samples", "pass_scale", "transfer")


def fit_frames(
    targets: tuple[str, ...],
    every: int,
    given: Mapping[str, Any],
    fixed: Mapping[str, float | None],
    started: Mapping[str, float],
    ignore: tuple[str, ...],
    output: str | None,
    *,
    as_json: bool,
    seed: int,
    quiet: bool,
    verbose: bool,
) -> int:
    """One shader for all ``targets``, a light for each; the rest as of one picture."""
    from godfit.io.frames import frames

    said = {name: value for name, value in given.items() if value not in (None, (), False)}
    for name in said:
        if name not in TAKEN:
            option = name.replace("_", "-")
            raise click.UsageError(f"--{option}: expected one picture with it, got several frames")
    folder = folder_for(name_of(targets), output)
    transfer = said.pop("transfer", "none")
    each = frames(targets, every, transfer)
    valid = None
    if ignore:
        size = next(iter(frames(targets, every))).values.shape[:2]
        valid = look_away(ignore, size)
    with working(quiet, verbose) as progress:
        from godfit.report.clip import as_json as record
        from godfit.report.clip import save
        from godfit.studies.clip import fit_clip

        made_ready(said, quiet, progress)
        result = fit_clip(
            each, valid=valid, fix=fixed, start=started, seed=seed, progress=progress, **said
        )
        progress("drawing")
        save(result, folder, command_line())
    concluded(
        [*result.notes, *result.undetermined, *result.warnings],
        record(result, command_line()),
        result.summary(),
        written(folder, "fit.json", "fit.png"),
        as_json=as_json,
        quiet=quiet,
    )
    return 0 if result.converged else NOT_CONVERGED


def name_of(targets: tuple[str, ...]) -> str:
    """The first frame's without its number: frame_01.png, frame_02.png are ``frame``."""
    if len(targets) == 1:
        return targets[0]
    stem = Path(targets[0]).stem.rstrip("0123456789_-. ")
    return str(Path(targets[0]).with_name(stem or "clip"))

"""``godfit fit`` with several frames of one clip."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from godfit.commands.options import Run, valid_pixels
from godfit.commands.study import (
    NOT_CONVERGED,
    command_line,
    folder_for,
    prepare,
    print_result,
    working,
    written,
)
from godfit.io.frames import frames

ACCEPTED = ("shader", "samples", "pass_scale", "transfer", "fix", "start", "ignore")
"""Options of ``godfit fit`` that frames take too."""


def fit_frames(targets: tuple[str, ...], every: int, given: Mapping[str, Any], run: Run) -> int:
    """Fit one shader to all ``targets`` and a light to each of them; returns the exit status."""
    options = {name: value for name, value in given.items() if value not in (None, (), False, {})}
    for name in options:
        if name not in ACCEPTED:
            option = name.replace("_", "-")
            raise click.UsageError(f"--{option}: expected one picture with it, got several frames")
    folder = folder_for(common_name(targets), run.output)
    images = frames(targets, every, options.pop("transfer", "none"))
    ignore, valid = options.pop("ignore", ()), None
    if ignore:
        valid = valid_pixels(ignore, next(iter(frames(targets, every))).values.shape[:2])
    with working(run) as progress:
        from godfit.studies.clip import fit_clip

        prepare(options, run, progress)
        result = fit_clip(images, valid=valid, seed=run.seed, progress=progress, **options)
        progress("drawing")
        result.save(folder, command_line())
    notes = [*result.notes, *result.undetermined, *result.warnings]
    print_result(result, notes, run, written(folder, "fit.json", "fit.png"))
    return 0 if result.converged else NOT_CONVERGED


def common_name(targets: tuple[str, ...]) -> str:
    """The first frame's name without its number: frame_01.png, frame_02.png are ``frame``."""
    if len(targets) == 1:
        return targets[0]
    stem = Path(targets[0]).stem.rstrip("0123456789_-. ")
    return str(Path(targets[0]).with_name(stem or "clip"))

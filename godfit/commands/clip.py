"""``godfit fit`` with several frames of one clip."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from godfit.commands.options import Run, valid_pixels
from godfit.commands.study import (
    NOT_CONVERGED,
    folder_for,
    prepare,
    print_result,
    save_result,
    working,
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
    folder = folder_for(targets, run.output)
    images = frames(targets, every, options.pop("transfer", "none"))
    ignore, valid = options.pop("ignore", ()), None
    if ignore:
        valid = valid_pixels(ignore, next(iter(frames(targets, every))).values.shape[:2])
    with working(run) as progress:
        from godfit.studies.clip import fit_clip

        prepare(options, run, progress)
        result = fit_clip(images, valid=valid, seed=run.seed, progress=progress, **options)
        progress("drawing")
        files = save_result(result, run, folder, ("fit.json", "fit.png"))
    notes = [*result.notes, *result.undetermined, *result.warnings]
    print_result(result, notes, run, files)
    return 0 if result.converged else NOT_CONVERGED

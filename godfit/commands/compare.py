"""``godfit compare``: several models fitted to one picture."""

from __future__ import annotations

from typing import Any

import click

from godfit.commands.lights import Lights, with_light
from godfit.commands.options import PICTURE, RESULT, Command, Run
from godfit.commands.study import (
    NOT_CONVERGED,
    opened,
    prepare,
    print_result,
    save_result,
    working,
)


@click.command(cls=Command)
@click.argument("target")
@PICTURE
@with_light("Position of the light. [default: the scene's]")
@RESULT
def compare(target: str, light: Lights, run: Run, **given: Any) -> int:
    """Compare Mitchell's sum with Hoffman and Preetham's daylight on TARGET.

    Each model is fitted with the light free and, if its position is given, with the light held
    there. With --canvas the light in the plane is fitted as well. The table goes to stdout,
    compare.json and compare.png to x.godfit/. The exit status is 3 if no model converged.
    """
    study = opened(target, given, run.output)
    place = light.one(study.image.values.shape)
    study.options.pop("model", None)
    with working(run) as progress:
        from godfit.studies.compare import compare

        prepare(study.options, run, progress, study.image.values.shape)
        found = compare(
            study.image, light=place, valid=study.valid, seed=run.seed, progress=progress,
            **study.options,
        )  # fmt: skip
        progress("drawing")
        files = save_result(found, run, study.folder, ("compare.json", "compare.png"))
    notes = [note for row in found.rows for note in row.result.notes]
    print_result(found, notes, run, files)
    return 0 if any(row.result.converged for row in found.rows) else NOT_CONVERGED

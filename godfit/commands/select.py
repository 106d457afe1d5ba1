"""``godfit select``: the smallest model that explains a picture."""

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
@with_light("Position of the light on rungs that hold it. [default: the scene's, or the middle]")
@RESULT
def select(target: str, light: Lights, run: Run, **given: Any) -> int:
    """Find the smallest model that explains TARGET, from a constant veil to two coloured lights.

    Rungs that do not fit the light hold it at --light. The table goes to stdout, select.json and
    select.png to x.godfit/. The exit status is 3 if no rung leaves only noise.
    """
    for name in ("canvas", "rays"):
        if given[name] is not None:
            raise click.UsageError(
                f"--{name}: expected none, got one; it is for light in the plane"
            )
    study = opened(target, given, run.output)
    place = light.one(study.image.values.shape)
    # The ladder begins with one light, however many the file beside the target has.
    for name in ("model", "canvas", "rays", "lights"):
        study.options.pop(name, None)
    with working(run) as progress:
        from godfit.studies.select import select

        prepare(study.options, run, progress, study.image.values.shape)
        found = select(
            study.image, light=place, valid=study.valid, seed=run.seed, progress=progress,
            **study.options,
        )  # fmt: skip
        progress("drawing")
        files = save_result(found, run, study.folder, ("select.json", "select.png"))
    print_result(found, found.base.notes, run, files)
    return 0 if found.recommended.like_noise else NOT_CONVERGED

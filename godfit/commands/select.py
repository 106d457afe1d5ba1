"""``godfit select``: how much of a model a picture needs."""

from __future__ import annotations

from typing import Any

import click

from godfit.commands.options import PICTURE, RESULT, pair
from godfit.commands.study import (
    NOT_CONVERGED,
    command_line,
    concluded,
    made_ready,
    opened,
    working,
    written,
)


@click.command()
@click.argument("target")
@PICTURE
@click.option(
    "--light",
    metavar="U,V",
    help="Where the light is before it is fitted. [default: the scene's, or the middle]",
)
@RESULT
def select(
    target: str,
    light: str | None,
    ignore: tuple[str, ...],
    output: str | None,
    as_json: bool,
    seed: int,
    quiet: bool,
    verbose: bool,
    **given: Any,
) -> int:
    """The smallest model that explains TARGET: from a constant veil to two coloured lights.

    Rungs whose light is not fitted have it at --light. The table goes to stdout, select.json and
    select.png to x.godfit/. Exit status 3 if no rung leaves only noise.
    """
    place = None if light is None else pair(light)
    study = opened(target, given, ignore, output)
    for name in ("model", "canvas", "rays"):
        study.options.pop(name, None)
    with working(quiet, verbose) as progress:
        from godfit.report import select as select_report
        from godfit.studies.select import select as climb

        made_ready(study.options, quiet, progress, study.image.values.shape)
        found = climb(
            study.image, light=place, valid=study.valid, seed=seed, progress=progress,
            **study.options,
        )  # fmt: skip
        progress("drawing")
        select_report.save(found, study.folder, command_line())
    concluded(
        found.base.notes,
        select_report.as_json(found, command_line()),
        found.summary(),
        written(study.folder, "select.json", "select.png"),
        as_json=as_json,
        quiet=quiet,
    )
    return 0 if found.recommended.like_noise else NOT_CONVERGED

"""``godfit compare``: which model a picture deserves."""

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
@click.option("--light", metavar="U,V", help="Where the light is. [default: the scene's]")
@RESULT
def compare(
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
    """Fit Mitchell's sum and Hoffman and Preetham's daylight to TARGET and say which it deserves.

    Each is fitted with the light where it is given, if it is, and with the light free; with
    --canvas the light in the plane as well. The table goes to stdout, compare.json and compare.png
    to x.godfit/. Exit status 3 if none converged.
    """
    place = None if light is None else pair(light)
    study = opened(target, given, ignore, output)
    study.options.pop("model", None)
    with working(quiet, verbose) as progress:
        from godfit.studies import compare as comparing

        made_ready(study.options, quiet, progress, study.image.values.shape)
        found = comparing.compare(
            study.image, light=place, valid=study.valid, seed=seed, progress=progress,
            **study.options,
        )  # fmt: skip
        progress("drawing")
        comparing.save(found, study.folder, command_line())
    concluded(
        [note for row in found.rows for note in row.result.notes],
        comparing.as_json(found, command_line()),
        found.summary(),
        written(study.folder, "compare.json", "compare.png"),
        as_json=as_json,
        quiet=quiet,
    )
    return 0 if any(row.result.converged for row in found.rows) else NOT_CONVERGED

"""``godfit export``: a fit's numbers for another engine."""

from __future__ import annotations

import os
from pathlib import Path

import click

from godfit.commands.options import LIMIT, QUIET, VERBOSE, Command, Run, with_run
from godfit.commands.study import working
from godfit.errors import InputError


@click.command(cls=Command)
@click.argument("fit", metavar="FIT.JSON", required=False)
@click.option("--to", required=True, metavar="NAME", help="The engine, or list for all of them.")
@click.option("--mask", help="The mask, where it is not where the fit had it.")
@click.option("--scene", help="The scene, where it is not where the fit had it.")
@click.option("--background", help="The ordinary pass, where it is not where the fit had it.")
@LIMIT
@with_run(
    click.option("-o", "--output", metavar="FILE", help="Write the code here. [default: stdout]"),
    QUIET,
    VERBOSE,
)
def export(
    fit: str | None,
    to: str,
    mask: str | None,
    scene: str | None,
    background: str | None,
    run: Run,
) -> int:
    """Print the parameters of FIT.JSON for another engine, as code under its own names.

    Inside Mitchell's family the numbers are algebra; the pixel's own value and the blend, which no
    algebra gives, are rendered both ways and said in levels. Engines with another sum are refitted
    with the light where it is, and refused where the picture would be no match. For an engine
    without the effect, --to glsl, godot, unity-hlsl, reshade-fx, obs, shadertoy, wgsl or tsl gives
    the fit's own shader in its language.
    """
    if to == "list":
        from godfit.report.engines.export import list_text

        click.echo(list_text())
        return 0
    if fit is None:
        raise click.UsageError("expected FIT.JSON, got none; `godfit export --to list` needs none")
    output = run.output
    if output is not None:
        check_output(output)
    with working(run) as progress:
        from godfit.runtime.files import atomic_write
        from godfit.studies.export import Files, export

        progress(f"export to {to}")
        found = export(fit, to, Files(mask, scene, background))
        if output is not None:
            atomic_write(output, found.text().encode())
    if output is None:
        click.echo(found.text(), nl=False)
    else:
        click.echo(f"{output}: {found.sentence()}")
    return 0


def check_output(name: str) -> None:
    """Raise InputError, before the work, for a name under which no file can be written."""
    path = Path(name)
    if path.is_dir() or not path.parent.is_dir():
        got = "a folder" if path.is_dir() else f"no folder '{path.parent}'"
        raise InputError(f"output: expected a file in a folder that exists, got {got}: '{name}'")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"output: '{path.parent}' cannot be written; choose another with -o")

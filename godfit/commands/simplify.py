"""``godfit simplify``: the fewest samples that show a fitted picture."""

from __future__ import annotations

from typing import Any

import click

from godfit.commands.options import JSON, QUIET, VERBOSE, Run, with_run
from godfit.commands.study import say, working


@click.command()
@click.argument("fit_json", metavar="FIT.JSON")
@click.option(
    "--tolerance",
    type=float,
    required=True,
    metavar="LEVELS",
    help="Largest error, in 8-bit levels.",
)
@click.option(
    "--by",
    type=click.Choice(["worst", "rms"]),
    default="worst",
    help="Error of the worst pixel, or in the mean square. [default: worst]",
)
@click.option("--mask", help="Occlusion mask. [default: that of the fit]")
@click.option("--scene", help="Scene file to draw the mask from.")
@click.option("--background", help="Ordinary pass. [default: that of the fit]")
@with_run(JSON, QUIET, VERBOSE)
def simplify(fit_json: str, tolerance: float, by: str, run: Run, **files: Any) -> int:
    """The fewest samples and the smallest light pass that show the picture of FIT.JSON.

    Decay, density and weight are rescaled to go with them. Every pixel is compared with the render
    at the fit's own samples; the result is printed, ready to paste into the shader.
    """
    with working(run) as progress:
        from godfit.report.record import recorded
        from godfit.studies.simplify import simplify

        fitted = recorded(fit_json, **files)
        found = simplify(
            fitted.model, fitted.mask, tolerance, background=fitted.background, size=fitted.size,
            transfer=fitted.transfer, by=by, progress=progress,
        )  # fmt: skip
    say(found, fitted.notes, run)
    return 0

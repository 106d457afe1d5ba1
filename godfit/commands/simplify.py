"""``godfit simplify``: the fewest samples that reproduce a fitted picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from godfit.commands.options import JSON, QUIET, VERBOSE, Command, Run, with_run
from godfit.commands.study import print_result, working


@click.command(cls=Command)
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
    help="Measure of the error: worst pixel, or root mean square. [default: worst]",
)
@click.option("--mask", help="Occlusion mask. [default: the fit's]")
@click.option("--scene", help="Scene file to draw the mask from.")
@click.option("--background", help="Ordinary pass. [default: the fit's]")
@click.option("--html", "page", metavar="FILE", help="Write a page that shows both pictures.")
@with_run(JSON, QUIET, VERBOSE)
def simplify(
    fit_json: str, tolerance: float, by: str, page: str | None, run: Run, **files: Any
) -> int:
    """Find the fewest samples and the smallest light pass that reproduce the picture of FIT.JSON.

    Decay, density and weight are rescaled to match. Every pixel is compared with the render at the
    fit's own samples. The printed result can be pasted into the shader.
    """
    with working(run) as progress:
        from godfit.report.record import recorded
        from godfit.studies.simplify import simplify

        fitted = recorded(fit_json, **files)
        found = simplify(
            fitted.model, fitted.mask, tolerance, background=fitted.background, size=fitted.size,
            transfer=fitted.transfer, by=by, progress=progress,
        )  # fmt: skip
        if page is not None:
            from godfit.report.files import page_writer
            from godfit.report.pages import simplify_page

            page_writer(lambda: simplify_page(found, fitted).html())(Path(page))
    print_result(found, fitted.notes, run)
    return 0

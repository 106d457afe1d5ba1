"""``godfit simplify``: the fewest samples that show a fitted picture."""

from __future__ import annotations

import click

from godfit.commands.study import command_line, concluded, working


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
    help="Of the worst pixel, or in the mean square. [default: worst]",
)
@click.option("--mask", help="Occlusion mask. [default: that of the fit]")
@click.option("--scene", help="Scene file to draw the mask from.")
@click.option("--background", help="Ordinary pass. [default: that of the fit]")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, and nothing else, to stdout.")
@click.option("-q", "--quiet", is_flag=True, help="No progress, no warnings.")
@click.option("-v", "--verbose", is_flag=True, help="A line for every trial.")
def simplify(
    fit_json: str,
    tolerance: float,
    by: str,
    mask: str | None,
    scene: str | None,
    background: str | None,
    as_json: bool,
    quiet: bool,
    verbose: bool,
) -> int:
    """The fewest samples and the smallest light pass that show the picture of FIT.JSON.

    Decay, density and weight are rescaled to go with them. Every pixel is compared with the render
    at the fit's own samples; the result is printed, ready to paste into the shader.
    """
    with working(quiet, verbose) as progress:
        from godfit.report.record import recorded
        from godfit.studies import simplify as simpler

        fitted = recorded(fit_json, mask=mask, scene=scene, background=background)
        found = simpler.simplify(
            fitted.model, fitted.mask, tolerance, background=fitted.background, size=fitted.size,
            transfer=fitted.transfer, by=by, progress=progress,
        )  # fmt: skip
    record = simpler.as_json(found, tolerance, by, command_line())
    concluded(fitted.notes, record, found.summary(), None, as_json=as_json, quiet=quiet)
    return 0

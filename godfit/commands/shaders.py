"""``godfit shaders``: a list of the known conventions."""

from __future__ import annotations

import click

from godfit.commands.options import Command


@click.command(cls=Command)
def shaders() -> int:
    """List the shader conventions with their formulas and defaults."""
    from godfit.scattering.taps import CONVENTIONS

    click.echo("M mask at the pixel, M_i at x - i Delta, Delta = (x - l) rho / n; B background")
    for shader in CONVENTIONS.values():
        defaults = ", ".join(f"{k} {v:g}" for k, v in shader.defaults.items()) or "none published"
        click.echo(f"\n{shader.name}\n  {shader.formula}\n  defaults: {defaults}")
        if shader.remarks:
            click.echo(f"  {shader.remarks}")
    return 0

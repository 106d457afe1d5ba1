"""``godfit shaders``: a list of the known conventions."""

from __future__ import annotations

import textwrap

import click

from godfit.commands.options import Command

LINE_WIDTH = 100
"""Columns of a line: those of the formulas, the longest of which needs nearly as many."""


@click.command(cls=Command)
def shaders() -> int:
    """List the shader conventions with their formulas and defaults."""
    from godfit.scattering.conventions import CONVENTIONS

    click.echo("M mask at the pixel, M_i at x - i Delta, Delta = (x - l) rho / n; B background")
    click.echo("u to the right, v up as in GLSL; a light whose v runs down: --light-origin top")
    for shader in CONVENTIONS.values():
        defaults = ", ".join(f"{k} {v:g}" for k, v in shader.defaults.items()) or "none published"
        click.echo(f"\n{shader.name}\n  {shader.formula}\n  defaults: {defaults}")
        for line in textwrap.wrap(shader.remarks, LINE_WIDTH - 2):
            click.echo(f"  {line}")
    return 0

"""``godfit shaders``: the known conventions, and one of them as a shader's file."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import click

from godfit.commands.options import Command

if TYPE_CHECKING:
    from godfit.scattering.conventions import Convention

LINE_WIDTH = 100
"""Columns of a line: those of the formulas, the longest of which needs nearly as many."""


@click.command(cls=Command)
@click.argument("name", required=False)
@click.option("--toml", "as_toml", is_flag=True, help="Print NAME as a file for --shader.")
def shaders(name: str | None, as_toml: bool) -> int:
    """List the shader conventions, family by family, or the one called NAME.

    Each has its formula, the file or effect that its numbers come from, its defaults, and its
    engine's own names of them. --toml prints NAME in the terms of a shader's own file.
    """
    from godfit.scattering.conventions import convention, families
    from godfit.scattering.conventions.shader_file import shader_text

    if name is None and as_toml:
        raise click.UsageError("--toml: expected NAME with it, got none; see `godfit shaders`")
    if name is not None:
        shader = convention(name)
        click.echo(shader_text(shader).rstrip() if as_toml else "\n".join(described(shader)))
        return 0
    click.echo("M mask at the pixel, M_i at x - i Delta, Delta = (x - l) rho / n; B background")
    click.echo("u to the right, v up as in GLSL; a light whose v runs down: --light-origin top")
    for family, members in families().items():
        click.echo(f"\n# {family}")
        for shader in members:
            click.echo("\n" + "\n".join(described(shader)))
    return 0


def described(shader: Convention) -> list[str]:
    """Lines about a convention: formula, source, defaults, names, remarks."""
    defaults = ", ".join(f"{k} {v:g}" for k, v in shader.defaults.items()) or "none published"
    own = ", ".join(f"{k}: {v}" for k, v in shader.names.items() if k != v)
    texts = [
        shader.formula,
        f"found in: {shader.source}" if shader.source else "",
        f"defaults: {defaults}",
        f"its own names: {own}" if own else "",
        shader.remarks,
    ]
    lines = [shader.name]
    for text in texts:
        lines += [f"  {line}" for line in textwrap.wrap(text, LINE_WIDTH - 2)]
    return lines

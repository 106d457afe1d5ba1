"""``godfit mask``: a scene's occlusion mask."""

from __future__ import annotations

import click

from godfit.commands.progress import Progress, warn


@click.command()
@click.argument("scene")
@click.option("-o", "--output", required=True, help="Image to write: .png or .npy (linear floats).")
@click.option(
    "--hard", is_flag=True, help="Pixel centres only, as WebGL draws without multisampling."
)
@click.option("-q", "--quiet", is_flag=True, help="No warnings.")
def mask(scene: str, output: str, hard: bool, quiet: bool) -> int:
    """Draw the occlusion mask of SCENE.toml, anti-aliased."""
    from godfit.image import write_image
    from godfit.inputs import drawn
    from godfit.scene import read_scene

    with Progress(quiet, False) as progress:
        progress("loading meshes")
        stage = read_scene(scene)
        progress("drawing")
        values = drawn(stage, not hard)
    write_image(output, values)
    if not quiet:
        for note in stage.notes:
            warn(note)
    return 0

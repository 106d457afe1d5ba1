"""``godfit mask``: a scene's occlusion mask, or the mask estimated from a finished picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from godfit.commands.options import (
    BRIGHT_PASS,
    LIMIT,
    QUIET,
    SHADER,
    Command,
    Run,
    check_image_name,
    image_size,
    with_run,
)
from godfit.commands.progress import Progress, warn
from godfit.commands.study import start_jax, working
from godfit.io.ignored import valid_pixels

if TYPE_CHECKING:
    import numpy as np


@click.command(cls=Command)
@click.argument("scene", required=False)
@click.option(
    "--from-image", "target", metavar="TARGET", help="Estimate the mask from this picture."
)
@click.option(
    "--hard", is_flag=True, help="No anti-aliasing, as WebGL draws without multisampling."
)
@click.option("--size", metavar="WxH", help="Size of a scene's mask. [default: the scene's own]")
@BRIGHT_PASS
@SHADER
@LIMIT
@click.option(
    "--ignore",
    multiple=True,
    metavar="X,Y,W,H|IMAGE",
    help="Pixels to leave out: a rectangle, or wherever an image is not black.",
)
@with_run(
    click.option(
        "-o", "--output", required=True, help="Image to write: .png or .npy (linear floats)."
    ),
    QUIET,
)
def mask(scene: str | None, target: str | None, hard: bool, run: Run, **options: Any) -> int:
    """Draw the occlusion mask of SCENE.toml, or estimate that of a finished picture.

    A glTF file with a camera and a light is a scene too. The mask of a scene is anti-aliased.
    With --from-image the mask is estimated from TARGET, as `godfit fit` does without a mask; edit
    it and give it to `godfit fit --mask`.
    """
    from godfit.io.image import write_image

    if (scene is None) == (target is None):
        got = "neither" if scene is None else "both"
        raise click.UsageError(f"expected SCENE.toml or --from-image TARGET, got {got}")
    assert run.output is not None
    check_image_name(run.output)
    if scene is not None:
        size = options.pop("size")
        values, notes = mask_of_scene(scene, hard, None if size is None else image_size(size))
    else:
        assert target is not None
        if options.pop("size") is not None:
            raise click.UsageError("--size: expected a scene with it, got a picture")
        values, notes = mask_of_picture(target, run, **options)
    write_image(run.output, values)
    if not run.quiet:
        for note in notes:
            warn(note)
    return 0


def mask_of_scene(
    scene: str, hard: bool, size: tuple[int, int] | None = None
) -> tuple[np.ndarray, tuple[str, ...]]:
    """(h, w) or (h, w, 3) the mask of a scene's file, and notes on the scene. ``size`` (h, w)
    replaces that of the file."""
    from godfit.scenes.scene import read_scene
    from godfit.scenes.view import drawn_mask, resized

    with Progress(quiet=False, verbose=False) as progress:
        start_jax()
        progress("loading meshes")
        stage = read_scene(scene)
        stage = stage if size is None else resized(stage, size)
        progress("drawing")
        return drawn_mask(stage, not hard), stage.notes


def mask_of_picture(
    target: str, run: Run, *, bright_pass: bool | None, ignore: tuple[str, ...], **options: Any
) -> tuple[np.ndarray, tuple[str, ...]]:
    """(h, w) or (h, w, 3) the mask that a fit of the picture estimates, and notes on the fit."""
    from godfit.io.image import read_image

    image = read_image(target)
    valid = valid_pixels(ignore, image.values.shape[:2])
    with working(run) as progress:
        from godfit.fitting import fit

        result = fit(
            image, bright_pass=bool(bright_pass), valid=valid, progress=progress, **options
        )
    objections = () if result.converged else (result.message,)
    return result.mask, (*result.notes, *result.warnings, *objections)

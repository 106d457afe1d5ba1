"""``godfit fit`` with several frames of one clip."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from godfit.commands.options import Run
from godfit.commands.study import (
    NOT_CONVERGED,
    folder_for,
    prepare,
    print_result,
    save_result,
    working,
)
from godfit.io.frames import frames, is_video
from godfit.io.ignored import valid_pixels
from godfit.io.sidecar import (
    CLIP_OPTIONS,
    OF_EACH_FRAME,
    read_sidecar,
    shared_settings,
    sources_of,
)


def fit_frames(targets: tuple[str, ...], every: int, given: Mapping[str, Any], run: Run) -> int:
    """Fit one shader to all ``targets`` and a light to each of them; returns the exit status."""
    options = {name: value for name, value in given.items() if value not in (None, (), False, {})}
    for name in options:
        if name not in CLIP_OPTIONS:
            option = name.replace("_", "-")
            raise click.UsageError(f"--{option}: expected one picture with it, got several frames")
    if "mask" in options and "scene" in options:
        raise click.UsageError("expected --mask or --scene, got both; a scene draws its own mask")
    folder = folder_for(targets, run.output)
    sidecars = {target: read_sidecar(target) for target in targets if not is_video(target)}
    options = shared_settings(sidecars) | options
    files = {name: options.pop(name) for name in OF_EACH_FRAME if name in options}
    images = frames(targets, every, options.pop("transfer", "none"))
    ignore, valid = options.pop("ignore", ()), None
    if ignore:
        valid = valid_pixels(ignore, next(iter(frames(targets, every))).values.shape[:2])
    with working(run) as progress:
        from godfit.studies.clip import Shot, fit_clip

        prepare(options, run, progress)
        shots = (
            Shot(image, **sources_of(image.path, number, sidecars.get(image.path, {}), files))
            for number, image in enumerate(images, 1)
        )
        result = fit_clip(shots, valid=valid, seed=run.seed, progress=progress, **options)
        progress("drawing")
        files = save_result(result, run, folder, ("fit.json", "fit.png"))
    notes = [*result.notes, *result.undetermined, *result.warnings]
    print_result(result, notes, run, files)
    return 0 if result.converged else NOT_CONVERGED

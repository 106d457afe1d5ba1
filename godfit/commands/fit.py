"""``godfit fit``: the parameters of one picture."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from godfit.commands import STARTED
from godfit.commands.clip import fit_frames
from godfit.commands.lights import Lights, near, with_light
from godfit.commands.options import BRIGHT_PASS, PICTURE, RESULT, Command, Run, assignments
from godfit.commands.study import (
    NOT_CONVERGED,
    opened,
    prepare,
    print_result,
    save_result,
    working,
)
from godfit.io.frames import is_video

if TYPE_CHECKING:
    from godfit.commands.progress import Progress
    from godfit.report.result import FitResult


@click.command(cls=Command)
@click.argument("target", nargs=-1, required=True)
@PICTURE
@click.option(
    "--occluder", help="Without a mask: an image that is not black where further objects are."
)
@BRIGHT_PASS
@click.option("--model", help="mitchell, hoffman-preetham or flatland. [default: mitchell]")
@click.option(
    "--free", multiple=True, metavar="NAME", help="Fit this quantity of the scene as well."
)
@click.option("--lights", type=int, help="Number of lights. [default: 1, or as many as --light]")
@with_light(
    "Start the search of a light here, as --start light_x and light_y do; repeat for several."
)
@click.option(
    "--light-near",
    metavar="U,V",
    callback=near,
    help="Without a mask: about where the light is, as by a click.",
)
@click.option(
    "--fix",
    multiple=True,
    metavar="NAME[=VALUE]",
    callback=assignments,
    help="Hold a parameter fixed.",
)
@click.option(
    "--start",
    multiple=True,
    metavar="NAME=VALUE",
    callback=assignments,
    help="Start the search of a parameter at a value.",
)
@click.option("--every", type=click.IntRange(1), help="Use every N-th frame of a clip.")
@click.option(
    "--profile",
    multiple=True,
    metavar="NAME",
    help="Add the 95% interval of the profile likelihood.",
)
@click.option(
    "--posterior", is_flag=True, help="Add 95% intervals of the posterior (needs blackjax)."
)
@RESULT
def fit(
    target: tuple[str, ...],
    every: int | None,
    profile: tuple[str, ...],
    posterior: bool,
    run: Run,
    **given: Any,
) -> int:
    """Fit exposure, decay, density, weight and the light's position to TARGET.

    If x.toml lies beside a TARGET x.png, mask or scene, shader and samples are taken from it.
    Options override them. The result goes to x.godfit/: fit.json, fit.png, render.png.

    Without a mask and a scene, TARGET is taken for a finished picture. Background, occluders,
    panels and the light's disc are then estimated and fitted together. With --bright-pass the light
    is everything bright in the picture, as in a photograph. Several TARGETs, or a video, are frames
    of one clip, with one shader for all frames and a light for each.

    With --scene the mask is drawn from meshes. --free light.position fits that position as well.
    Other names are light.radius, camera.position, object[0].position and object[0].rotation. With
    --canvas the sun, the sky and the exposure of light in the plane are fitted.
    """
    first, *more = target
    light: Lights = given.pop("light")
    if more or is_video(first):
        single = {"profile": profile, "posterior": posterior, light.option: light.places}
        return fit_frames(target, every or 1, given | single, run)
    if every is not None:
        raise click.UsageError("--every: expected several frames or a video with it, got a picture")
    study = opened(first, given, run.output, bare=True)
    keep_one_source(study.options, given)
    start_lights(study.options, light, study.image.values.shape)
    if (profile or posterior) and not {"mask", "scene", "canvas"} & study.options.keys():
        wanted = f"--profile {profile[0]}" if profile else "--posterior"
        raise click.UsageError(f"{wanted}: expected --mask, --scene or --canvas with it, got none")
    for name in study.options["free"] if "scene" not in study.options else ():
        raise click.UsageError(f"--free {name}: expected --scene SCENE.toml with it, got a mask")
    with working(run) as progress:
        from godfit.fitting import fit
        from godfit.studies.posterior import require

        if posterior:
            require()
        imported = time.perf_counter() - STARTED
        file = study.options.get("scene")
        prepare(study.options, run, progress, study.image.values.shape)
        result = fit(
            study.image, valid=study.valid, seed=run.seed, progress=progress, **study.options
        )
        result = with_intervals(result, profile, posterior, run.seed, progress)
        if file is not None:
            result.inputs["scene"] = {"path": file}
        result.timing_s["import"] = imported
        result.timing_s["total"] = time.perf_counter() - STARTED
        progress("drawing")
        names = ("fit.json", "fit.png", "render.png")
        names += ("mask.png",) if result.mask_estimated else ()
        files = save_result(result, run, study.folder, names)
    notes = [*result.notes, *result.undetermined, *result.warnings]
    print_result(result, notes, run, files)
    return 0 if result.converged else NOT_CONVERGED


def with_intervals(
    result: FitResult, names: tuple[str, ...], posterior: bool, seed: int, progress: Progress
) -> FitResult:
    """The result with profile intervals of ``names`` and, if ``posterior``, posterior intervals."""
    from godfit.studies import posterior as sampling
    from godfit.studies.profile_likelihood import check, profile

    for name in names:
        check(result, name)
    for name in names:
        progress(f"profile of {name}")
        result = profile(result, name)
    if posterior:
        progress("posterior")
        result = sampling.with_posterior(result, sampling.posterior(result, seed=seed))
    return result


def start_lights(options: dict[str, Any], light: Lights, size: tuple[int, ...]) -> None:
    """Add the positions of lights in a picture of ``size`` to the parameters that start at a value.
    Raises UsageError where another option gives them too, or gives too few lights."""
    if not light.places:
        return
    if "canvas" in options:
        raise click.UsageError(f"{light.flag}: expected --mask or --scene with it, got a canvas")
    if options["free"]:
        raise click.UsageError(
            f"{light.flag}: expected no --free with it; the scene has the light then"
        )
    starts, count = light.starts(size), len(light.places)
    for name in starts.keys() & options["start"].keys():
        raise click.UsageError(f"{light.flag}: expected no --start {name} with it; give either")
    if options.get("lights", count) < count:
        raise click.UsageError(
            f"{light.flag}: expected at most {options['lights']}, as --lights has it, got {count}"
        )
    options["lights"] = options.get("lights", count)
    options["start"] = options["start"] | starts


def keep_one_source(options: dict[str, Any], given: Mapping[str, Any]) -> None:
    """Keep either a canvas or a mask and scene: those given on the command line, or those that the
    model needs."""
    if "canvas" not in options:
        return
    instead = given["mask"] is not None or given["scene"] is not None
    if given["canvas"] is not None and instead:
        raise click.UsageError("expected --mask, --scene or --canvas, got two; give one")
    alone = "mask" not in options and "scene" not in options
    if instead and given["model"] is None:
        options.pop("model", None)
    plane = given["canvas"] is not None or alone or options.get("model") == "flatland"
    unused = ("mask", "scene", "samples", "shader", "lights") if plane else ("canvas", "rays")
    for name in unused:
        if given.get(name) is None:
            options.pop(name, None)
    if plane and given["model"] is None:
        options["model"] = "flatland"

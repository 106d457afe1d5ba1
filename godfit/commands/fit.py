"""``godfit fit``: the parameters of one picture."""

from __future__ import annotations

import hashlib
import time
from typing import TYPE_CHECKING, Any

import click

from godfit.commands import STARTED
from godfit.commands.clip import fit_frames
from godfit.commands.lights import Lights, near, with_light
from godfit.commands.options import (
    BRIGHT_PASS,
    PICTURE,
    RESULT,
    Command,
    Run,
    assignments,
    measurements,
)
from godfit.commands.study import (
    NOT_CONVERGED,
    opened,
    prepare,
    print_result,
    save_result,
    working,
)
from godfit.io.frames import is_video
from godfit.io.regular_files import read_regular
from godfit.io.sidecar import keep_one_source
from godfit.report.drawing import draw_ahead
from godfit.runtime.interrupts import INTERRUPTED, requested

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
@click.option("--flip", metavar="AXIS", help="Turn the target over: vertical, horizontal or both.")
@click.option("--border", help="Beyond the mask's edge: edge or black. [default: edge]")
@click.option("--tint", is_flag=True, default=None, help="Fit the light's colour as well.")
@click.option(
    "--register", is_flag=True, default=None, help="Fit shift and scale of the mask as well."
)
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
@click.option(
    "--prior",
    multiple=True,
    metavar="NAME=VALUE+-SIGMA",
    callback=measurements,
    help="What is known of a parameter beforehand: its value and standard deviation.",
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

    Without a mask and a scene, TARGET is taken for a finished picture. The light is searched under
    several hypotheses of the mask, and the best one is reported. With --bright-pass only that one
    is tried under which the light is bright in the picture, as in a photograph. Several TARGETs, or
    a video, are frames of one clip, with one shader for all frames and a light for each.

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
    if given["canvas"] is not None and (given["mask"] or given["scene"]) is not None:
        raise click.UsageError("expected --mask, --scene or --canvas, got two; give one")
    keep_one_source(study.options, given)
    start_lights(study.options, light, study.image.values.shape)
    if (profile or posterior) and not {"mask", "scene", "canvas"} & study.options.keys():
        wanted = f"--profile {profile[0]}" if profile else "--posterior"
        raise click.UsageError(f"{wanted}: expected --mask, --scene or --canvas with it, got none")
    for name in study.options["free"] if "scene" not in study.options else ():
        raise click.UsageError(f"--free {name}: expected --scene SCENE.toml with it, got a mask")
    ahead = draw_ahead()
    with working(run) as progress:
        file = study.options.get("scene")
        find_shader(study.options)
        # Before the imports: compiled programs are loaded meanwhile.
        prepare(study.options, run, progress, study.image.values.shape, draws=not ahead)
        from godfit.fitting import fit
        from godfit.studies.posterior import require

        if posterior:
            require()
        imported = time.perf_counter() - STARTED
        result = fit(
            study.image, valid=study.valid, seed=run.seed, progress=progress, **study.options
        )
        result = with_intervals(result, profile, posterior, run.seed, progress)
        if file is not None:
            digest = hashlib.sha256(read_regular(file, "a scene")).hexdigest()
            result.inputs["scene"] = {"path": file, "sha256": digest}
        result.timing_s["import"] = imported
        result.timing_s["total"] = time.perf_counter() - STARTED
        progress("drawing")
        names = ("fit.json", "fit.png", "render.png")
        names += ("mask.png",) if result.mask_estimated else ()
        files = save_result(result, run, study.folder, names)
    notes = [*result.notes, *result.undetermined, *result.warnings]
    print_result(result, notes, run, files)
    if requested():
        return INTERRUPTED
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


def find_shader(options: dict[str, Any]) -> None:
    """Have the shader found where nothing names it and there is a mask or a scene."""
    known = {"mask", "scene"} & options.keys() and "canvas" not in options
    if not known or options.get("model", "mitchell") != "mitchell" or options.get("shader"):
        return
    if "scene" in options:
        from godfit.scenes.scene import read_scene

        options["scene"] = read_scene(options["scene"])
        if "shader" in options["scene"].settings:
            return
    if not options["free"]:
        options["shader"] = "auto"


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

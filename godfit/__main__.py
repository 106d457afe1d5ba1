"""The command line: ``python -m godfit`` or ``godfit``.

Nothing here imports JAX before a command runs, so that help and usage errors come at once.
"""

from __future__ import annotations

import threading
import time

STARTED = time.perf_counter()

import difflib  # noqa: E402
import json  # noqa: E402
import os  # noqa: E402
import shlex  # noqa: E402
import signal  # noqa: E402
import sys  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import TYPE_CHECKING, Any  # noqa: E402

import click  # noqa: E402

from godfit.errors import InputError  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np

    from godfit.image import Image
    from godfit.models import Mitchell
    from godfit.result import FitResult
    from godfit.scene import Scene

NOT_CONVERGED = 3
INTERRUPTED = 130


class Progress:
    """Stages of the work on stderr: a spinner once a second has passed, on a terminal and unless
    asked to be quiet; with ``verbose`` a line for each, wherever stderr goes."""

    # Python drops an interrupt that comes while it runs a finaliser: the next stage asks once more.
    interrupted = False

    def __init__(self, quiet: bool, verbose: bool) -> None:
        from rich.console import Console

        self.console = Console(stderr=True)
        self.spins = not quiet and not verbose and self.console.is_terminal
        self.verbose = verbose and not quiet
        self.began = time.perf_counter()
        self.status: Any = None

    def __call__(self, stage: str) -> None:
        if Progress.interrupted:
            raise KeyboardInterrupt
        elapsed = time.perf_counter() - self.began
        if self.verbose:
            click.echo(f"godfit: {elapsed:6.2f} s  {stage}", err=True)
        elif self.spins and self.status is not None:
            self.status.update(stage)
        elif self.spins and elapsed > 1:
            self.status = self.console.status(stage)
            self.status.start()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self.status is not None:
            self.status.stop()


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="godfit")
def cli() -> None:
    """Read the parameters of god rays out of images."""


def assignments(values: tuple[str, ...], option: str, optional: bool) -> dict[str, Any]:
    """``NAME=VALUE`` (or, if ``optional``, ``NAME``) -> a dictionary."""
    found: dict[str, Any] = {}
    for text in values:
        name, sign, value = text.partition("=")
        if not sign and optional:
            found[name] = None
            continue
        try:
            found[name] = float(value)
        except ValueError:
            raise click.BadParameter(
                f"expected NAME=VALUE with a number, got '{text}'", param_hint=option
            ) from None
    return found


def look_away(ignore: tuple[str, ...], size: tuple[int, int]) -> np.ndarray | None:
    """(h, w), False inside the ``X,Y,W,H`` rectangles and where an image is not black."""
    if not ignore:
        return None
    import numpy as np

    from godfit.image import read_image

    valid = np.ones(size, bool)
    for text in ignore:
        numbers = text.split(",")
        if len(numbers) == 4 and all(n.strip().lstrip("-").isdigit() for n in numbers):
            x, y, w, h = (int(n) for n in numbers)
            if w <= 0 or h <= 0:
                raise InputError(f"--ignore: expected a width and height above 0, got '{text}'")
            valid[max(y, 0) : max(y + h, 0), max(x, 0) : max(x + w, 0)] = False
            continue
        if len(numbers) == 4 and not Path(text).exists():
            raise InputError(
                f"--ignore: expected X,Y,W,H in whole pixels or an image, got '{text}'"
            )
        image = np.atleast_3d(read_image(text).values)
        if image.shape[:2] != size:
            raise InputError(
                f"--ignore: expected the target's {size[1]}x{size[0]} pixels, got "
                f"{image.shape[1]}x{image.shape[0]} in '{text}'"
            )
        valid &= (image <= 0).all(-1)
    return valid


def folder_for(target: str, output: str | None) -> Path:
    """Where the result goes. Raises InputError now rather than after the work is done."""
    folder = Path(output) if output else Path(target).with_suffix(".godfit")
    near = folder
    while not near.exists() and near != near.parent:
        near = near.parent
    if not near.is_dir():
        raise InputError(
            f"output: expected a folder, got the file '{near}'; choose another with -o"
        )
    if not os.access(near, os.W_OK):
        raise InputError(f"output: '{near}' cannot be written; choose another folder with -o")
    return folder


def opened(
    target: str, given: Mapping[str, Any], output: str | None
) -> tuple[Image, dict[str, Any], Path]:
    """The target, its options (those of the file beside it, and ``given`` ones in their place), and
    the folder for the result."""
    from godfit.image import read_image
    from godfit.sidecar import read_sidecar

    options = read_sidecar(target) | {k: v for k, v in given.items() if v is not None}
    folder = folder_for(target, output)
    # The target first: a missing one should not be reported as a missing mask.
    image = read_image(target, transfer=options.get("transfer", "none"))
    for one, other in (("mask", "scene"), ("scene", "mask")):
        if given[one] is not None and given[other] is None:
            # What is said here replaces what stands beside the target.
            options.pop(other, None)
    if "mask" in options and "scene" in options:
        raise click.UsageError("expected --mask or --scene, got both; a scene draws its own mask")
    if "mask" not in options and "scene" not in options:
        raise click.UsageError(
            "expected --mask IMAGE or --scene SCENE.toml, or "
            f"{Path(target).with_suffix('.toml').name} beside the target naming one; got neither"
        )
    return image, options, folder


def load_scene(options: dict[str, Any], progress: Progress) -> None:
    """Put the scene itself in the place of its file."""
    if "scene" in options:
        from godfit.scene import read_scene

        progress("loading meshes")
        options["scene"] = read_scene(options["scene"])


def say_assumed(options: Mapping[str, Any]) -> None:
    """Warn of a shader or a number of samples that nobody gave."""
    from godfit.taps import convention

    said = {**options["scene"].settings, **options} if "scene" in options else options
    if "shader" not in said:
        warn("no shader given: 'mitchell' assumed; see `godfit shaders`")
    shader = convention(said.get("shader", "mitchell"))
    if "samples" not in said and "samples" not in shader.defaults:
        warn(f"{shader.name} publishes no default: {shader.samples} samples assumed")


SHADER_HELP = "Shader convention; see `godfit shaders`. [default: mitchell]"


def load_drawing() -> None:
    import matplotlib.backends.backend_agg
    import matplotlib.figure  # noqa: F401


@cli.command()
@click.argument("target")
@click.option("--mask", help="Occlusion mask that the scattering pass reads.")
@click.option("--scene", help="Scene file to draw the mask from.")
@click.option("--model", help="mitchell or hoffman-preetham. [default: mitchell]")
@click.option("--free", multiple=True, metavar="NAME", help="Fit this of the scene as well.")
@click.option("--background", help="Ordinary pass that the light was laid on.")
@click.option("--shader", help=SHADER_HELP)
@click.option("--samples", type=int, help="Samples a ray. [default: the shader's own]")
@click.option("--lights", type=int, help="Number of lights. [default: 1]")
@click.option("--pass-scale", type=float, help="Size of the light pass against the mask's.")
@click.option("--transfer", type=click.Choice(["none", "srgb"]), help="How the target was encoded.")
@click.option("--fov", type=float, help="Hoffman-Preetham: vertical field of view in degrees.")
@click.option("--distance", type=float, help="Hoffman-Preetham: how far what is seen lies.")
@click.option("--fix", multiple=True, metavar="NAME[=VALUE]", help="Hold a parameter.")
@click.option("--start", multiple=True, metavar="NAME=VALUE", help="Start a parameter here.")
@click.option("--ignore", multiple=True, metavar="X,Y,W,H|IMAGE", help="Pixels to look away from.")
@click.option("--profile", multiple=True, metavar="NAME", help="95% interval of the likelihood.")
@click.option("--posterior", is_flag=True, help="95% intervals of the posterior (blackjax).")
@click.option("-o", "--output", metavar="DIR", help="Result folder. [default: TARGET.godfit]")
@click.option(
    "--json", "as_json", is_flag=True, help="Print fit.json, and nothing else, to stdout."
)
@click.option("--seed", type=int, default=0, help="Seed of the choice of pixels.")
@click.option("-q", "--quiet", is_flag=True, help="No progress, no warnings.")
@click.option("-v", "--verbose", is_flag=True, help="A line for every stage.")
def fit(
    target: str,
    free: tuple[str, ...],
    fix: tuple[str, ...],
    start: tuple[str, ...],
    ignore: tuple[str, ...],
    profile: tuple[str, ...],
    posterior: bool,
    output: str | None,
    as_json: bool,
    seed: int,
    quiet: bool,
    verbose: bool,
    **given: Any,
) -> int:
    """Fit exposure, decay, density, weight and the light's position to TARGET.

    A TARGET x.png with an x.toml beside it takes its mask or scene, shader and samples from there;
    options override it. The result goes to x.godfit/: fit.json, fit.png, render.png.

    With --scene the mask is drawn from meshes. --free light.position (or light.radius,
    camera.position, object[0].position, object[0].rotation, ...) fits that as well.
    """
    fixed = assignments(fix, "--fix", optional=True)
    started = assignments(start, "--start", optional=False)
    image, options, folder = opened(target, given, output)
    if free and "scene" not in options:
        raise click.UsageError(f"--free {free[0]}: expected --scene SCENE.toml with it, got a mask")
    valid = look_away(ignore, image.values.shape[:2])
    with Progress(quiet, verbose) as progress:
        progress("loading JAX")
        from godfit.cache import keep_compiled

        keep_compiled()
        from godfit.fitting import fit as run
        from godfit.posterior import require
        from godfit.report import as_json as record
        from godfit.report import save

        if posterior:
            require()
        imported = time.perf_counter() - STARTED
        staged = options.get("scene")
        load_scene(options, progress)
        if options.get("model", "mitchell") == "mitchell" and not quiet:
            say_assumed(options)
        # Loaded while compiled programs run, which need the interpreter little.
        threading.Thread(target=load_drawing, daemon=True).start()
        result = run(
            image, free=free, fix=fixed, start=started, valid=valid, seed=seed,
            progress=progress, **options,
        )  # fmt: skip
        result = with_intervals(result, profile, posterior, seed, progress)
        if staged is not None:
            result.inputs["scene"] = {"path": staged}
        result.timing_s["import"] = imported
        result.timing_s["total"] = time.perf_counter() - STARTED
        progress("drawing")
        command = shlex.join(["godfit", *sys.argv[1:]])
        save(result, folder, command)
    if not quiet:
        for note in [*result.notes, *result.undetermined]:
            warn(note)
    if as_json:
        click.echo(json.dumps(record(result, command), indent=1, ensure_ascii=False))
    else:
        click.echo(result.summary())
        click.echo(f"\n  {folder}{os.sep}: fit.json, fit.png, render.png")
    return 0 if result.converged else NOT_CONVERGED


def with_intervals(
    result: FitResult, names: tuple[str, ...], posterior: bool, seed: int, progress: Progress
) -> FitResult:
    """The result with the intervals that were asked for."""
    from godfit import posterior as drawing
    from godfit.profile import check, profile

    for name in names:
        check(result, name)
    for name in names:
        progress(f"profile of {name}")
        result = profile(result, name)
    if posterior:
        progress("posterior")
        result = drawing.with_posterior(result, drawing.posterior(result, seed=seed))
    return result


@cli.command()
@click.argument("target")
@click.option("--mask", help="Occlusion mask, as for fit.")
@click.option("--scene", help="Scene file: mask, camera, distances and light.")
@click.option("--background", help="Ordinary pass that the light was laid on.")
@click.option("--shader", help=SHADER_HELP)
@click.option("--samples", type=int, help="Samples a ray. [default: the shader's own]")
@click.option("--light", metavar="U,V", help="Where the light is. [default: the scene's]")
@click.option("--pass-scale", type=float, help="Size of the light pass against the mask's.")
@click.option("--transfer", type=click.Choice(["none", "srgb"]), help="How the target was encoded.")
@click.option("--fov", type=float, help="Vertical field of view in degrees, without a scene.")
@click.option("--distance", type=float, help="How far what is seen lies; with a scene, the sky.")
@click.option("--ignore", multiple=True, metavar="X,Y,W,H|IMAGE", help="Pixels to look away from.")
@click.option("-o", "--output", metavar="DIR", help="Result folder. [default: TARGET.godfit]")
@click.option("--json", "as_json", is_flag=True, help="Print compare.json, and nothing else.")
@click.option("--seed", type=int, default=0, help="Seed of the choice of pixels.")
@click.option("-q", "--quiet", is_flag=True, help="No progress, no warnings.")
@click.option("-v", "--verbose", is_flag=True, help="A line for every stage.")
def compare(
    target: str,
    light: str | None,
    ignore: tuple[str, ...],
    output: str | None,
    as_json: bool,
    seed: int,
    quiet: bool,
    verbose: bool,
    **given: Any,
) -> int:
    """Fit Mitchell's sum and Hoffman and Preetham's daylight to TARGET and say which it deserves.

    Each is fitted with the light where it is given, if it is, and with the light free. The table
    goes to stdout, compare.json and compare.png to x.godfit/. Exit status 3 if none converged.
    """
    place = None if light is None else pair(light)
    image, options, folder = opened(target, given, output)
    valid = look_away(ignore, image.values.shape[:2])
    with Progress(quiet, verbose) as progress:
        progress("loading JAX")
        from godfit.cache import keep_compiled

        keep_compiled()
        from godfit import compare as comparing

        load_scene(options, progress)
        if not quiet:
            say_assumed(options)
        threading.Thread(target=load_drawing, daemon=True).start()
        found = comparing.compare(
            image, light=place, valid=valid, seed=seed, progress=progress, **options
        )
        progress("drawing")
        command = shlex.join(["godfit", *sys.argv[1:]])
        comparing.save(found, folder, command)
    if not quiet:
        for note in dict.fromkeys(note for row in found.rows for note in row.result.notes):
            warn(note)
    if as_json:
        record = comparing.as_json(found, command)
        click.echo(json.dumps(record, indent=1, ensure_ascii=False))
    else:
        click.echo(found.summary())
        click.echo(f"\n  {folder}{os.sep}: compare.json, compare.png")
    return 0 if any(row.result.converged for row in found.rows) else NOT_CONVERGED


@cli.command()
@click.argument("target")
@click.option("--mask", help="Occlusion mask, as for fit.")
@click.option("--scene", help="Scene file: mask, camera, distances and light.")
@click.option("--background", help="Ordinary pass that the light was laid on.")
@click.option("--shader", help=SHADER_HELP)
@click.option("--samples", type=int, help="Samples a ray. [default: the shader's own]")
@click.option(
    "--light",
    metavar="U,V",
    help="Where the light is before it is fitted. [default: the scene's, or the middle]",
)
@click.option("--pass-scale", type=float, help="Size of the light pass against the mask's.")
@click.option("--transfer", type=click.Choice(["none", "srgb"]), help="How the target was encoded.")
@click.option("--fov", type=float, help="Vertical field of view in degrees, without a scene.")
@click.option("--distance", type=float, help="How far what is seen lies; with a scene, the sky.")
@click.option("--ignore", multiple=True, metavar="X,Y,W,H|IMAGE", help="Pixels to look away from.")
@click.option("-o", "--output", metavar="DIR", help="Result folder. [default: TARGET.godfit]")
@click.option("--json", "as_json", is_flag=True, help="Print select.json, and nothing else.")
@click.option("--seed", type=int, default=0, help="Seed of the choice of pixels.")
@click.option("-q", "--quiet", is_flag=True, help="No progress, no warnings.")
@click.option("-v", "--verbose", is_flag=True, help="A line for every stage.")
def select(
    target: str,
    light: str | None,
    ignore: tuple[str, ...],
    output: str | None,
    as_json: bool,
    seed: int,
    quiet: bool,
    verbose: bool,
    **given: Any,
) -> int:
    """The smallest model that explains TARGET: from a constant veil to two coloured lights.

    Rungs whose light is not fitted have it at --light. The table goes to stdout, select.json and
    select.png to x.godfit/. Exit status 3 if no rung leaves only noise.
    """
    place = None if light is None else pair(light)
    image, options, folder = opened(target, given, output)
    valid = look_away(ignore, image.values.shape[:2])
    with Progress(quiet, verbose) as progress:
        progress("loading JAX")
        from godfit.cache import keep_compiled

        keep_compiled()
        from godfit import select as selecting

        load_scene(options, progress)
        if not quiet:
            say_assumed(options)
        threading.Thread(target=load_drawing, daemon=True).start()
        found = selecting.select(
            image, light=place, valid=valid, seed=seed, progress=progress, **options
        )
        progress("drawing")
        command = shlex.join(["godfit", *sys.argv[1:]])
        selecting.save(found, folder, command)
    if not quiet:
        for note in found.base.notes:
            warn(note)
    if as_json:
        record = selecting.as_json(found, command)
        click.echo(json.dumps(record, indent=1, ensure_ascii=False))
    else:
        click.echo(found.summary())
        click.echo(f"\n  {folder}{os.sep}: select.json, select.png")
    return 0 if found.recommended.like_noise else NOT_CONVERGED


@cli.command()
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
    with Progress(quiet, verbose) as progress:
        progress("loading JAX")
        from godfit.cache import keep_compiled

        keep_compiled()
        from godfit import simplify as simpler
        from godfit.record import recorded

        fitted = recorded(fit_json, mask=mask, scene=scene, background=background)
        found = simpler.simplify(
            fitted.model, fitted.mask, tolerance, background=fitted.background, size=fitted.size,
            transfer=fitted.transfer, by=by, progress=progress,
        )  # fmt: skip
    if not quiet:
        for note in fitted.notes:
            warn(note)
    if as_json:
        record = simpler.as_json(found, tolerance, by, shlex.join(["godfit", *sys.argv[1:]]))
        click.echo(json.dumps(record, indent=1, ensure_ascii=False))
    else:
        click.echo(found.summary())
    return 0


@cli.command()
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


@cli.command()
@click.argument("mask", metavar="MASK|SCENE.toml")
@click.option("-o", "--output", required=True, help="Image to write: .png or .npy (linear floats).")
@click.option("--model", help="mitchell, hoffman-preetham or volume. [default: mitchell]")
@click.option("--params", metavar="FIT.JSON", help="Take shader and parameters from a fit.")
@click.option("--shader", help=SHADER_HELP)
@click.option("--samples", type=int, help="Samples a ray. [default: the shader's own]")
@click.option("--exposure", type=float)
@click.option("--decay", type=float)
@click.option("--density", type=float)
@click.option("--weight", type=float)
@click.option("--e-sun", type=float, help="The sun's irradiance, or a lamp's intensity.")
@click.option("--scale", type=float, help="Metres of air that a unit of distance stands for.")
@click.option("--turbidity", type=float, help="Haze: 2 clear, 6 hazy. [default: 2]")
@click.option("--g", type=float, help="Mean cosine of the haze's scattering. [default: .76]")
@click.option("--phase", help="normalised or published. [default: normalised]")
@click.option("--fov", type=float, help="Vertical field of view in degrees, without a scene.")
@click.option("--distance", type=float, help="How far what is seen lies; with a scene, the sky.")
@click.option("--source", default="sun", help="Of a volume: sun or lamp. [default: sun]")
@click.option("--steps", type=int, default=128, help="Of a volume's rays. [default: 128]")
@click.option("--light", multiple=True, metavar="U,V", help="Light; repeat for several.")
@click.option("--background", help="Ordinary pass to lay the light on.")
@click.option("--size", metavar="WxH", help="Size of the image. [default: the mask's]")
@click.option("--pass-scale", type=float, default=1.0, help="Size of the light pass to the mask's.")
@click.option("--transfer", type=click.Choice(["none", "srgb"]), default="none")
@click.option(
    "--bits", type=click.Choice(["8", "16"]), default="8", help="Bits of a PNG's channel."
)
@click.option(
    "--tolerance",
    type=float,
    metavar="LEVELS",
    help="Largest error, in 8-bit levels, that a faster method may make. [default: exact]",
)
def render(
    mask: str,
    output: str,
    model: str | None,
    params: str | None,
    shader: str | None,
    samples: int | None,
    phase: str | None,
    fov: float | None,
    distance: float | None,
    source: str,
    steps: int,
    light: tuple[str, ...],
    background: str | None,
    size: str | None,
    pass_scale: float,
    transfer: str,
    bits: str,
    tolerance: float | None,
    **values: float | None,
) -> int:
    """Render the light of MASK, or of the scene SCENE.toml, with the given parameters or the
    shader's defaults.

    --model hoffman-preetham takes a mask that is 1 where the sky is seen; --model volume marches
    through the air of a SCENE.toml. Both need --e-sun and --scale.
    """
    from godfit.image import read_image, write_image
    from godfit.inputs import check_model, drawn, model_from, place_of, shrink_mask
    from godfit.record import read_params

    if tolerance is not None and not 0 <= tolerance < float("inf"):
        raise click.BadParameter(
            f"expected a number of levels, 0 or more, got {tolerance:g}", param_hint="--tolerance"
        )
    lights = [pair(text) for text in light]
    settings: dict[str, Any] = {}
    stage = None
    if mask.endswith(".toml"):
        from godfit.scene import read_scene

        stage = read_scene(mask)
        settings = {**stage.settings, **place_of(stage)}
        pass_scale = settings.pop("pass_scale", 1.0) if pass_scale == 1 else pass_scale
        transfer = settings.pop("transfer", "none") if transfer == "none" else transfer
    settings |= read_params(params) if params else {}
    kind = model or settings.get("model", "mitchell")
    if kind != "volume":
        check_model(
            kind, (), shader, 1 if kind == "mitchell" else max(len(lights), 1), fov, distance
        )
    settings |= {k: v for k, v in {"shader": shader, "samples": samples}.items() if v is not None}
    known = {k: v for k, v in values.items() if v is not None}
    if kind != "mitchell":
        if stage is not None:
            # That of a fit is a typical one; the scene has them all.
            settings.pop("distance", None)
        geometry = {"fov": fov, "distance": distance, "phase": phase}
        settings |= {k: v for k, v in geometry.items() if v is not None}
        image = daylight_image(
            mask, stage, settings, known, lights, kind, back_of(background, transfer), source, steps
        )
        write_image(output, image, transfer=transfer, bits=int(bits))
        return 0
    shape = whole(size) if size else None
    back = back_of(background, transfer)
    if stage is None:
        occlusion = read_image(mask).values
    else:
        occlusion = drawn(stage, stage.antialias is not False)
    lit = model_from(settings, known, lights)
    low = shrink_mask(occlusion, pass_scale)
    shape = shape or (occlusion.shape[:2] if back is None else back.shape[:2])
    check_background(back, shape)
    image = drawn_light(lit, low, back, shape, tolerance or 0.0)
    write_image(output, image, transfer=transfer, bits=int(bits))
    return 0


def back_of(background: str | None, transfer: str) -> np.ndarray | None:
    """The ordinary pass, linear, if there is one."""
    from godfit.image import read_image

    return None if background is None else read_image(background, transfer=transfer).values


def daylight_image(
    mask: str,
    stage: Scene | None,
    settings: dict[str, Any],
    known: dict[str, float],
    lights: list[tuple[float, float]],
    kind: str,
    background: np.ndarray | None,
    source: str,
    steps: int,
) -> np.ndarray:
    """The image of Hoffman and Preetham's model, or of a volume, (h, w, 3), clamped to [0, 1]."""
    import numpy as np

    from godfit.image import read_image
    from godfit.inputs import daylight_from, drawn, open_sky
    from godfit.observation import render as draw

    model = daylight_from(settings, known, lights, stage)
    if kind == "volume":
        from godfit import volume

        if stage is None:
            raise InputError("volume: expected a SCENE.toml, got an image; it has no depth")
        size, distance = stage.size, np.asarray(model.view.distance)
        check_background(background, size)
        image = volume.render(
            stage, model.air, distance, source=source, steps=steps, background=background
        )
        return np.clip(image, 0, 1)
    occlusion = read_image(mask).values if stage is None else drawn(open_sky(stage), True)
    check_background(background, occlusion.shape[:2])
    return draw(model, occlusion, background, occlusion.shape[:2])


def check_background(background: np.ndarray | None, size: tuple[int, ...]) -> None:
    if background is not None and background.shape[:2] != tuple(size):
        raise InputError(
            f"background: expected {size[1]}x{size[0]} pixels, got "
            f"{background.shape[1]}x{background.shape[0]}"
        )


def drawn_light(
    model: Mitchell,
    mask: np.ndarray,
    background: np.ndarray | None,
    size: tuple[int, int],
    tolerance: float,
) -> np.ndarray:
    """The model's image, (h, w) or (h, w, 3), its light pass off by ``tolerance`` levels at most.
    All lights are summed by one method, and their errors add up."""
    if not tolerance:
        from godfit.observation import render as draw

        return draw(model, mask, background, size)
    import equinox as eqx
    import jax.numpy as jnp
    import numpy as np

    from godfit.radial import cheapest

    low = jnp.asarray(mask)
    back = None if background is None else jnp.asarray(background)
    method = cheapest(low, model.light, model.taps[-1], tolerance)
    return np.clip(np.asarray(eqx.filter_jit(model)(low, back, size=size, method=method)), 0, 1)


def pair(text: str) -> tuple[float, float]:
    """``U,V`` -> two numbers."""
    try:
        u, v = (float(n) for n in text.split(","))
    except ValueError:
        raise click.BadParameter(f"expected U,V, got '{text}'", param_hint="--light") from None
    return u, v


def whole(text: str) -> tuple[int, int]:
    """``WxH`` -> (h, w)."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(p.isdigit() and int(p) > 0 for p in parts):
        raise click.BadParameter(f"expected WxH in pixels, got '{text}'", param_hint="--size")
    return int(parts[1]), int(parts[0])


@cli.command()
def shaders() -> int:
    """List the shader conventions with their formulas and defaults."""
    from godfit.taps import CONVENTIONS

    click.echo("M mask at the pixel, M_i at x - i Delta, Delta = (x - l) rho / n; B background")
    for shader in CONVENTIONS.values():
        defaults = ", ".join(f"{k} {v:g}" for k, v in shader.defaults.items()) or "none published"
        click.echo(f"\n{shader.name}\n  {shader.formula}\n  defaults: {defaults}")
        if shader.remarks:
            click.echo(f"  {shader.remarks}")
    return 0


def warn(text: str) -> None:
    click.echo(f"godfit: warning: {text}", err=True)


def main(arguments: list[str] | None = None) -> int:
    """Run a command and return its exit status: 0 done, 1 bad input, 2 bad usage, 3 not converged,
    130 interrupted. Errors are one line on stderr."""
    try:
        return cli.main(arguments, prog_name="godfit", standalone_mode=False) or 0
    except click.UsageError as error:
        message, status = error.format_message(), 2
        if isinstance(error, click.NoSuchOption) and error.possibilities:
            near = difflib.get_close_matches(error.option_name, error.possibilities, 1)
            message = f"{error.option_name}: no such option; did you mean {(near or ['-h'])[0]}?"
    except click.ClickException as error:
        message, status = error.format_message(), 1
    except (click.Abort, KeyboardInterrupt):
        message, status = "interrupted; nothing was written", INTERRUPTED
    except InputError as error:
        message, status = str(error), 1
    except MemoryError:
        message, status = "out of memory; give a smaller target or free some", 1
    except OSError as error:
        where = f"'{error.filename}': " if error.filename else ""
        message, status = f"{where}{error.strerror or error}; nothing was written", 1
    print(f"godfit: error: {' '.join(message.split())}", file=sys.stderr)
    return status


def _interrupt(number: int, frame: Any) -> None:
    Progress.interrupted = True
    signal.default_int_handler(number, frame)


def run() -> None:
    """The ``godfit`` command."""
    signal.signal(signal.SIGINT, _interrupt)
    # Where an interrupt falls into a finaliser, Python prints it and goes on; the next stage stops.
    sys.unraisablehook = lambda lost: (
        None if isinstance(lost.exc_value, KeyboardInterrupt) else sys.__unraisablehook__(lost)
    )
    status = main()
    sys.stdout.flush()
    sys.stderr.flush()
    # An orderly end takes a third of a second, and would pull the memory from under compiled
    # programs that an interrupt has left running.
    os._exit(status)


if __name__ == "__main__":
    run()
